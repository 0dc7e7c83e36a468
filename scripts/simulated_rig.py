"""A simulated rig whose times scripts measure: its processes and their logs in a folder of its own, on the loopback
addresses of a network namespace of its own. `scripts/fleet-presses.py` and `scripts/fuse-times.py` use it.
"""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

# Seconds after which a process that should say or do something does not do it any more.
PATIENCE = 60


def enter_namespace(cameras):
    """Starts the script again in a network namespace with an address for each camera, unless it runs in one."""
    if "SCAND_IN_NAMESPACE" not in os.environ:
        os.environ["SCAND_IN_NAMESPACE"] = "1"
        os.execvp("unshare", ["unshare", "--user", "--map-root-user", "--net", sys.executable, *sys.argv])
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    for n in range(cameras):
        subprocess.run(["ip", "address", "add", f"127.0.1.{n + 1}/8", "dev", "lo"], check=True)


class SimulatedRig:
    """Processes that run in one folder, each with a log `NAME.log` there; the camera's process and the daemon among them."""

    def __init__(self, script, options):
        """`options` has `scand`, the program, and `folder`, in which the rig's own folder is made (or None)."""
        self.script = script
        self.scand = str(Path(options.scand).resolve())
        self.home = Path(tempfile.mkdtemp(prefix=f"{script}-", dir=options.folder))
        self.running = {}

    def fail(self, problem):
        sys.exit(f"{self.script}: {problem}")

    def log(self, name):
        """What a process has said so far."""
        return (self.home / f"{name}.log").read_text()

    def command(self, *arguments):
        """Runs scand and waits until it ends; ends the script if it fails."""
        made = subprocess.run([self.scand, *arguments], cwd=self.home, capture_output=True, text=True)
        if made.returncode != 0:
            self.fail(f"scand {' '.join(arguments)}: {made.stderr}")

    def start(self, name, *command, said=(), **environment):
        """Starts a process, and waits until its log has all that it should have `said`."""
        with open(self.home / f"{name}.log", "ab") as log:
            self.running[name] = subprocess.Popen(
                command, cwd=self.home, stdin=subprocess.PIPE, stdout=log, stderr=log, env={**os.environ, **environment}
            )
        for words in said:
            self.until(lambda: words in self.log(name), lambda: f"{name} does not say {words!r}:\n{self.log(name)}")

    def until(self, is_so, problem):
        """Waits until something is so; ends the script with the problem if it does not become so."""
        end = time.monotonic() + PATIENCE
        while not is_so():
            if time.monotonic() > end:
                self.fail(problem())
            time.sleep(0.05)

    def tell_cameras(self, line):
        """Sends a line to the process that serves the cameras."""
        self.running["cameras"].stdin.write(f"{line}\n".encode())
        self.running["cameras"].stdin.flush()

    def press(self, name, until, **members):
        """One press; seconds until the reply of the type `until` came, and the reply."""
        request = {"type": "trigger", "source": "bench", "press_id": name, "until": until, **members}
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(self.home / "scand.sock"))
            began = time.monotonic()
            client.sendall(json.dumps(request).encode() + b"\n")
            for line in client.makefile():
                reply = json.loads(line)
                if reply["type"] == until:
                    return time.monotonic() - began, reply
                if reply["type"] not in ["accepted", "captured", "durable"]:
                    self.fail(line)
        self.fail("the daemon closed the connection before it had answered")

    def stop(self, name, by=signal.SIGTERM):
        if process := self.running.pop(name, None):
            process.send_signal(by)
            process.wait()

    def end(self, *names):
        """Stops these processes in this order, and removes the folder."""
        for name in names:
            self.stop(name)
        shutil.rmtree(self.home)
