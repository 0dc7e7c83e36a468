"""Two webcams: controls, what is refused, and what becomes of one that loses frames, breaks or goes."""

import time

import scand
import vivid
from harness import Chapter, Unexpected, contains, expect, run, until
from video import DEFAULTS, name, section

SIZES = [(640, 360), (1280, 720)]


def end():
    scand.clear()
    vivid.unload()


chapter = Chapter("webcam", end)


def webcams(controls=None, **others):
    """A configuration of both webcams, the first one changed."""
    first = section(0, SIZES[0], "YUYV", controls, **({"silence_ms": 4000.0} | others))
    second = section(1, SIZES[1], "YUYV", silence_ms=30000.0)
    scand.configure(DEFAULTS + first + second, {name(index): size for index, size in enumerate(SIZES)})


@chapter.step("controls of a webcam are set, and what another program reads is what was set")
def controls():
    vivid.load([vivid.WEBCAM] * 2)
    vivid.control(0, brightness=10, contrast=11)
    wanted = {"brightness": 77, "contrast": 99, "saturation": 3}
    webcams(wanted, gain=42)
    scand.start()
    for control, value in (wanted | {"gain": 42, "gain_automatic": 0}).items():
        expect(vivid.read(0, control), value, control)
    contains(scand.ask("status", "--json"), '["brightness","77","77"]')
    contains(scand.ask("trigger"), "durable")


# What a camera is asked for, and the words that refuse it.
REFUSED = [
    # This one the kernel refuses in silence: it answers with the format that there was before.
    ({"pixel_format": "mjpeg"}, ["format: asked for 640 x 360, jpeg", "YUYV"]),
    ({"size": [641, 360]}, ["format: asked for 641 x 360", "640 x 360"]),
    ({"rate": 29.0}, ["rate: asked for 29/s"]),
    ({"controls": {"shine": 3}}, ["shine", "no such control", "brightness"]),
    ({"controls": {"brightness": 300}}, ["brightness: asked for 300", "0 to 255"]),
]


@chapter.step("what a camera does not take is refused by name: a format, a size, a rate, a control and a value")
def refused():
    scand.clear()
    vivid.unload()
    vivid.load([vivid.WEBCAM] * len(REFUSED))
    cameras = [section(i, SIZES[0], "YUYV", **change) for i, (change, _) in enumerate(REFUSED)]
    scand.configure(DEFAULTS + "".join(cameras), {name(i): SIZES[0] for i in range(len(REFUSED))})
    scand.start(ready=False)
    for index, (_, words) in enumerate(REFUSED):
        contains(scand.becomes(name(index), "away"), *words)
    contains(scand.unit("scand.service", "StatusText")[0], "not ready: 0 of 5")


@chapter.step("a camera that drops frames is counted, one that drops all is away, and back when it does not")
def dropped():
    scand.clear()
    vivid.unload()
    vivid.load([vivid.WEBCAM] * 2)
    webcams()
    vivid.control(0, percentage_of_dropped_buffers=50)
    scand.start()
    since = scand.now()
    scand.ask("trigger")
    for _ in range(8):
        if "frames before number" in scand.said(since):
            break
        scand.ask("trigger")
    contains(scand.said(since), "camera c00: lost: ", "never came")
    vivid.control(0, percentage_of_dropped_buffers=100)
    contains(scand.becomes("c00", "away"), "no whole frame for 4.0 s")
    contains(scand.ask("trigger", expected=1), "camera c00")
    vivid.control(0, percentage_of_dropped_buffers=0)
    scand.becomes("c00", "ready")
    contains(scand.ask("trigger"), "durable")


@chapter.step("a camera that breaks in the middle, or is pulled out, is named and comes back by itself")
def broken():
    words = []
    for fault in ("inject_fatal_streaming_error", "disconnect"):
        since = scand.now()
        vivid.control(0, **{fault: 1})
        until(f"c00 is named after {fault}", lambda since=since: "camera c00: " in scand.said(since))
        words.append(scand.said(since).splitlines()[0].split(": ")[-1])
        scand.becomes("c00", "ready")
        contains(scand.ask("trigger"), "durable")
    return "; ".join(words)


@chapter.step("numbers of frames that wrap around are no loss")
def wrapped():
    run("systemctl", "stop", "scand.service")
    vivid.control(0, wrap_sequence_number=1)
    since = scand.now()
    scand.start()
    for _ in range(3):
        contains(scand.ask("trigger"), "durable")
        time.sleep(2)
    for line in scand.said(since).splitlines():
        if "c00" in line and "never came" in line:
            raise Unexpected(line)
    vivid.control(0, wrap_sequence_number=0)
