"""Reads recordings (MCAP): each capture's pictures, depth, lenses, poses and notes."""

import io
import json
import re
import struct
import warnings
from bisect import bisect_right
from dataclasses import dataclass, field, replace
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.stream_reader import breakup_chunk

from .protobuf import Schema

_MAGIC = b"\x89MCAP0\r\n"
#: The format of recordings that is read.
_FORMAT = "1"
#: The records that are looked at, by their opcodes; DATA_END is where the data end.
_RECORDS = {3: records.Schema, 4: records.Channel, 5: records.Message, 6: records.Chunk, 12: records.Metadata}
_MESSAGE, _CHUNK, _DATA_END = 5, 6, 15
#: What the chunks of a file may hold when they are unpacked, in bytes: this, and this many times the file's length.
_UNPACKED, _UNPACKED_TIMES = 512 << 20, 100
#: The topics of the format; what other programs add may have any name and any encoding.
_TOPIC = re.compile(
    "/(tf|volume|trigger|capture|note|log"
    "|color/[a-z0-9_-]{1,32}/(image|background|mask|ignore|calibration|settings)"
    "|depth/[a-z0-9_-]{1,32}/(image|color|calibration|response))"
)
#: A capture's id becomes the name of a folder.
_CAPTURE_ID = re.compile("[A-Za-z0-9_-][A-Za-z0-9._-]{0,63}")

#: A frame of a capture may begin this much before the trigger, and must begin this soon after it, in nanoseconds.
_TOLERANCE_NS = 5_000_000
_WINDOW_NS = 2_000_000_000
#: Frames of a depth camera, where a capture does not list them.
_DEPTH_FRAMES = 30
#: Largest file of notes that is read, in bytes, and most of its problems that are told.
_LARGEST_NOTES = 16 << 20
_MOST_PROBLEMS = 20


@dataclass
class Lens:
    """A camera's lens. Pixel centres are at whole numbers."""

    width: int
    height: int
    #: (3, 3), without skew.
    matrix: np.ndarray
    #: `plumb_bob` or `rational_polynomial`.
    model: str
    #: k1, k2, p1, p2, k3 and, of the second model, k4 to k6.
    distortion: np.ndarray

    def project(self, points):
        """(n, 2) pixels of (n, 3) points in the camera's frame (x right, y down, z ahead)."""
        points = np.asarray(points, float)
        x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
        k1, k2, p1, p2, k3, k4, k5, k6 = np.concatenate([self.distortion, np.zeros(8 - len(self.distortion))])
        r = x * x + y * y
        radial = (1 + r * (k1 + r * (k2 + r * k3))) / (1 + r * (k4 + r * (k5 + r * k6)))
        u = x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x)
        v = y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y
        return np.stack([u, v], axis=1) * [self.matrix[0, 0], self.matrix[1, 1]] + self.matrix[:2, 2]


@dataclass
class ColorView:
    """What a colour camera saw of a capture."""

    #: (height, width) of raw or grey pixels or (height, width, 3), uint8; bytes of a file without Pillow.
    picture: np.ndarray | bytes
    #: The recording's word for the pixels, such as `bayer_rggb8`, `rgb8` or `jpeg`.
    encoding: str
    #: Nanoseconds since 1970.
    time_ns: int
    lens: Lens | None
    #: (4, 4): takes points of the camera's frame into the rig's.
    rig_from_camera: np.ndarray | None
    #: (height, width) uint8, 128 and more is object; None if the recording has none.
    mask: np.ndarray | None
    #: (height, width) uint8, 128 and more is unknown, because a prop is in front; None if the recording has none.
    ignored: np.ndarray | None
    #: The view of the empty rig, as `picture`; None if the recording has none.
    background: np.ndarray | bytes | None


@dataclass
class DepthView:
    """What a depth camera saw of a capture."""

    #: (frames, height, width) uint16; 0 is no reading.
    readings: np.ndarray
    #: Nanoseconds since 1970, of each frame.
    times_ns: list
    lens: Lens | None
    #: (4, 4): takes points of the camera's frame into the rig's.
    rig_from_camera: np.ndarray | None
    #: What turns a reading into metres: `slope`, `intercept`, `scale`, perhaps `range` and `uncertainty`.
    response: dict

    def metres(self, readings):
        """Metres along the optical axis, nan where there is no reading or the response does not hold."""
        readings = np.asarray(readings)
        z = self.response["slope"] * readings + self.response["intercept"]
        low, high = self.response.get("range") or (0.0, np.inf)
        return np.where((readings > 0) & (z >= low) & (z <= high), z, np.nan)


