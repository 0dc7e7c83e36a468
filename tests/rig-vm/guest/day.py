"""Follows docs/installing.md and docs/operating.md as they stand: the first start, a day's work by a user who is not root,
hooks, another foot switch, another disk, and recordings that are moved."""

import json
import os
import re
import shutil
import struct
import subprocess
import tarfile
import tempfile
import time
from pathlib import Path

import scand
import service
import vivid
from harness import Chapter, Unexpected, contains, expect, run, until
from switch import Switch

PAGES = Path("/usr/share/doc/scand")
RULE = Path("/etc/udev/rules.d/60-pedal.rules")
PEDAL = Path("/etc/default/scand-pedal")
DATA = Path("/data")
SPEAKER = Path("/dev/input/by-path/platform-pcspkr-event-spkr")
plugged = {}


def end():
    while plugged:
        plugged.popitem()[1].remove()
    scand.clear()
    for path in (RULE, PEDAL):
        path.unlink(missing_ok=True)
    shutil.rmtree(DATA, ignore_errors=True)
    vivid.unload()


chapter = Chapter("day", end)


def ann(*command, expected=0):
    """Runs a command as Ann, a member of the group."""
    return run("runuser", "-u", "ann", "--", *command, expected=expected, cwd="/home/ann")


def wrong(words):
    """The subjects that a check finds wrong."""
    return sorted(line.split(":")[0].removeprefix("WRONG").strip() for line in words.splitlines() if "WRONG" in line)


@chapter.step("the example is where the page says; scand check names what it lacks until nothing is wrong but the backgrounds")
def configured():
    vivid.load([vivid.WEBCAM] * 2)
    scand.CONFIGURATION.parent.mkdir(exist_ok=True)
    shutil.copy(PAGES / "examples/rig.toml", scand.CONFIGURATION)
    contains(run("scand", "check", expected=78), "WRONG", "calibration.toml")
    service.configure()
    run("useradd", "--create-home", "ann")
    expect(wrong(run("scand", "check", "--no-speed", expected=1)), ["backgrounds"], "what is wrong at first")
    run("systemctl", "start", "scand.socket", "scand.service")
    contains(run("systemctl", "status", "--no-pager", "scand"), "ready: 2 of 2 cameras")
    contains(ann("scand", "check", expected=1), "WRONG  daemon", "sudo adduser YOU scand")
    run("adduser", "ann", "scand")
    run("adduser", "ann", "systemd-journal")
    expect(wrong(ann("scand", "check", expected=1)), ["backgrounds"], "what is wrong for one of the group")
    until("she reads the log", lambda: "camera c00 is ready: " in ann("journalctl", "-u", "scand"))


@chapter.step("a day's work by one of the group: backgrounds, a session, presses, notes, what happens, the evening")
def worked():
    contains(ann("scand", "background"), "2 background pictures")
    expect(wrong(ann("scand", "check", "--no-speed")), [], "what is wrong in the morning")
    told = Path(tempfile.mkdtemp(), "events")
    with told.open("w", encoding="utf-8") as file:
        events = subprocess.Popen(["scand", "events", "--json"], stdout=file)
    until("somebody listens", lambda: '"listening"' in told.read_text(encoding="utf-8"))
    ann("scand", "session", "start", "amphora", "--about", "operator=Ann")
    for _ in range(2):
        contains(ann("scand", "trigger"), "durable")
    ann("scand", "note", "amphora-0001", "reject")
    ann("scand", "note", "amphora-0002", "handle turned left")
    contains(ann("scand", "status"), "amphora", "c00", "c01")
    ann("scand", "session", "close")
    words = ('"accepted"', '"captured"', '"durable"', '"reject"', "handle turned left", '"session"')
    until("all is told", lambda: all(word in told.read_text(encoding="utf-8") for word in words))
    events.terminate()
    events.wait()
    info = run("scand", "info", scand.recording("amphora"))
    contains(info, "complete", "operator", "Ann", "amphora-0002")


