"""A whole rig: V4L2 and GigE Vision cameras and a depth camera play a recording, and a foot switch is pressed. What is
captured is what was played, and a model is made of it."""

import json
import re
import shutil
from pathlib import Path

import scand
import vivid
from gige import Cameras
from harness import Chapter, Unexpected, contains, expect, run, until
from switch import Switch

SOURCE = Path("/rig-vm/rig.mcap")
SIZE = (640, 480)
CABLES, CAMERAS = 3, 11
# On a machine that is slow a GigE Vision camera may lose packets or miss a heartbeat; it is back soon, and the daemon takes
# such a capture once more by itself.
RETRIES = 3
DRIVERS = Path("/usr/lib/x86_64-linux-gnu/OpenNI2/Drivers")
FRAMES = Path("/run/rig-vm-frames")
parts = {}


def end():
    if "switch" in parts:
        parts.pop("switch").remove()
    scand.clear()
    switch_off()
    vivid.unload()


chapter = Chapter("mixed", end)


def show(what):
    """Lets all cameras see the rig, empty (`background`) or with an object in it (`image`)."""
    for index, cable in enumerate(parts["cables"]):
        cable.feed(scand.pictures(SOURCE, f"/color/c{index:02d}/{what}")[0])
    parts["cameras"].order({"background": "background", "image": "captures"}[what])


def switch_off():
    """Takes all cameras but the depth camera away."""
    if "cameras" in parts:
        vivid.unbind()
        for cable in parts.pop("cables", []):
            cable.stop()
        parts.pop("cameras").stop()


def configuration(models):
    cameras = ""
    for index in range(CAMERAS):
        if index < CABLES:
            cameras += f'[v4l2.cameras.c{index:02d}]\ndevice = "{vivid.capture(index)}"\nsize = {list(SIZE)}\n'
            cameras += 'pixel_format = "bayer_rggb8"\nsilence_ms = 30000.0\n'
        else:
            cameras += f'[aravis.cameras.c{index:02d}]\naddress = "127.0.1.{index + 1}"\n'
    cameras += '[aravis.defaults]\ntransfer = "srgb"\npacket_size = 9000\n[openni2.cameras.kinect]\ndevice = "any"\n'
    cameras += "silence_ms = 30000.0\n"
    # Cells of the size that pictures of 640x480 carry: an emulated processor has half the work with them.
    scand.configure(cameras, {}, "time_limit_s = 3000\n[hull]\nresolution = 80.0\n", models, RETRIES)
    calibration = scand.CONFIGURATION.parent / "calibration.toml"
    run("scand", "info", SOURCE, "--calibration", calibration, "--force")


@chapter.step("eight GigE Vision cameras, three V4L2 ones and a depth camera are one rig, ready for work")
def ready():
    shutil.copy("/rig-vm/libScandSensor.so.0", DRIVERS)
    parts["cameras"] = Cameras(SOURCE, "--sensor-frames", FRAMES)
    vivid.load([vivid.CABLE] * CABLES)
    parts["cables"] = [vivid.Cable(index, *SIZE, "RGGB") for index in range(CABLES)]
    show("background")
    scand.drop_in(f"[Service]\nEnvironment=SCAND_OPENNI2_FRAMES={FRAMES}\n")
    configuration(models=1)
    scand.start()
    # Emulated, one may be away for a moment even after that.
    until("all are there", lambda: "ready: 12 of 12 cameras" in scand.unit("scand.service", "StatusText")[0])


@chapter.step("scand check finds nothing wrong but that there are no backgrounds, which are taken then")
def plates():
    until("only the backgrounds are wrong", lambda: [f["subject"] for f in wrong()] == ["backgrounds"])
    until("backgrounds are taken", lambda: "background pictures in" in scand.ask("background", expected=None))
    until("nothing is wrong", lambda: not wrong())


def wrong():
    """What `scand check` finds wrong."""
    findings = json.loads(scand.ask("check", "--json", "--no-speed", expected=None))["findings"]
    return [finding for finding in findings if finding["state"] == "wrong"]


@chapter.step("a foot switch is pressed: all take one capture together, of what was played to them")
def pressed():
    show("image")
    scand.ask("session", "start", "cup")
    parts["since"] = scand.now()
    parts["switch"] = Switch()
    unit = parts["switch"].unit
    until("the switch found the daemon", lambda: "the daemon answers" in scand.said(parts["since"], unit))
    before = scand.captures()
    parts["switch"].press()
    scand.next_capture(before, parts["since"], 900, 1 + RETRIES)
    scand.ask("session", "close")
    recording = scand.recording("cup")
    for index in range(CAMERAS):
        topic = f"/color/c{index:02d}/image"
        played, found = scand.pictures(SOURCE, topic), scand.pictures(recording, topic)
        if not found or found[-1] not in played:
            raise Unexpected(f"camera c{index:02d}: {len(found)} pictures, the last of which was not played")
    depth = len(scand.pictures(recording, "/depth/kinect/image"))
    if depth < 10:
        raise Unexpected(f"{depth} depth frames")
    return f"{CAMERAS} pictures byte for byte, {depth} depth frames"


@chapter.step("and a model is made of it, under systemd, in the workers' sandbox, the cameras switched off meanwhile")
def modelled():
    # A worker comes after all others: emulated, eleven cameras leave it next to nothing of a processor.
    switch_off()
    done = until(
        "the model is made",
        lambda: re.search(r"capture (cup-0001(?:\.r\d)?): (.*?), (/.*)|its model could not be made: .*", scand.said(parts["since"])),
        2400,
    )
    if not done[1]:
        raise Unexpected(done[0])
    folder = Path(done[3])
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    expect((folder / "model.glb").read_bytes()[:4], b"glTF", "the model")
    stages = " ".join(f"{stage['stage']} {stage['seconds']:.0f}" for stage in report["timing"]["stages"])
    return f"{done[2]}: {', '.join(r['words'] for r in report['verdict']['reasons']) or 'no problem was found'}; {stages}"
