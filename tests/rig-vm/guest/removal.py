"""The package is upgraded and removed while the rig is at work."""

import grp
import os
import pwd
from pathlib import Path

import scand
import service
import vivid
from harness import Chapter, contains, expect, run, until
from switch import Switch

plugged = []


def end():
    while plugged:
        plugged.pop().remove()
    vivid.unload()


chapter = Chapter("removal", end)


@chapter.step("an upgrade starts the daemon and the foot switch anew; a press meanwhile waits for it, and what was durable is kept")
def upgraded():
    vivid.load([vivid.WEBCAM] * 2)
    service.configure()
    scand.start()
    plugged.append(Switch())
    switch = plugged[0].unit
    until("the foot switch's unit is active", lambda: scand.active(switch) == "active")
    scand.ask("session", "start", "before")
    durable = scand.ask("trigger", "--press-id", "before-1")
    units = ("scand.service", switch)
    before = [scand.unit(name, "MainPID") for name in units]
    service.install("--reinstall")
    for name, old in zip(units, before):
        until(f"{name} is active", lambda name=name: scand.active(name) == "active")
        expect(scand.unit(name, "MainPID") != old, True, f"another process of {name}")
    again = scand.ask("trigger", "--press-id", "before-1")
    expect(again.splitlines()[-1].split(":")[0], durable.splitlines()[-1].split(":")[0], "the capture of the same press")
    contains(scand.ask("info", scand.recording("before")), "complete")


@chapter.step("removed, it stops all units and leaves configuration and recordings")
def removed():
    since = scand.now()
    scand.ask("session", "start", "last")
    scand.ask("trigger")
    unit = plugged[0].unit
    until("the foot switch's unit is active", lambda: scand.active(unit) == "active")
    run("apt-get", "remove", "--yes", "scand", timeout=300)
    for name in ("scand.service", "scand.socket", unit):
        expect(scand.active(name), "inactive", name)
    contains(scand.said(since), "Deactivated successfully")
    expect(service.SOCKET.exists(), False, "the socket")
    expect(scand.CONFIGURATION.exists(), True, "the configuration")
    scand.recording("last")
    expect([name for name in os.listdir(scand.RECORDINGS) if name.endswith(".part")], [], "recordings not completed")


@chapter.step("installed again, the rig is at work without a boot, and so is the foot switch")
def installed_again():
    service.install()
    for name in ("scand.socket", "scand.service", plugged[0].unit):
        until(f"{name} is active", lambda name=name: scand.active(name) == "active")
    contains(scand.ask("trigger"), "durable in /var/lib/scand/recordings/")


@chapter.step("purged, it leaves the recordings as root's, and no user, no group, no rule")
def purged():
    run("apt-get", "purge", "--yes", "scand", timeout=300)
    expect(scand.CONFIGURATION.exists(), False, "the configuration")
    path = scand.recording("last")
    expect((path.stat().st_uid, path.parent.stat().st_uid), (0, 0), "the owner of the recordings")
    expect([user.pw_name for user in pwd.getpwall() if user.pw_name == "scand"], [], "the user")
    expect([group.gr_name for group in grp.getgrall() if group.gr_name == "scand"], [], "the group")
    for folder in ("/lib/udev/rules.d", "/lib/systemd/system", "/usr/lib/sysusers.d", "/etc/systemd/system"):
        expect([str(path) for path in Path(folder).rglob("*scand*")], [], f"what is left in {folder}")