@chapter.step("support gets one file with the log in it")
def bundled():
    bundle = Path(tempfile.mkdtemp(), "support.tar.zst")
    run("scand", "check", "--no-speed", "--bundle", bundle)
    run("zstd", "--quiet", "--decompress", "--force", bundle)
    with tarfile.open(bundle.with_suffix("")) as packed:
        journal = packed.extractfile("journal.txt").read().decode()
        names = packed.getnames()
    contains(journal, "camera c00 is ready: ", "client connected: user")
    for name in ("check.txt", "status.json", "rig.toml", "calibration.toml", "service.txt"):
        expect(name in names, True, f"{name} in the bundle")


@chapter.step("SIGHUP in a session: what was recorded is complete, and the session goes on in another file")
def reread():
    ann("scand", "session", "start", "vase")
    ann("scand", "trigger")
    since = scand.now()
    service.configure("[rig.volume]\nmin = [-0.2, -0.2, 0.0]\nmax = [0.2, 0.2, 0.3]\n")
    run("systemctl", "reload", "scand")
    until("it says so", lambda: "the changed settings are in use" in scand.said(since))
    ann("scand", "trigger")
    ann("scand", "session", "close")
    for name, captures in (("vase", ["vase-0001"]), ("vase-002", ["vase-0002"])):
        info = run("scand", "info", scand.recording(name))
        contains(info, "complete")
        expect(sorted(set(re.findall(r"vase-000\d", info))), captures, f"captures in {name}.mcap")


@chapter.step("a recording is moved, its session's name used again: each keeps its captures")
def renamed():
    old = scand.RECORDINGS / "amphora.mcap"
    old.rename(scand.RECORDINGS / "kept.mcap")
    before = scand.pictures(scand.recording("kept"), "/color/c00/image")
    ann("scand", "session", "start", "amphora")
    contains(ann("scand", "trigger"), "amphora-0001")
    contains(ann("scand", "session", "start", "kept", expected=1), "kept.mcap")
    ann("scand", "session", "close")
    expect(scand.pictures(scand.recording("kept"), "/color/c00/image"), before, "pictures of the one that was moved")
    expect(len(scand.pictures(scand.recording("amphora"), "/color/c00/image")) > 0, True, "pictures of the new one")


@chapter.step("packed by hand, by root, a recording is the same one and the daemon's still")
def packed():
    path = scand.recording("kept")
    before = path.stat()
    contains(run("scand", "pack", path), "packed from")
    after = path.stat()
    expect((after.st_uid, after.st_gid, after.st_mode), (before.st_uid, before.st_gid, before.st_mode), "owner, group, mode")
    contains(run("scand", "info", path), "complete", "amphora-0001", "amphora-0002")


def tones():
    """The speaker's events, which it tells to everybody who listens."""
    return os.open(SPEAKER, os.O_RDWR | os.O_NONBLOCK)


def heard(speaker):
    """Frequencies that were asked of the speaker since then."""
    found = []
    # The kernel keeps tones back until a report ends them (EV_SYN), which `beep` does not send.
    os.write(speaker, struct.pack("<qqHHi", 0, 0, 0, 0, 0))
    while True:
        try:
            data = os.read(speaker, 24)
        except BlockingIOError:
            return found
        kind, code, value = struct.unpack("<HHi", data[16:])
        found += [value] if (kind, code) == (0x12, 2) and value else []


def example(program, event):
    """A hook of the example configuration."""
    text = (PAGES / "examples/rig.toml").read_text(encoding="utf-8")
    found = re.search(rf'^# ({event} = \["{program}".*\])$', text, re.MULTILINE)
    if not found:
        raise Unexpected(f"the example has no {event} with {program}")
    return found[1]


