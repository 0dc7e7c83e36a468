"""The daemon under systemd: its configuration, its state, its words, presses and what it recorded."""

import json
import os
import pwd
import struct
import time
from pathlib import Path

from harness import Unexpected, run, until

CONFIGURATION = Path("/etc/scand/rig.toml")
RECORDINGS = Path("/var/lib/scand/recordings")
MODELS = Path("/var/lib/scand/models")
DROP_IN = Path("/run/systemd/system/scand.service.d/rig-vm.conf")

# Under emulation nothing is fast: all patience is long, and a camera that is slow is not away.
PATIENT = """
[rig]
calibration = "calibration.toml"
[sync]
nearest_color = true
tolerance_ms = 30000.0
window_ms = 30000.0
[capture]
retry = 0
largest_skew_ms = 60000.0
patience_ms = 30000
memory_mb = 1000
[recording]
keep_free_mb = 50
"""


def configure(cameras, sizes, more="", models=0, retry=0):
    """Writes a configuration, and a calibration of plain cameras of these sizes."""
    CONFIGURATION.parent.mkdir(exist_ok=True)
    patient = PATIENT.replace("retry = 0", f"retry = {retry}")
    CONFIGURATION.write_text(f"{patient}[workers]\ncount = {models}\n{more}\n{cameras}")
    calibration = "format = 1\n"
    for index, (name, (width, height)) in enumerate(sorted(sizes.items())):
        calibration += f"""
[cameras.{name}]
size = [{width}, {height}]
focal_px = [{width * 2}.0, {width * 2}.0]
center_px = [{width / 2 - 0.5}, {height / 2 - 0.5}]
distortion_model = "plumb_bob"
distortion = []
translation = [{index * 0.1:.1f}, 0.0, 1.0]
rotation = [1.0, 0.0, 0.0, 0.0]
"""
    calibration += "\n[volume]\nmin = [-0.1, -0.1, 0.0]\nmax = [0.1, 0.1, 0.2]\n"
    (CONFIGURATION.parent / "calibration.toml").write_text(calibration)


def drop_in(text):
    """Changes the unit for a chapter, as an administrator would."""
    DROP_IN.parent.mkdir(parents=True, exist_ok=True)
    DROP_IN.write_text(text)
    run("systemctl", "daemon-reload")


def clear():
    """Ends the daemon and takes away what a chapter made."""
    run("systemctl", "stop", "scand.service", "scand.socket", timeout=300)
    run("systemctl", "reset-failed", "scand.service", "scand.socket", expected=None)
    DROP_IN.unlink(missing_ok=True)
    run("systemctl", "daemon-reload")
    for path in (CONFIGURATION, CONFIGURATION.parent / "calibration.toml"):
        path.unlink(missing_ok=True)
    for folder in (RECORDINGS, MODELS):
        run("find", folder, "-mindepth", "1", "-delete", expected=None)


def start(ready=True, seconds=300):
    """Starts socket and daemon; waits, if it is to, until it is ready for work."""
    run("systemctl", "start", "scand.socket")
    run("systemctl", "start", "--no-block", "scand.service")
    if ready:
        until("scand.service is active", lambda: active() == "active", seconds)


def unit(name, *properties):
    """Properties of a unit."""
    wanted = [f"--property={p}" for p in properties]
    lines = run("systemctl", "show", name, *wanted).splitlines()
    found = dict(line.split("=", 1) for line in lines)
    return [found.get(p, "") for p in properties]


def active(name="scand.service"):
    """Whether a unit is active, activating and so on."""
    return unit(name, "ActiveState")[0]


def now():
    """A moment, for `said`."""
    return f"@{time.time():.6f}"


def said(since, name="scand.service"):
    """What a unit, and systemd of it, said since then."""
    # Or the last lines would still be on their way into the journal.
    run("journalctl", "--sync")
    return run("journalctl", "--no-pager", "-o", "cat", f"--since={since}", "-u", name, expected=None)


