"""The reader against files that are made here by the letter of docs/formats.md, and against the project's recording."""

import json
import struct
import sys
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from mcap import records
from mcap.writer import CompressionType, Writer

import scand
from scand.protobuf import Schema
from scand.recording import _records

RECORDING = Path(__file__).parents[2] / "recordings/cup.mcap"
GOLDEN = Path(__file__).parents[2] / "tests/golden/format-1"


def ply(path, several=False):
    """A model of one capture, or of several."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment capture a-1\ncomment title A krater\n"
        + ("comment captures a-1, a-2\n" if several else "")
        + "comment frame rig, right-handed, z up; x y z in metres\n"
        + ("comment captures bit i is 1 where\n" if several else "")
        + "element vertex 3\n"
        + "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
        + "".join(f"property uchar {name}\n" for name in ("red", "green", "blue", "provenance"))
        + "property float expected_error\n"
        + ("property uint captures\n" if several else "")
        + "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    seen = [struct.pack("<I", 1 << i) if several else b"" for i in range(3)]
    body = b"".join(struct.pack("<6f4Bf", *p, 0, 0, 1, 10, 20, 30, i, i * 1e-3) + seen[i] for i, p in enumerate(corners))
    path.write_bytes(header.encode() + body + struct.pack("<B3i", 3, 0, 1, 2))
    return path


def glb(path, generator="scand 0.1.0"):
    arrays = [
        np.array([[0, 5, 0], [1, 5, 0], [0, 5, -1]], "<f4"),
        np.array([[0, 1, 0]] * 3, "<f4"),
        np.array([0, 2, 5], "<f4"),
        np.array([1e-3, 2e-3, 3e-3], "<f4"),
        np.array([0, 1, 2], "<u4"),
    ]
    views, accessors, binary = [], [], b""
    for array in arrays:
        kind = 5125 if array.dtype == "<u4" else 5126
        shape = "VEC3" if array.ndim == 2 else "SCALAR"
        accessors.append({"bufferView": len(views), "componentType": kind, "count": len(array), "type": shape})
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes})
        binary += array.tobytes()
    names = {"POSITION": 0, "NORMAL": 1, "_PROVENANCE": 2, "_ERROR": 3}
    text = json.dumps(
        {
            "asset": {"version": "2.0", "generator": generator, "extras": {"capture": "a-1"}},
            "meshes": [{"primitives": [{"attributes": names, "indices": 4}]}],
            "accessors": accessors,
            "bufferViews": views,
        }
    ).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path


def test_a_ply_and_a_glb_are_read_with_provenance_and_error(tmp_path):
    model = scand.read_model(ply(tmp_path / "model.ply"))
    assert model.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert model.triangles.tolist() == [[0, 1, 2]]
    assert model.provenance.tolist() == [scand.HULL, scand.CARVED, scand.RESTORED]
    assert np.allclose(model.expected_error, [0, 1e-3, 2e-3])
    assert model.colors[0].tolist() == [10, 20, 30]
    assert model.about == {"capture": "a-1", "title": "A krater"}
    model = scand.read_model(glb(tmp_path / "model.glb"))
    assert model.vertices.tolist() == [[0, 0, 5], [1, 0, 5], [0, 1, 5]], "z is up"
    assert model.normals[0].tolist() == [0, 0, 1]
    assert model.provenance.tolist() == [scand.HULL, scand.RESTORED, scand.TABLE]
    assert model.about["capture"] == "a-1"


def test_a_model_of_several_captures_says_which_made_each_vertex(tmp_path):
    assert scand.read_model(ply(tmp_path / "one.ply")).captures is None
    model = scand.read_model(ply(tmp_path / "model.ply", several=True))
    assert model.captures.tolist() == [1, 2, 4] and model.triangles.tolist() == [[0, 1, 2]]
    assert model.about == {"capture": "a-1", "title": "A krater", "captures": "a-1, a-2"}


def test_other_files_are_refused_by_name(tmp_path):
    (tmp_path / "model.ply").write_bytes(b"ply\nformat ascii 1.0\nend_header\n")
    (tmp_path / "model.glb").write_bytes(b"glTF")
    (tmp_path / "model.obj").write_bytes(b"v 0 0 0\n")
    glb(tmp_path / "other.glb", "Blender")
    for name in ("model.ply", "model.glb", "model.obj", "other.glb"):
        with pytest.raises(ValueError, match=name):
            scand.read_model(tmp_path / name)


def test_a_report_is_read_from_a_folder(tmp_path):
    (tmp_path / "report.json").write_text('{"verdict": {"level": "green"}}')
    assert scand.read_report(tmp_path)["verdict"]["level"] == "green"


def test_the_projects_recording_is_read_as_arrays():
    recording = scand.Recording(RECORDING)
    [capture] = recording.captures()
    assert len(capture.colors) == 11 and len(capture.depths) == 1
    [depth] = capture.depths.values()
    assert depth.readings.shape == (30, 480, 640) and depth.readings.dtype == np.uint16
    metres = depth.metres(depth.readings[0])
    assert 0.5 < np.nanmedian(metres) < 1.5
    assert np.isnan(metres[depth.readings[0] == 0]).all()
    for view in [*capture.colors.values(), depth]:
        rotation = view.rig_from_camera[:3, :3]
        assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        # The camera looks at the middle of the rig, so that this lies in its picture.
        middle = np.linalg.inv(view.rig_from_camera) @ [0, 0, 0.05, 1]
        [[u, v]] = view.lens.project([middle[:3]])
        assert 0 < u < view.lens.width and 0 < v < view.lens.height


def test_a_capture_that_lists_no_frames_ends_at_the_next_trigger():
    recording = scand.Recording(RECORDING)
    [whole] = recording.captures()
    [times] = [view.times_ns for view in whole.depths.values()]
    next = times[20]
    # The same id again makes no capture.
    recording._messages["/trigger"] += [(next - 1, {"id": whole.id}), (next, {"id": "next"})]
    first, second = recording.captures()
    assert [list(view.times_ns) for view in first.depths.values()] == [times[:20]]
    assert [list(view.times_ns) for view in second.depths.values()] == [times[20:]]
    assert first.colors.keys() == whole.colors.keys() and not second.colors
    recording._messages["/capture"] = [(0, {"id": "next", "cameras": {"kinect": {"timestamps": [str(times[0])]}}})]
    _, second = recording.captures()
    assert [list(view.times_ns) for view in second.depths.values()] == [times[:1]]


def note(capture, **other):
    """A line of a file of notes."""
    known = {"time": "5", "trigger": str(capture.time_ns), "capture": capture.id, "kind": "reject", "text": ""}
    return json.dumps(known | other) + "\n"


def linked(path):
    """The project's recording under another name, and its capture."""
    path.symlink_to(RECORDING)
    [capture] = scand.Recording(path).captures()
    assert capture.decision() is None
    return path, capture