def section_of(page, about):
    """The lines that a page has for a file about something: those that are indented, after these words."""
    text = (PAGES / page).read_text(encoding="utf-8").split(about, 1)[1]
    lines = re.search(r"\n( {4}.*\n(?: {4}.*\n|\n)*)", text)[1]
    return "\n".join(line[4:] for line in lines.splitlines()).strip() + "\n"


@chapter.step("hooks of the example, opened as the page says: a beep, a sound, a keyboard's LED")
def hooks():
    run("modprobe", "-a", "pcspkr", "snd-dummy")
    plugged["keyboard"] = Switch(vendor=0x1234, product=0x5678, name="a keyboard", leds=True)
    run("udevadm", "settle")
    commands = [example("beep", "captured"), example("brightnessctl", "accepted")]
    # The page names the program for a sound of one's own.
    commands.append('durable = ["aplay", "--quiet", "/usr/share/sounds/alsa/Noise.wav"]')
    # Emulated, a program takes its time to begin.
    service.configure("[hooks]\ntimeout_ms = 60000\n" + "\n".join(commands) + "\n")
    led = next(Path("/sys/class/leds").glob("*::scrolllock")) / "brightness"
    for opened in (False, True):
        if opened:
            scand.drop_in(section_of("installing.md", "### Hooks"))
        since, speaker = scand.now(), tones()
        run("systemctl", "restart", "scand")
        until("the daemon is active", lambda: scand.active() == "active")
        ann("scand", "trigger")
        if not opened:
            # Closed as the sandbox is, each of them fails, and the log says so.
            for hook in ("captured", "accepted", "durable"):
                until(f"the log names {hook}", lambda h=hook, t=since: f"hooks.{h}: " in scand.said(t))
            expect((led.read_text().strip(), heard(speaker)), ("0", []), "the LED and the speaker of a closed sandbox")
    until("the LED is on", lambda: led.read_text().strip() == "1")
    until("there was a beep", lambda: 880 in heard(speaker))
    time.sleep(2)
    if "hooks." in scand.said(since):
        raise Unexpected(scand.said(since))


KEY_C = 46


@chapter.step("another foot switch, known by a rule of one's own as the page has it, with a second key that rejects")
def another_switch():
    switch = plugged["switch"] = Switch(vendor=0xABCD, product=0x0123, name="another switch")
    expect(scand.active(switch.unit), "inactive", "a unit for a switch that nobody knows")
    RULE.write_text(section_of("installing.md", "60-pedal.rules"), encoding="ascii")
    PEDAL.write_text(section_of("installing.md", "/etc/default/scand-pedal"), encoding="ascii")
    since = scand.now()
    run("udevadm", "control", "--reload")
    run("udevadm", "trigger", "-s", "input")
    until("its unit is active", lambda: scand.active(switch.unit) == "active")
    until("it found the daemon", lambda: "the daemon answers" in scand.said(since, switch.unit))
    before = scand.captures()
    switch.press()
    scand.next_capture(before, since)
    switch.key(1, KEY_C)
    time.sleep(0.2)
    switch.key(0, KEY_C)
    until("it is rejected", lambda: ": rejected" in scand.said(since, switch.unit))


@chapter.step("recordings on another disk, as the page has it")
def another_disk():
    folder = DATA / "recordings"
    folder.mkdir(parents=True)
    shutil.chown(folder, "scand", "scand")
    run("systemctl", "stop", "scand")
    service.configure()
    text = scand.CONFIGURATION.read_text(encoding="utf-8")
    text = text.replace("[recording]\n", f'[recording]\nfolder = "{folder}"\n')
    scand.CONFIGURATION.write_text(text, encoding="utf-8")
    scand.drop_in("[Service]\n")
    since = scand.now()
    run("systemctl", "start", "scand")
    contains(ann("scand", "trigger", expected=1), str(folder), "Read-only file system")
    contains(scand.said(since), str(folder), "Read-only file system")
    scand.drop_in(section_of("installing.md", "### Another disk"))
    run("systemctl", "restart", "scand")
    contains(ann("scand", "trigger"), f"durable in {folder}/")
