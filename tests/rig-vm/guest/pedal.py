"""Foot switches: plugged in they start their unit, pressed they are one capture each however they bounce, pulled out
they stop it. One is made with uinput, the other is a USB device; and the Kinect's rule, for which a USB device will do."""

import grp
import os
import stat
import time
from pathlib import Path

import scand
import service
import vivid
from harness import Chapter, Unexpected, expect, run, until
from switch import Switch
from usb import Gadget

KEY_B_OF_USB = 5
plugged = {}


def end():
    for device in list(plugged):
        plugged.pop(device).remove()
    scand.clear()
    vivid.unload()


chapter = Chapter("pedal", end)


def access(path):
    """Group and mode of a device."""
    found = Path(path).stat()
    return grp.getgrgid(found.st_gid).gr_name, stat.S_IMODE(found.st_mode)


def one_capture(switch_unit, press):
    """Presses, and holds that it was one capture, and no more than one press."""
    before, since = scand.captures(), scand.now()
    found = press()
    scand.next_capture(before, since)
    until("it is told", lambda: ": durable" in scand.said(since, switch_unit))
    # A second one would have begun by now, or been told that the daemon is busy.
    time.sleep(0.5)
    words = scand.said(since, switch_unit)
    count = (scand.captures()[0] - before[0], words.count("busy"), words.count(": durable"))
    return count, found


@chapter.step("the rules know a foot switch and a Kinect, and leave others alone")
def rules():
    plugged["stranger"] = Switch(vendor=0x1234, product=0x5678, name="a keyboard")
    plugged["switch"] = Switch()
    plugged["kinect"] = Gadget(0x045E, 0x02AE, "Xbox NUI Camera")
    plugged["kinect"].plug_in()
    expect(access(plugged["switch"].device), ("scand", 0o660), "group and mode of a foot switch")
    expect(access(plugged["stranger"].device), ("input", 0o660), "group and mode of a keyboard")
    expect(scand.active(plugged["stranger"].unit), "inactive", "a unit for a keyboard")
    kinects = until("a Kinect has a name", lambda: list(Path("/dev/scand").glob("depth/*")))
    expect(len(kinects), 1, "Kinects with a name")
    node = os.path.realpath(kinects[0])
    expect(access(node), ("plugdev", 0o660), "group and mode of a Kinect")
    for device in list(plugged):
        plugged.pop(device).remove()
    expect([path.name for path in Path("/dev/scand").glob("depth/*")], [], "a Kinect that was pulled out")
    return f"a Kinect at {kinects[0].name}"


@chapter.step("plugged in, a foot switch starts its unit, which finds the daemon")
def begins():
    vivid.load([vivid.WEBCAM] * 2)
    service.configure()
    scand.start()
    since = scand.now()
    switch = plugged["switch"] = Switch()
    until("its unit is active", lambda: scand.active(switch.unit) == "active")
    until("it found the daemon", lambda: "the daemon answers" in scand.said(since, switch.unit))
    return switch.unit


@chapter.step("a press is one capture: held, with the key's repeats, and with bounces of 1 to 49 ms")
def bounces():
    switch = plugged["switch"]

    def held():
        switch.key(1)
        for _ in range(20):
            time.sleep(0.03)
            switch.key(2)
        switch.key(0)

    count, _ = one_capture(switch.unit, held)
    expect(count, (1, 0, 1), "captures, busy answers and durable ones of a key that is held")
    trains = [[], [1] * 5, [2, 3, 5, 7], [10] * 6, [20] * 4, [30, 1, 30, 1], [40] * 3, [45, 2], [49]]
    shown = 0
    for train in trains:
        for _ in range(10):
            count, longest = one_capture(switch.unit, lambda t=train: switch.press(t))
            # Under emulation a pause may become longer than it was meant: then it was no bounce, and shows nothing.
            if longest < 50:
                expect(count, (1, 0, 1), f"captures, busy answers and durable ones of a press with bounces of {train} ms")
                shown += 1
                break
    if shown < len(trains) // 2:
        raise Unexpected(f"only {shown} of {len(trains)} trains of bounces were as fast as they were meant")
    return f"{shown} trains of bounces"


@chapter.step("pressed while the daemon is away, it gives up soon, and no capture comes late")
def early():
    switch = plugged["switch"]
    run("systemctl", "stop", "scand.service", "scand.socket")
    since = scand.now()
    switch.press()
    until("it is given up", lambda: "no capture was taken" in scand.said(since, switch.unit))
    scand.start()
    time.sleep(1)
    expect(scand.status()["complete"], 0, "captures after the start")
    until("it found the daemon", lambda: "the daemon answers" in scand.said(since, switch.unit))
    count, _ = one_capture(switch.unit, switch.press)
    expect(count, (1, 0, 1), "captures, busy answers and durable ones of the next press")


@chapter.step("a daemon that was stopped stays so until there is a press, which starts it")
def stopped():
    switch = plugged["switch"]
    since = scand.now()
    run("systemctl", "stop", "scand.service")
    until("the end is told", lambda: "the daemon was told to stop" in scand.said(since, switch.unit))
    time.sleep(5)
    expect(scand.active(), "inactive", "the daemon, whose socket is still there")
    switch.press()
    until("the daemon is active", lambda: scand.active() == "active")
    until("it found the daemon", lambda: "the daemon answers" in scand.said(since, switch.unit))
    ends = ("no capture was taken", "whether a capture was taken is not known", ": durable", ": failed", "refused")
    until("that press is over", lambda: any(end in scand.said(since, switch.unit) for end in ends))
    count, _ = one_capture(switch.unit, switch.press)
    expect(count, (1, 0, 1), "captures, busy answers and durable ones of the next press")


@chapter.step("pulled out, it stops its unit")
def ends():
    switch = plugged.pop("switch")
    unit = switch.unit
    switch.remove()
    until("its unit has ended", lambda: scand.active(unit) in ("inactive", "failed"))
    # Longer than a unit that failed would wait to begin again.
    time.sleep(2)
    expect(scand.active(unit), "inactive", "its unit")


@chapter.step("the same with a USB device: plugged in, pressed, pulled out")
def usb():
    gadget = plugged["gadget"] = Gadget(0x0C45, 0x7403, "FootSwitch")
    before, since = set(Path("/dev/input").glob("event*")), scand.now()
    gadget.plug_in()
    device = until("it is an input device", lambda: set(Path("/dev/input").glob("event*")) - before).pop()
    unit = f"scand-pedal@{device.name}.service"
    until("its unit is active", lambda: scand.active(unit) == "active")
    # Active is the unit before the switch is open.
    until("it found the daemon", lambda: "the daemon answers" in scand.said(since, unit))

    def press():
        gadget.report(KEY_B_OF_USB)
        time.sleep(0.2)
        gadget.report(0)

    for _ in range(2):
        count, _ = one_capture(unit, press)
        expect(count, (1, 0, 1), "captures, busy answers and durable ones of a press")
    gadget.pull_out()
    until("its unit has ended", lambda: scand.active(unit) in ("inactive", "failed"))
    gadget.plug_in()
    until("its unit is active again", lambda: scand.active(unit) == "active")