@dataclass
class Capture:
    """A capture with its frames."""

    id: str
    #: Nanoseconds since 1970.
    time_ns: int
    #: The object's number, if it was given.
    subject: str | None
    #: How the object lay, in a person's words, if they were given.
    placement: str | None
    #: `complete`, `failed` or None where the recording does not say.
    outcome: str | None
    #: Colour cameras by their ids.
    colors: dict = field(default_factory=dict)
    #: Depth cameras by their ids.
    depths: dict = field(default_factory=dict)
    #: Notes in the order of their times, as dictionaries with `time_ns`, `kind`, `text` and perhaps `author`.
    notes: list = field(default_factory=list)

    def decision(self):
        """`accept` or `reject`, the last of which holds, or None."""
        said = [note["kind"] for note in self.notes if note["kind"] in ("accept", "reject", "clear")]
        return said[-1] if said and said[-1] != "clear" else None


class Recording:
    """A recording that is held in memory. What is missing of a damaged one, and notes beside it that are left out, are told by
    `warnings.warn`."""

    def __init__(self, path):
        self.path = Path(path)
        self._schemas = {}
        #: Messages of each topic: (log time, message as a dictionary), in the order of their times.
        self._messages = {}
        #: Metadata records by name; of several of one name the last.
        self.metadata = {}
        schemas, channels, undefined = {}, {}, 0
        for record in _records(self.path):
            if isinstance(record, records.Schema):
                schemas[record.id] = record
            elif isinstance(record, records.Channel):
                channels[record.id] = record
            elif isinstance(record, records.Metadata):
                self.metadata[record.name] = dict(record.metadata)
                self._check_format()
            elif (channel := channels.get(record.channel_id)) and not _TOPIC.fullmatch(channel.topic):
                continue
            elif channel and channel.schema_id in schemas:
                decoded = self._decode(schemas[channel.schema_id], channel, record)
                self._messages.setdefault(channel.topic, []).append((record.log_time, decoded))
            else:
                undefined += 1
        if undefined:
            warnings.warn(f"{path}: {undefined} messages have no channel or no schema and are left out", stacklevel=2)
        for messages in self._messages.values():
            messages.sort(key=lambda pair: pair[0])
        #: What was noted beside the recording: (time, note).
        self._beside = self._read_beside()

    def _check_format(self):
        """Refuses a recording of another format; one that names none has format 1."""
        found = self.metadata.get("scand", {}).get("format", _FORMAT)
        if found != _FORMAT:
            told = f"{self.path} has the unknown format {found[:40]!r}, expected {_FORMAT!r}"
            raise ValueError(f"{told}: a newer reader may read it")

    def _decode(self, schema, channel, message):
        if channel.message_encoding == "json":
            return json.loads(message.data)
        if schema.id not in self._schemas:
            self._schemas[schema.id] = Schema(schema.data)
        return self._schemas[schema.id].decode(schema.name, message.data)

    def topics(self):
        """The names of the format's topics that have messages."""
        return sorted(self._messages)

    def cameras(self, kind):
        """The ids of the cameras of a kind, `color` or `depth`."""
        ids = (topic.split("/") for topic in self._messages)
        return sorted({parts[2] for parts in ids if len(parts) == 4 and parts[1] == kind and parts[3] == "image"})

    def captures(self):
        """The captures, in the order of their triggers."""
        ends = {end.get("id"): end for _, end in self._messages.get("/capture", [])}
        triggers = list(self._triggers().values())
        for i, (time, trigger) in enumerate(triggers):
            until = min([time + _WINDOW_NS] + [next - _TOLERANCE_NS for next, _ in triggers[i + 1 : i + 2]])
            yield self._capture(time, until, trigger, ends.get(trigger["id"], {}))

    def session_notes(self):
        """The notes on the session, as `Capture.notes` has those on a capture."""
        return self._notes(self.metadata.get("session", {}).get("name"))

    def _triggers(self):
        """The first trigger of each id: (time, message). A trigger whose id names no folder makes no capture."""
        found = {}
        for time, trigger in self._messages.get("/trigger", []):
            id = trigger.get("id")
            if isinstance(id, str) and _CAPTURE_ID.fullmatch(id):
                found.setdefault(id, (time, trigger))
        return found

    def _capture(self, time, until, trigger, end):
        subject = trigger.get("subject")
        placement = trigger.get("placement")
        capture = Capture(
            id=trigger["id"],
            time_ns=time,
            subject=None if subject is None else str(subject),
            placement=None if placement is None else str(placement),
            outcome=end.get("outcome"),
            notes=self._notes(trigger["id"]),
        )
        listed = {id: camera.get("timestamps") for id, camera in end.get("cameras", {}).items()}
        window = range(time - _TOLERANCE_NS, until)
        for id in self.cameras("color"):
            frames = self._frames(f"/color/{id}/image", listed.get(id), window, 1)
            if frames:
                capture.colors[id] = self._color(id, *frames[0], time)
        for id in self.cameras("depth"):
            frames = self._frames(f"/depth/{id}/image", listed.get(id), window, _DEPTH_FRAMES)
            if frames:
                capture.depths[id] = self._depth(id, frames, time)
        return capture

    def _frames(self, topic, listed, window, most):
        messages = self._messages.get(topic, [])
        if listed:
            wanted = {int(time) for time in listed}
            return [pair for pair in messages if pair[0] in wanted]
        return [pair for pair in messages if pair[0] in window][:most]

    def _color(self, id, time, message, trigger):
        masks = [mask for at, mask in self._messages.get(f"/color/{id}/mask", []) if at == time]
        ignored = [mask for at, mask in self._messages.get(f"/color/{id}/ignore", []) if at == time]
        background = self._newest(f"/color/{id}/background", trigger)
        return ColorView(
            picture=_pixels(message),
            encoding=message.get("encoding") or message.get("format", ""),
            time_ns=time,
            lens=self._lens(f"/color/{id}/calibration", trigger),
            rig_from_camera=self._pose(id, trigger),
            mask=_pixels(masks[-1]) if masks else None,
            ignored=_pixels(ignored[-1]) if ignored else None,
            background=None if background is None else _pixels(background),
        )

    def _depth(self, id, frames, trigger):
        response = self._newest(f"/depth/{id}/response", trigger)
        return DepthView(
            readings=np.stack([_pixels(message) for _, message in frames]),
            times_ns=[time for time, _ in frames],
            lens=self._lens(f"/depth/{id}/calibration", trigger),
            rig_from_camera=self._pose(id, trigger),
            response=response or {"slope": 0.001, "intercept": 0.0, "scale": [1.0]},
        )

    def _newest(self, topic, time):
        """The newest message at or before a time."""
        messages = self._messages.get(topic, [])
        at = bisect_right([t for t, _ in messages], time)
        return messages[at - 1][1] if at else None

    def _lens(self, topic, time):
        message = self._newest(topic, time)
        if message is None:
            return None
        return Lens(
            width=message["width"],
            height=message["height"],
            matrix=np.reshape(message["K"], (3, 3)),
            model=message.get("distortion_model", "plumb_bob"),
            distortion=np.array(message["D"]),
        )

    def _pose(self, id, time):
        found = None
        for at, message in self._messages.get("/tf", []):
            for transform in message.get("transforms", [message]):
                if at <= time and transform.get("child_frame_id") == id:
                    found = transform
        return None if found is None else _matrix(found)

    def _notes(self, name):
        """The notes on what has this name, of both places."""
        said = [(time, note) for time, note in self._messages.get("/note", []) if note.get("capture") == name]
        said += [(time, note) for time, note in self._beside if note["capture"] == name]
        said.sort(key=lambda pair: pair[0])
        keys = ("kind", "text", "author")
        return [{"time_ns": time, **{k: note[k] for k in keys if k in note}} for time, note in said]

    def _read_beside(self):
        """The notes of NAME.notes.jsonl, which lies beside NAME.mcap and beside NAME.mcap.part."""
        path = self.path.with_name(stem_of(self.path) + ".notes.jsonl")
        if not path.exists():
            return []
        if not path.is_file() or path.stat().st_size > _LARGEST_NOTES:
            _warn(f"{path}: it is not a file of at most {_LARGEST_NOTES} bytes, and its notes are left out")
            return []
        session = self.metadata.get("session", {}).get("name")
        expected = {session: None} | {id: time for id, (time, _) in self._triggers().items()}
        said, problems = [], []
        for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").split("\n"), 1):
            if not line.strip():
                continue
            try:
                time, trigger, note = _note(line)
            except (ValueError, TypeError, RecursionError) as error:
                problems.append(f"{path}: line {number}: it is not a note ({error}) and is left out")
                continue
            name = note["capture"]
            if name in expected and trigger == expected[name]:
                said.append((time, note))
            else:
                problems.append(
                    f"{path}: line {number}: it is about capture {name!r}, which {self.path} does not have: the line belongs to "
                    "another recording and is left out"
                )
        for problem in problems[:_MOST_PROBLEMS]:
            _warn(problem)
        if len(problems) > _MOST_PROBLEMS:
            _warn(f"{path}: {len(problems) - _MOST_PROBLEMS} more lines are left out")
        return said


