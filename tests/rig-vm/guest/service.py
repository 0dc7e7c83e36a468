"""The package on a running system: what it installs, the socket, readiness, the watchdog, and how the daemon ends."""

import grp
import os
import re
import stat
import time
from pathlib import Path

import scand
import vivid
from harness import Chapter, contains, expect, run, until

SOCKET = Path("/run/scand/scand.sock")
SIZE = (640, 360)
CAMERAS = f"""
[v4l2.defaults]
size = {list(SIZE)}
pixel_format = "yuyv"
silence_ms = 30000.0
[v4l2.cameras.c00]
device = "{vivid.capture(0)}"
[v4l2.cameras.c01]
device = "{vivid.capture(1)}"
"""
# A hook that says what it may do; one that fails is in the log.
HOOK = '[hooks]\naccepted = ["sh", "-c", "grep CapEff /proc/self/status >&2; exit 1"]\n'


def end():
    scand.clear()
    vivid.unload()


chapter = Chapter("service", end)


def install(*options):
    """Installs the package; every chapter needs it."""
    run("apt-get", "install", "--yes", *options, "/rig-vm/scand.deb", timeout=300)


def configure(more="", models=0):
    scand.configure(CAMERAS, {"c00": SIZE, "c01": SIZE}, more, models)


@chapter.step("installed on a running system, and nothing starts without a configuration")
def installed():
    expect(scand.unit("scand.socket", "UnitFileState", "ActiveState"), ["enabled", "inactive"], "scand.socket")
    expect(scand.unit("scand.service", "UnitFileState", "ActiveState"), ["enabled", "inactive"], "scand.service")
    expect(Path("/proc/sys/net/core/rmem_max").read_text().strip(), "33554432", "net.core.rmem_max")
    members = [group.gr_name for group in grp.getgrall() if "scand" in group.gr_mem]
    expect(sorted(members), ["plugdev", "video"], "groups of the user scand")


@chapter.step("the installed program has no simulator, and says where one is")
def no_simulator():
    contains(run("scand", "simulate", "--shape", "cup", expected=2), "no simulator")


@chapter.step("systemd finds no fault with the units, and scores them 2.0 at most")
def scores():
    expect(run("systemd-analyze", "verify", "scand.service", "scand.socket", "scand-pedal@event0.service"), "", "verify")
    scores = []
    for name in ("scand.service", "scand-pedal@event0.service"):
        judged = run("systemd-analyze", "security", "--no-pager", "--threshold=20", name)
        scores.append(judged.splitlines()[-1].split(": ")[1].split()[0])
    return f"the daemon {scores[0]}, a pedal {scores[1]}"


@chapter.step("the socket is for the group, and its first client starts the daemon")
def activated():
    vivid.load([vivid.WEBCAM] * 2)
    configure(HOOK)
    run("systemctl", "start", "scand.socket")
    found = SOCKET.stat()
    mode = (stat.S_IMODE(found.st_mode), grp.getgrgid(found.st_gid).gr_name)
    expect(mode, (0o660, "scand"), "mode and group of the socket")
    expect(scand.active(), "inactive", "the daemon before a client")
    refused = scand.as_user("nobody", "scand", "status", expected=1)
    contains(refused, "Permission denied")
    expect(scand.active(), "inactive", "the daemon after a stranger")
    contains(scand.as_user("nobody", "scand", "status", groups=["scand"]), "c00")
    until("the daemon is active", lambda: scand.active() == "active")


def capability(status):
    """What a process may do beyond others, from its status."""
    return re.search(r"CapEff:\s*(\S*)", status)[1].lstrip("0")


@chapter.step("a press is a capture on the disk, and its hook inherits nothing of what the daemon may")
def pressed():
    since = scand.now()
    contains(scand.ask("trigger"), "durable in /var/lib/scand/recordings/")
    (pid,) = scand.unit("scand.service", "MainPID")
    expect(capability(Path(f"/proc/{pid}/status").read_text()), "2000", "the daemon's capabilities: raw sockets")
    until("the hook has spoken", lambda: "CapEff" in scand.said(since))
    expect(capability(scand.said(since)), "", "the hook's capabilities")