def ask(*command, expected=0, timeout=300):
    """Asks the daemon."""
    return run("scand", *command, expected=expected, timeout=timeout)


def status():
    """What the daemon knows of itself."""
    return json.loads(ask("status", "--json").splitlines()[-1])["status"]


def camera(name):
    """State and words of a camera."""
    found = status()["cameras"].get(name, {})
    return found.get("state"), found.get("words", "")


def becomes(name, state, seconds=300):
    """Waits for a camera's state, and gives its words of that moment."""

    def reached():
        found = camera(name)
        return [found[1]] if found[0] == state else None

    return until(f"camera {name} is {state}", reached, seconds)[0]


def captures():
    """How many captures there were, and how many of them failed."""
    found = status()
    return found["complete"] + found["failed"], found["failed"]


def next_capture(before, since, seconds=300, tries=1):
    """Waits for a complete capture after those, within so many tries; `since` is where the journal was then."""

    def completed(found):
        return found[0] - found[1] > before[0] - before[1]

    def ended():
        found = captures()
        return found if completed(found) or found[1] - before[1] >= tries else None

    if not completed(until("a capture has come to its end", ended, seconds)):
        raise Unexpected(f"a capture failed: {said(since)[-600:]}")


def as_user(user, *command, expected=0, groups=()):
    """Runs a command as another user."""
    options = [f"--reuid={pwd.getpwnam(user).pw_uid}", "--regid=nogroup"]
    options.append(f"--groups={','.join(groups)}" if groups else "--clear-groups")
    return run("setpriv", *options, *command, expected=expected)


def messages(path):
    """The messages of a recording that is not compressed: topic, name of the schema, and bytes."""
    schemas, topics = {}, {}

    def records(data, at, end):
        while at + 9 <= end:
            code, length = struct.unpack_from("<BQ", data, at)
            yield code, memoryview(data)[at + 9 : at + 9 + length]
            at += 9 + length

    def text(data, at):
        (length,) = struct.unpack_from("<I", data, at)
        return bytes(data[at + 4 : at + 4 + length]).decode(), at + 4 + length

    def plain(code, record):
        number = struct.unpack_from("<H", record)[0] if len(record) > 1 else 0
        if code == 3:
            schemas[number] = text(record, 2)[0].split(".")[-1]
        elif code == 4:
            topics[number] = (text(record, 4)[0], schemas.get(struct.unpack_from("<H", record, 2)[0], ""))
        elif code == 5:
            yield *topics[number], record[22:]

    data = Path(path).read_bytes()
    for code, record in records(data, 8, len(data) - 8):
        if code == 6:
            compression, at = text(record, 28)
            if compression:
                raise Unexpected(f"{path} is compressed with {compression}")
            for inner in records(record, at + 8, len(record)):
                yield from plain(*inner)
        else:
            yield from plain(code, record)


def field(message, number):
    """A field of bytes of a protobuf message."""

    def varint(at):
        value = shift = 0
        while True:
            byte = message[at]
            value |= (byte & 127) << shift
            at, shift = at + 1, shift + 7
            if byte < 128:
                return value, at

    at = 0
    while at < len(message):
        key, at = varint(at)
        kind = key & 7
        if kind == 0:
            _, at = varint(at)
        elif kind == 2:
            length, at = varint(at)
            if key >> 3 == number:
                return bytes(message[at : at + length])
            at += length
        else:
            at += {1: 8, 5: 4}[kind]
    raise Unexpected(f"a message has no field {number}")


def pictures(path, topic):
    """The pictures on a topic of a recording, as they lie there."""
    # foxglove.RawImage has them in its sixth field, foxglove.CompressedImage in its second.
    numbers = {"RawImage": 6, "CompressedImage": 2}
    return [field(data, numbers[schema]) for name, schema, data in messages(path) if name == topic]


def recording(name):
    """The complete recording of a session."""
    path = RECORDINGS / f"{name}.mcap"
    if not path.exists():
        raise Unexpected(f"no {path}, but {os.listdir(RECORDINGS)}")
    return path