def test_notes_beside_a_recording_count_if_they_are_of_it(tmp_path):
    copy, capture = linked(tmp_path / "cup.mcap")
    (tmp_path / "cup.notes.jsonl").write_text(note(capture) + note(capture, time="6", trigger="1", kind="accept"))
    with pytest.warns(UserWarning, match="cup.notes.jsonl: line 2: .* another recording"):
        [capture] = scand.Recording(copy).captures()
    assert capture.decision() == "reject"


def test_a_line_that_is_no_note_is_named_and_the_others_count(tmp_path):
    copy, capture = linked(tmp_path / "cup.mcap")
    torn = ["[1]\n", "[" * 100_000 + "\n", '{"time": 5}\n', note(capture, time="x"), note(capture, trigger=[])]
    lines = ["\n", note(capture), *torn, note(capture, time="9", kind="clear"), '{"ti']
    (tmp_path / "cup.notes.jsonl").write_bytes("".join(lines).encode() + b"\xff")
    with pytest.warns(UserWarning) as told:
        [capture] = scand.Recording(copy).captures()
    assert [str(each.message).split(": ")[1] for each in told] == [f"line {n}" for n in (3, 4, 5, 6, 7, 9)]
    assert all(each.filename == __file__ for each in told), "each warning names who reads the recording"
    assert [each["kind"] for each in capture.notes] == ["reject", "clear"]
    assert capture.decision() is None


def test_a_flood_of_lines_gives_few_warnings_and_a_huge_file_none_of_its_notes(tmp_path):
    copy, capture = linked(tmp_path / "cup.mcap")
    (tmp_path / "cup.notes.jsonl").write_text("{\n" * 1000)
    with pytest.warns(UserWarning) as told:
        scand.Recording(copy)
    assert len(told) == 21 and "980 more lines" in str(told[-1].message)
    with open(tmp_path / "cup.notes.jsonl", "w") as file:
        file.write(note(capture))
        file.truncate(17 << 20)
    with pytest.warns(UserWarning, match="not a file of at most"):
        [capture] = scand.Recording(copy).captures()
    assert capture.notes == []


