"""GigE Vision cameras on loopback addresses, and what OpenNI2's test sensor shows: both play a recording."""

import subprocess
from pathlib import Path

from harness import run, until

LOG = Path("/run/cameras.log")


class Cameras:
    """Eleven cameras, which see the recording's empty rig until they are to see its captures."""

    def __init__(self, recording, *options):
        for index in range(11):
            run("ip", "address", "replace", f"127.0.1.{index + 1}/8", "dev", "lo")
        with LOG.open("w", encoding="utf-8") as log:
            self.process = subprocess.Popen(
                ["/rig-vm/scand", "simulate", "--serve", str(recording), "--empty", *map(str, options)],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                text=True,
            )
        until("the GigE Vision cameras are on", lambda: "serving" in LOG.read_text(encoding="utf-8"))

    def order(self, words):
        """Tells them what `scand simulate --serve` takes, such as `captures`."""
        before = LOG.read_text(encoding="utf-8").count("\nok")
        self.process.stdin.write(words + "\n")
        self.process.stdin.flush()
        until(f"the cameras obey: {words}", lambda: LOG.read_text(encoding="utf-8").count("\nok") > before)

    def stop(self):
        """Switches them off."""
        self.process.terminate()
        self.process.wait()