def stem_of(path):
    """What names the folder of a recording's models: NAME of NAME.mcap, and of NAME.mcap.part until it is complete."""
    return Path(path.stem if path.name.endswith(".mcap.part") else path).stem


def _warn(problem):
    # The caller of Recording(path), above __init__ and what it calls.
    warnings.warn(problem, stacklevel=4)


def _note(line):
    """A line of a file of notes: the note's time, the time of the capture's trigger if it has one, and the note."""
    note = json.loads(line)
    if not isinstance(note, dict):
        raise ValueError("it is no JSON object")
    for key in ("time", "capture", "kind"):
        if not isinstance(note.get(key), str):
            raise ValueError(f"its member {key!r} is missing or no text")
    trigger = note.get("trigger")
    return int(note["time"]), None if trigger is None else int(trigger), note


def _records(path):
    """The records of a recording's data that are looked at, those of chunks too. A file that ends early is read as far as its
    records are whole, and a chunk that is damaged is left out."""
    length = path.stat().st_size
    room = _UNPACKED + _UNPACKED_TIMES * length
    with open(path, "rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise ValueError(f"{path} is no MCAP file")
        while True:
            at = file.tell()
            head = file.read(9)
            opcode, size = struct.unpack("<BQ", head) if len(head) == 9 else (0, length)
            if size > length - file.tell():
                _warn(f"{path}: it ends early: the record at byte {at} is not whole, and what follows is missing")
                return
            if opcode == _DATA_END:
                return
            if opcode not in _RECORDS:
                file.seek(size, io.SEEK_CUR)
                continue
            stream = ReadDataStream(io.BytesIO(file.read(size)))
            try:
                if opcode == _MESSAGE:
                    found = [records.Message.read(stream, size)]
                else:
                    found = [_RECORDS[opcode].read(stream)]
                if opcode == _CHUNK:
                    chunk = _unpacked(found[0], room)
                    room -= len(chunk.data)
                    found = breakup_chunk(chunk, validate_crc=True)
            except Exception as error:  # The decompressors have errors of their own.
                _warn(f"{path}: the record at byte {at} is damaged ({error or type(error).__name__}) and left out")
                continue
            yield from found


def _unpacked(chunk, room):
    """A chunk that is not packed, of at most `room` bytes. No more is unpacked than the chunk says."""
    size = chunk.uncompressed_size
    if size > room:
        raise ValueError(f"it claims {size} bytes, and {room} would be left for it")
    if chunk.compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as stream:
            data = stream.read(size + 1)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"it is packed with {chunk.compression[:40]!r}")
    if len(data) != size:
        raise ValueError(f"it does not unpack to the {size} bytes that it claims")
    return replace(chunk, compression="", data=data)


