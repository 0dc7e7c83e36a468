"""Two webcams: controls, what is refused, and what becomes of one that loses frames, breaks or goes; and a camera of
JPEG pictures in the place of one of them."""

import subprocess
import time
from pathlib import Path

import scand
import vivid
from harness import Chapter, Unexpected, contains, expect, run, until
from video import DEFAULTS, name, section

SIZES = [(640, 360), (1280, 720)]
LOOPBACK = Path("/dev/video90")
LINK = Path("/dev/rig/loopback")


def end():
    scand.clear()
    LINK.unlink(missing_ok=True)
    run("modprobe", "-r", "v4l2loopback", expected=None)
    vivid.unload()


chapter = Chapter("webcam", end)


def webcams(controls=None, **others):
    """A configuration of both webcams, the first one changed."""
    first = section(0, SIZES[0], "YUYV", controls, **({"silence_ms": 10000.0} | others))
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
    # A size that differs from the calibration's is refused before a camera is asked.
    sizes = {name(i): change.get("size", SIZES[0]) for i, (change, _) in enumerate(REFUSED)}
    scand.configure(DEFAULTS + "".join(cameras), sizes)
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
        if " before number " in scand.said(since):
            break
        scand.ask("trigger")
    contains(scand.said(since), "camera c00 lost data: ", "did not arrive")
    vivid.control(0, percentage_of_dropped_buffers=100)
    contains(scand.becomes("c00", "away"), "no complete frame arrived for 10.0 s")
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
        if "c00" in line and "did not arrive" in line:
            raise Unexpected(line)
    vivid.control(0, wrap_sequence_number=0)


@chapter.step("a camera of JPEG pictures (v4l2loopback): each is a whole file, as it was written")
def jpeg():
    run("systemctl", "stop", "scand.service")
    run("modprobe", "v4l2loopback", "video_nr=90", "card_label=loopback", "exclusive_caps=0", "max_buffers=6")
    run("udevadm", "settle")
    LINK.symlink_to(LOOPBACK)
    # Kept while nobody has it open.
    run("v4l2-ctl", "-d", LOOPBACK, "--set-ctrl", "keep_format=1")
    run("v4l2-ctl", "-d", LOOPBACK, "--set-fmt-video-out=width=640,height=480,pixelformat=MJPG")
    feeder = subprocess.Popen(["python3", "-B", "/rig-vm/feed.py", str(LOOPBACK)], stdin=subprocess.DEVNULL)
    try:
        webcams(device=str(LINK), size=[640, 480], pixel_format="mjpeg")
        scand.start()
        scand.ask("session", "start", "jpeg")
        scand.ask("trigger")
        scand.ask("session", "close")
    finally:
        feeder.terminate()
        feeder.wait()
    fed, found = jpegs(), scand.pictures(scand.recording("jpeg"), "/color/c00/image")
    if not found or not set(found) <= set(fed):
        raise Unexpected(f"{len(found)} frames, which are not all of the {len(fed)} files that were fed")
    return f"{len(found)} frames"


def jpegs():
    """The JPEG files that are fed."""
    cameras = [f"/color/c{index:02d}/image" for index in range(3)]
    return [file for camera in cameras for file in scand.pictures("/rig-vm/jpeg.mcap", camera)]