def test_a_recording_that_is_being_written_has_its_notes_under_the_final_name(tmp_path):
    whole = RECORDING.read_bytes()
    part = tmp_path / "cup.mcap.part"
    part.write_bytes(whole)
    [capture] = scand.Recording(part).captures()
    (tmp_path / "cup.notes.jsonl").write_text(note(capture))
    (tmp_path / "cup.mcap.notes.jsonl").write_text(note(capture, time="6", kind="accept"))
    [capture] = scand.Recording(part).captures()
    assert capture.decision() == "reject"
    # Cut off in the middle of a picture: what is before it is there.
    part.write_bytes(whole[: len(whole) // 2])
    with pytest.warns(UserWarning, match="ends early: the record at byte"):
        [capture] = scand.Recording(part).captures()
    assert capture.decision() == "reject"
    (tmp_path / "cup.notes.jsonl").unlink()
    # A chunk that was begun claims to be as long as can be.
    part.write_bytes(whole[:8] + b"\x06" + b"\xff" * 8 + whole[8:])
    with pytest.warns(UserWarning, match="at byte 8 is not whole"):
        assert list(scand.Recording(part).captures()) == []


def test_a_damaged_chunk_is_left_out_and_named(tmp_path):
    damaged = bytearray(RECORDING.read_bytes())
    at, chunks = 8, []
    while damaged[at] != 0x0F:
        if damaged[at] == 0x06:
            chunks.append(at)
        at += 9 + struct.unpack_from("<Q", damaged, at + 1)[0]
    damaged[chunks[-1] + 1000] ^= 1
    copy = tmp_path / "cup.mcap"
    copy.write_bytes(damaged)
    with pytest.warns(UserWarning, match=f"the record at byte {chunks[-1]} is damaged"):
        [capture] = scand.Recording(copy).captures()
    assert capture.colors


def test_a_note_on_the_session_has_no_trigger(tmp_path):
    with open(tmp_path / "day.mcap", "wb") as file:
        writer = Writer(file)
        writer.start("scand")
        writer.add_metadata("session", {"name": "day"})
        writer.finish()
    assert scand.Recording(tmp_path / "day.mcap").session_notes() == []
    line = {"time": "5", "capture": "day", "kind": "text", "text": "rain", "author": "Ann"}
    (tmp_path / "day.notes.jsonl").write_text(json.dumps(line) + "\n" + json.dumps(line | {"trigger": "5"}) + "\n")
    with pytest.warns(UserWarning, match="line 2"):
        recording = scand.Recording(tmp_path / "day.mcap")
    assert recording.session_notes() == [{"time_ns": 5, "kind": "text", "text": "rain", "author": "Ann"}]


@pytest.mark.parametrize("name", ["plain", "packed"])
def test_recordings_of_format_1_are_read(name):
    captures = list(scand.Recording(GOLDEN / f"{name}.mcap").captures())
    assert captures and all(capture.colors for capture in captures)


def test_a_recording_of_format_1_that_was_cut_off_is_read_as_far_as_it_goes():
    with pytest.warns(UserWarning, match="cut-off.mcap: it ends early"):
        assert list(scand.Recording(GOLDEN / "cut-off.mcap").captures())


def message(*fields):
    """A protobuf message of fields: number, and text or a 32-bit number."""
    parts = []
    for number, value in fields:
        if isinstance(value, int):
            parts.append(struct.pack("<BI", number << 3 | 5, value))
        else:
            parts.append(bytes([number << 3 | 2, len(value)]) + value)
    return b"".join(parts)


def one_picture(width, height, step, data):
    return message((2, width), (3, height), (4, b"mono8"), (5, step), (6, data))


def with_messages(path, compression, *messages):
    """A recording of messages: topic, content, and None for JSON or the name of a schema of the project's recording."""
    known = {}
    for record in _records(RECORDING):
        if isinstance(record, records.Schema):
            known[record.name] = record.data
    with open(path, "wb") as file:
        writer = Writer(file, compression=compression)
        writer.start("scand")
        for topic, content, name in messages:
            schema = writer.register_schema(name or "scand", "protobuf" if name else "jsonschema", known.get(name, b"{}"))
            channel = writer.register_channel(topic, "protobuf" if name else "json", schema)
            writer.add_message(channel, log_time=7, data=content, publish_time=7)
        writer.finish()
    return path


@pytest.mark.parametrize("compression", list(CompressionType))
def test_chunks_of_every_packing_are_read(tmp_path, compression):
    picture = one_picture(2, 2, 3, b"\x01\x02\x00\x03\x04")
    trigger = b'{"id": "a"}', None
    path = with_messages(tmp_path / "a.mcap", compression, ("/trigger", *trigger), ("/color/c/image", picture, "foxglove.RawImage"))
    [capture] = scand.Recording(path).captures()
    assert capture.colors["c"].picture.tolist() == [[1, 2], [3, 4]]


def test_a_recording_of_an_unknown_format_is_refused_by_name(tmp_path):
    def of_format(pairs):
        with open(tmp_path / "a.mcap", "wb") as file:
            writer = Writer(file)
            writer.start("scand")
            writer.add_metadata("scand", pairs)
            writer.finish()
        return scand.Recording(tmp_path / "a.mcap")

    for pairs in ({"format": "1"}, {"writer": "other 7"}):
        assert of_format(pairs).topics() == []
    with pytest.raises(ValueError, match="a.mcap has the unknown format '2', expected '1'"):
        of_format({"format": "2"})


def test_what_other_programs_add_is_left_alone(tmp_path, recwarn):
    with open(tmp_path / "a.mcap", "wb") as file:
        writer = Writer(file)
        writer.start("scand")
        own = writer.register_schema("scand.Trigger", "jsonschema", b"{}")
        foreign = writer.register_schema("sensor_msgs/Imu", "ros1msg", b"float64 x")
        # Without a slash, in an encoding of its own, without a schema, with too many parts, with an unknown part.
        for topic, encoding, schema in [
            ("imu", "ros1", foreign),
            ("/imu", "cdr", foreign),
            ("/color", "json", 0),
            ("/color/c/d/image", "json", own),
            ("/depth/d/mask", "json", own),
        ]:
            channel = writer.register_channel(topic, encoding, schema)
            writer.add_message(channel, log_time=7, data=b"\xff\x01", publish_time=7)
        channel = writer.register_channel("/trigger", "json", own)
        writer.add_message(channel, log_time=7, data=b'{"id": "a"}', publish_time=7)
        writer.finish()
    recording = scand.Recording(tmp_path / "a.mcap")
    assert [capture.id for capture in recording.captures()] == ["a"]
    assert recording.topics() == ["/trigger"] and recording.cameras("color") == []
    assert not recwarn.list


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_a_chunk_that_unpacks_to_more_than_it_says_is_left_out(tmp_path, compression):
    path = with_messages(tmp_path / "a.mcap", compression, ("/log", b" " * (8 << 20) + b"0", None))
    whole = path.read_bytes()
    at = 8
    while whole[at] != 6:
        at += 9 + struct.unpack_from("<Q", whole, at + 1)[0]
    for size in (1000, 1 << 60):
        path.write_bytes(whole[: at + 25] + struct.pack("<Q", size) + whole[at + 33 :])
        with pytest.warns(UserWarning, match="is damaged"):
            assert scand.Recording(path).topics() == []


@pytest.mark.parametrize("claimed", [(2, 2, 2**32 - 1), (2**32 - 1, 2, 2**32 - 1), (2, 2**32 - 1, 0), (0, 2, 2), (2, 0, 2), (2, 3, 2)])
def test_a_picture_that_claims_more_than_it_has_is_an_error(tmp_path, claimed):
    picture = one_picture(*claimed, b"\x01\x02\x03\x04")
    trigger = b'{"id": "a"}', None
    path = with_messages(tmp_path / "a.mcap", CompressionType.NONE, ("/trigger", *trigger), ("/color/c/image", picture, "foxglove.RawImage"))
    with pytest.raises(ValueError, match="has 4 bytes"):
        list(scand.Recording(path).captures())


@pytest.mark.parametrize("id", ["../a", ".a", "", "a/b", "a" * 65, "a\n", None, 7.5, [1]])
def test_a_trigger_whose_id_names_no_folder_makes_no_capture(tmp_path, id):
    trigger = json.dumps({"id": id}).encode()
    path = with_messages(tmp_path / "a.mcap", CompressionType.NONE, ("/trigger", trigger, None))
    assert list(scand.Recording(path).captures()) == []


def test_a_message_that_is_cut_off_is_an_error():
    with pytest.raises((ValueError, IndexError)):
        Schema(b"\x0a\xff\x01abc")


# Jupyter begins in the notebook's folder.
@pytest.mark.parametrize("begin", [".", "python/examples"])
def test_the_notebook_runs(monkeypatch, capsys, tmp_path, begin):
    folder = tmp_path / "out/cup/cup-000"
    folder.mkdir(parents=True)
    ply(folder / "model.ply")
    (folder / "report.json").write_text('{"version": 1, "verdict": {"level": "amber", "reasons": []}}')
    (tmp_path / "recordings").symlink_to(RECORDING.parent)
    (tmp_path / begin).mkdir(parents=True, exist_ok=True)
    monkeypatch.chdir(tmp_path / begin)
    notebook = json.loads((Path(__file__).parents[1] / "examples/capture.ipynb").read_text())
    names = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    told = capsys.readouterr().out
    assert "of the pixels, noise" in told and "c00" in told
    assert "a-1 amber" in told and "restored  33.3%, expected error 2.00 mm" in told


def test_what_cannot_be_converted_for_rerun_is_said_in_a_line(monkeypatch, tmp_path):
    from scand import to_rerun

    monkeypatch.setattr(to_rerun.importlib.util, "find_spec", lambda name: True)
    monkeypatch.setattr(to_rerun, "convert", lambda recording, out, models: list(scand.Recording(recording).captures()))
    (tmp_path / "text.mcap").write_text("I am no recording")
    for name in ("text.mcap", "absent.mcap"):
        monkeypatch.setattr("sys.argv", ["to_rerun", str(tmp_path / name)])
        with pytest.raises(SystemExit, match=f"to_rerun: .*{name}"):
            to_rerun.main()


def test_a_recording_that_is_not_complete_is_converted_under_its_final_name(monkeypatch, tmp_path, capsys):
    from scand import to_rerun

    rerun = MagicMock()
    monkeypatch.setitem(sys.modules, "rerun", rerun)
    monkeypatch.setattr(to_rerun.importlib.util, "find_spec", lambda name: True)
    (tmp_path / "cup.mcap.part").symlink_to(RECORDING)
    folder = tmp_path / "out/cup/cup-000"
    folder.mkdir(parents=True)
    ply(folder / "model.ply")
    monkeypatch.setattr("sys.argv", ["to_rerun", str(tmp_path / "cup.mcap.part"), "--models", str(tmp_path / "out")])
    to_rerun.main()
    assert capsys.readouterr().out.startswith("cup.rrd: 1 capture;")
    assert rerun.RecordingStream.call_args.kwargs == {"recording_id": "cup"}
    assert rerun.Mesh3D.call_count == 1


def test_colours_are_told_to_rerun_in_the_order_that_they_have():
    from scand.to_rerun import picture

    def told(encoding, pixels):
        rerun = MagicMock()
        picture(rerun, MagicMock(picture=pixels, encoding=encoding), {})
        return rerun.Image.call_args

    three, two = np.zeros((2, 4, 3), np.uint8), np.array([[[1, 2], [3, 4]]], np.uint8)
    assert told("rgb8", three).kwargs == {}
    assert told("bgr8", three).kwargs == {"color_model": "BGR"}
    sides = {"width": 2, "height": 1}
    for encoding, bytes in [("yuyv", b"\1\2\3\4"), ("uyvy", b"\2\1\4\3"), ("yuv422", b"\2\1\4\3")]:
        asked = told(encoding, two).kwargs
        assert asked.pop("pixel_format") and asked == {"bytes": bytes, **sides}


def test_a_comment_that_ends_as_the_header_does_is_read(tmp_path):
    path = ply(tmp_path / "model.ply")
    path.write_bytes(path.read_bytes().replace(b"A krater", b"an end_header"))
    model = scand.read_model(path)
    assert model.about["title"] == "an end_header" and len(model.vertices) == 3


def test_a_ply_says_any_letter_in_ascii(tmp_path):
    path = ply(tmp_path / "model.ply")
    escaped = rb'comment title Krater \u00ab\u0397\u00bb \\u00 "\ud80c\udc00" 100 %'
    path.write_bytes(path.read_bytes().replace(b"comment title A krater", escaped))
    assert scand.read_model(path).about["title"] == 'Krater «Η» \\u00 "𓀀" 100 %'