def _pixels(message):
    """The pixels of a RawImage, or of a CompressedImage if Pillow is there."""
    if "format" in message:
        try:
            from PIL import Image
        except ImportError:
            return bytes(message["data"])
        return np.array(Image.open(io.BytesIO(message["data"])))
    width, height, step = message["width"], message["height"], message["step"]
    encoding = message["encoding"]
    kind, channels = {"16UC1": ("<u2", 1), "rgb8": ("u1", 3), "bgr8": ("u1", 3)}.get(encoding, ("u1", 1))
    if encoding in ("yuv422_yuy2", "yuyv", "uyvy", "yuv422"):
        channels = 2
    row = width * channels * np.dtype(kind).itemsize
    data = np.frombuffer(message["data"], np.uint8)
    # The last row may end with its last pixel.
    if step < row or not row or not height or len(data) < step * (height - 1) + row:
        raise ValueError(f"a picture of {width}x{height} {encoding} with rows of {step} bytes has {len(data)} bytes")
    pixels = np.lib.stride_tricks.as_strided(data, (height, row), (step, 1)).copy().view(kind)
    return pixels.reshape((height, width) if channels == 1 else (height, width, channels))


def _matrix(transform):
    """The 4x4 matrix of a FrameTransform."""
    t, q = transform.get("translation", {}), transform.get("rotation", {})
    x, y, z, w = (q.get(name, 0.0) for name in "xyzw")
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = [t.get(name, 0.0) for name in "xyz"]
    return matrix
