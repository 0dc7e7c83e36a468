"""Tests what the daemon and its workers must not do, by trying it under the installed unit's own lines: the unit is
copied, and only the program that it starts is different."""

import json
import os
import re
import signal
from pathlib import Path

import scand
import service
import vivid
from harness import Chapter, Unexpected, contains, expect, run, until
from switch import Switch
from usb import Gadget

UNIT = Path("/lib/systemd/system/scand.service")
PROBE = Path("/run/systemd/system/probe.service")
# What says what the unit is and when it ends, not what it may do.
OTHERS = "Type NotifyAccess ExecStart ExecReload TimeoutStartSec WatchdogSec Restart RestartSec RestartPreventExitStatus"

MAY = {
    "write its recordings",
    "read and write a camera",
    "read and write a USB device",
    "send to a private address",
    "hear of devices from the kernel",
    "read packets as they come",
    "start a program",
}
MAY_NOT = {
    "write /etc",
    "write /usr",
    "write /run",
    "read /home",
    "read /root",
    "read a foot switch",
    "read the memory",
    "write the kernel's log",
    "write a terminal",
    "make a device",
    "send to an address of the world",
    "use another family of sockets",
    "see other processes",
    "signal other processes",
    "read the kernel's log",
    "set the clock",
    "set the host's name",
    "load a module",
    "mount",
    "make a namespace",
    "take real time",
    "become root",
    "make memory that is written and run",
    "change what the kernel is set to",
    "make a program that runs as its owner",
}


plugged = []


def end():
    while plugged:
        plugged.pop().remove()
    run("ip", "route", "del", "default", expected=None)
    run("systemctl", "stop", "probe.service", expected=None)
    PROBE.unlink(missing_ok=True)
    scand.clear()
    vivid.unload()


chapter = Chapter("sandbox", end)


def probe(command, environment=""):
    """Runs a program in the daemon's sandbox; gives its exit code and its words."""
    lines = UNIT.read_text(encoding="utf-8").split("[Service]")[1].split("[Install]")[0].splitlines()
    kept = [line for line in lines if line.split("=")[0] not in OTHERS.split()]
    PROBE.write_text(
        f"[Service]\nType=oneshot\nExecStart={command}\n{environment}\n" + "\n".join(kept), encoding="utf-8"
    )
    run("systemctl", "daemon-reload")
    since = scand.now()
    run("systemctl", "start", "probe.service", expected=None, timeout=300)
    (code,) = scand.unit("probe.service", "ExecMainStatus")
    run("systemctl", "reset-failed", "probe.service", expected=None)
    return int(code), scand.said(since, "probe.service")


@chapter.step("the daemon may use cameras, its folders and private networks, and nothing else")
def daemon():
    vivid.load([vivid.WEBCAM] * 2)
    # What is to be tried at: a foot switch, a Kinect, and a network.
    plugged.append(Switch())
    plugged.append(Gadget(0x045E, 0x02AE, "Xbox NUI Camera"))
    plugged[-1].plug_in()
    run("ip", "route", "add", "default", "dev", "lo")
    code, words = probe("/usr/bin/python3 -B /rig-vm/probe.py")
    found = re.search(r"^\{.*\}$", words, re.MULTILINE)
    if code or not found:
        raise Unexpected(f"the probe: exit code {code}: {words[-800:]}")
    tried = json.loads(found[0])
    may = {what for what, why in tried.items() if why is None}
    expect(set(tried), MAY | MAY_NOT, "what was tried")
    expect(sorted(may - MAY), [], "may, and should not")
    expect([f"{what}: {tried[what]}" for what in sorted(MAY - may)], [], "may not, and should")
    return f"{len(MAY_NOT)} things denied"


@chapter.step("what is denied there is allowed outside, to root")
def outside():
    # Without the sandbox the same program may do what it is denied there, or the chapter would show nothing.
    tried = json.loads(run("python3", "-B", "/rig-vm/probe.py").splitlines()[-1])
    denied = [f"{what}: {why}" for what, why in tried.items() if why is not None]
    expect(denied, [], "denied outside of the sandbox")


@chapter.step("a worker shuts itself in within the daemon's sandbox: only its recording and its output are left")
def worker():
    name = "one_that_is_confined_reads_its_recording_writes_its_output_and_no_more"
    code, words = probe(f"/rig-vm/workers --exact {name}")
    expect(code, 0, f"exit code of the test of a worker's confinement, which said {words[-800:]}")
    contains(words, "1 passed")


@chapter.step("a real worker of the daemon is another process, behind filters of its own, and holds no camera")
def real():
    service.configure(models=1)
    scand.start()
    scand.ask("background")
    scand.ask("trigger")
    (pid,) = scand.unit("scand.service", "MainPID")
    unit = int(of(Path(f"/proc/{pid}"), "Seccomp_filters"))
    folder = until("a worker runs that has shut itself in", lambda: worker_process(unit))
    expect(int(of(folder, "Seccomp_filters")), unit + 2, "filters of system calls, of which two are its own")
    expect(of(folder, "NoNewPrivs"), "1", "NoNewPrivs")
    files = [os.readlink(path) for path in (folder / "fd").iterdir()]
    others = [file for file in files if file.startswith(("/dev/", "socket:")) and file != "/dev/null"]
    expect(others, [], "devices and sockets that it holds")
    os.kill(int(folder.name), signal.SIGCONT)
    return f"{unit} filters of the unit, 2 of its own"


def worker_process(unit):
    """The folder below /proc of a worker that has more filters than its unit, and that is stopped for it."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if path.read_bytes().split(b"\0")[1:2] == [b"make-model"] and int(of(path.parent, "Seccomp_filters")) > unit + 1:
                # Held, or it could end while it is looked at.
                os.kill(int(path.parent.name), signal.SIGSTOP)
                return path.parent
        except (OSError, ValueError):  # it has ended
            pass
    return None


def of(folder, name):
    """A line of a process's status."""
    lines = (folder / "status").read_text(encoding="ascii").splitlines()
    return next(line.split()[1] for line in lines if line.startswith(f"{name}:"))
