"""Eleven cameras of five megapixels, whose every byte is known: what they are called, what is captured of them, and what
becomes of a rig that is unplugged as a whole."""

import json
import os
from pathlib import Path

import scand
import vivid
from harness import Chapter, Unexpected, contains, expect, run, until

SIZE = (2560, 1920)
# Formats of the eleven.
CODES = ["RGGB"] * 6 + ["GRBG", "GREY", "YUYV", "UYVY", "RGB3"]
cables = []


def name(index):
    return f"c{index:02d}"


def end():
    scand.clear()
    for cable in cables:
        cable.stop()
    vivid.unload()


chapter = Chapter("video", end)


DEFAULTS = "[v4l2.defaults]\nbuffers = 4\n"


def section(index, size, code, /, controls=None, **others):
    """A camera's part of a configuration; `others` change it."""
    fields = {"device": str(vivid.capture(index)), "size": list(size), "pixel_format": vivid.PIXELS[code], **others}
    lines = [f"[v4l2.cameras.{name(index)}]"] + [f"{key} = {json.dumps(value)}" for key, value in fields.items()]
    lines += [f"[v4l2.cameras.{name(index)}.controls]"] + [f"{key} = {value}" for key, value in (controls or {}).items()]
    return "\n".join(lines) + "\n"


@chapter.step("our rules name a camera by its port and by its serial number, and nothing that is no camera")
def names():
    rule = Path("/run/udev/rules.d/65-rig-vm-serial.rules")
    # As usb_id finds it at a camera that has one.
    rule.parent.mkdir(parents=True, exist_ok=True)
    rule.write_text('SUBSYSTEM=="video4linux", ATTR{name}=="vivid-000-vid-*", ENV{ID_SERIAL_SHORT}="V000"\n')
    # Alone: all of vivid's cameras are at one port.
    vivid.load([vivid.CABLE])
    rule.unlink()
    found = sorted(str(path.relative_to("/dev/scand")) for path in Path("/dev/scand").rglob("*") if path.is_symlink())
    expect(found, ["port/platform-vivid_0", "serial/V000"], "names below /dev/scand")
    for link in found:
        expect(os.path.realpath(f"/dev/scand/{link}"), os.path.realpath(vivid.capture(0)), link)
    run("udevadm", "control", "--reload")


@chapter.step("eleven cameras of 2560x1920 in six formats take a capture, each picture as it was fed, byte for byte")
def eleven():
    vivid.unload()
    vivid.load([vivid.CABLE] * 11)
    pictures = {}
    for index, code in enumerate(CODES):
        cables.append(vivid.Cable(index, *SIZE, code))
        pictures[name(index)] = vivid.picture(index, *SIZE, code)
        cables[index].feed(pictures[name(index)])
    sections = [section(index, SIZE, code, silence_ms=30000.0) for index, code in enumerate(CODES)]
    scand.configure(DEFAULTS + "".join(sections), {name(index): SIZE for index in range(11)})
    scand.start()
    scand.ask("session", "start", "eleven")
    scand.ask("trigger")
    scand.ask("session", "close")
    recording, frames = scand.recording("eleven"), 0
    for camera, picture in pictures.items():
        found = scand.pictures(recording, f"/color/{camera}/image")
        if not found or any(data != picture for data in found):
            raise Unexpected(f"camera {camera}: {len(found)} pictures, which are not the one that was fed")
        frames += len(found)
    return f"{frames} frames"


@chapter.step("all are pulled out and plugged in again: named, survived, and the next press works")
def unbound():
    since = scand.now()
    for cable in cables:
        cable.stop()
    vivid.unbind()
    words = scand.becomes("c00", "away")
    contains(scand.ask("trigger", expected=1), "camera c00")
    until("all are named", lambda: all(f"camera {name(i)}: " in scand.said(since) for i in range(11)))
    expect(scand.active(), "active", "the daemon")
    vivid.bind()
    until("all are back", lambda: "ready: 11 of 11" in scand.unit("scand.service", "StatusText")[0])
    contains(scand.ask("trigger"), "durable")
    return words.split(": ")[-1]