@chapter.step("it is ready when all cameras are there, and not before; until then it answers")
def ready():
    run("systemctl", "stop", "scand.service")
    away = os.readlink(vivid.capture(1))
    vivid.capture(1).unlink()
    scand.start(ready=False)
    until("c00 is ready", lambda: scand.camera("c00")[0] == "ready")
    time.sleep(3)
    expect(scand.active(), "activating", "the daemon without c01")
    contains(scand.unit("scand.service", "StatusText")[0], "not ready: 1 of 2 cameras (missing: c01)")
    contains(scand.ask("trigger", expected=1), "camera c01")
    contains(scand.camera("c01")[1], str(vivid.capture(1)), "No such file")
    os.symlink(away, vivid.capture(1))
    until("the daemon is active", lambda: scand.active() == "active")
    return scand.unit("scand.service", "StatusText")[0]


@chapter.step("a daemon that hangs is ended by the watchdog, and the next press works")
def hangs():
    run("systemctl", "stop", "scand.service")
    scand.drop_in("[Service]\nWatchdogSec=15\n")
    scand.start()
    since = scand.now()
    (pid,) = scand.unit("scand.service", "MainPID")
    os.kill(int(pid), 19)
    begin = time.monotonic()
    # Who presses meanwhile waits for the new daemon.
    contains(scand.ask("trigger", "--press-id", "hung-1"), "durable")
    took = time.monotonic() - begin
    contains(scand.said(since), "Watchdog timeout", "status=6/ABRT")
    until("the daemon is active", lambda: scand.active() == "active")
    expect(scand.unit("scand.service", "NRestarts"), ["1"], "restarts")
    return f"{took:.0f} s after it stopped, of which 15 s are the watchdog's"


@chapter.step("a daemon that is killed starts again, and keeps what was durable")
def killed():
    durable = scand.ask("trigger", "--press-id", "kept-1")
    (pid,) = scand.unit("scand.service", "MainPID")
    os.kill(int(pid), 9)
    until("it is started again", lambda: scand.unit("scand.service", "NRestarts")[0] == "2")
    until("the daemon is active", lambda: scand.active() == "active")
    again = scand.ask("trigger", "--press-id", "kept-1")
    expect(again.splitlines()[-1].split(":")[0], durable.splitlines()[-1].split(":")[0], "the capture of the same press")
    parts = [name for name in os.listdir(scand.RECORDINGS) if name.endswith(".part")]
    expect(parts, [], "recordings that were not completed")


@chapter.step("it reads its configuration again, and refuses what it cannot change as it runs")
def reloaded():
    # The hook of an earlier step belongs to what only a restart changes.
    configure()
    before = SOCKET.stat().st_ctime_ns
    run("systemctl", "restart", "scand.service")
    until("the daemon is active", lambda: scand.active() == "active")
    expect(SOCKET.stat().st_ctime_ns > before, True, "the socket shows that a daemon has it again")
    since = scand.now()
    configure("[service]\nmissing_cameras = 1\n")
    run("systemctl", "reload", "scand.service")
    until("it says so", lambda: "the changed settings are in use" in scand.said(since))
    expect(scand.active(), "active", "the daemon")
    since = scand.now()
    scand.CONFIGURATION.write_text(scand.CONFIGURATION.read_text().replace("640, 360", "320, 180"))
    run("systemctl", "reload", "scand.service")
    until("it says so", lambda: "not reloaded" in scand.said(since))
    contains(scand.said(since), "v4l2")
    configure()


@chapter.step("stopped, it completes the recording and ends well")
def stopped():
    scand.ask("session", "start", "evening")
    scand.ask("trigger")
    run("systemctl", "stop", "scand.service")
    expect(scand.unit("scand.service", "Result"), ["success"], "its end")
    topics = [topic for topic, _, _ in scand.messages(scand.recording("evening"))]
    expect(topics.count("/trigger"), 1, "captures in the recording")
    contains(scand.ask("info", scand.recording("evening")), "complete")


@chapter.step("a bad configuration is named and not tried again")
def bad():
    configure("[capture]\nretry = 1\n")
    since = scand.now()
    run("systemctl", "start", "--no-block", "scand.service")
    until("it fails", lambda: scand.active() == "failed")
    expect(scand.unit("scand.service", "ExecMainStatus", "NRestarts"), ["78", "0"], "exit code and restarts")
    contains(scand.said(since), "rig.toml", "line ")
