"""Reads models (`model.ply`, `model.glb`) with what they know of each vertex."""

import json
import re
import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

HULL, CARVED, RESTORED, BRIDGED, UNSEEN, TABLE = range(6)
#: The names of the provenances, by their numbers.
PROVENANCES = ("hull", "carved", "restored", "bridged", "unseen", "table")


@dataclass
class Model:
    """A model in the rig's frame: metres, z up."""

    #: (n, 3) float32, metres.
    vertices: np.ndarray
    #: (m, 3) int, counter-clockwise from outside.
    triangles: np.ndarray
    #: (n, 3) float32, unit length, outwards.
    normals: np.ndarray
    #: (n,) uint8, numbers of `PROVENANCES`.
    provenance: np.ndarray
    #: (n,) float32, the expected distance to the true surface, in metres.
    expected_error: np.ndarray
    #: (n, 3) uint8, sRGB; None in a .glb, whose colours are in its texture.
    colors: np.ndarray | None = None
    #: (n, 2) float32, places in the texture, v down from the top; None in a .ply.
    uv: np.ndarray | None = None
    #: The texture's file (JPEG), as bytes; None in a .ply.
    texture: bytes | None = None
    #: (n,) uint32: bit i is set where capture i of `fusion.captures` in the report made the surface; None of one capture.
    captures: np.ndarray | None = None
    #: What is known of the object and of how the model came about, by name.
    about: dict = field(default_factory=dict)

    def volume(self):
        """The volume in cubic metres."""
        a, b, c = (self.vertices[self.triangles[:, i]].astype(float) for i in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def read_model(path):
    """The model in a file (.ply or .glb), or the `model.ply` in the folder of a capture.

    Raises ValueError for a file that scand did not write.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "model.ply"
    data = path.read_bytes()
    read = {".ply": _read_ply, ".glb": _read_glb}.get(path.suffix.lower())
    if read is None:
        raise ValueError(f"{path}: expected .ply or .glb")
    try:
        return read(data)
    except (KeyError, IndexError, struct.error) as error:
        raise ValueError(f"{path}: not a model of scand: {error}") from error
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _unescaped(text):
    """A text of a PLY's comment, where other letters than ASCII stand as in JSON, and a backslash is there twice."""
    units = re.sub(
        r"\\\\|\\u([0-9a-f]{4})", lambda found: chr(int(found[1], 16)) if found[1] else "\\", text
    )
    # Letters beyond U+FFFF are two units.
    return units.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


_PLY_TYPES = {"float": "<f4", "uchar": "u1", "uint": "<u4"}


def _read_ply(data):
    # A line of its own: a comment may end in the word.
    end = data.find(b"\nend_header\n") + 1
    if not data.startswith(b"ply\n") or end == 0:
        raise ValueError("not a PLY of scand")
    lines = data[:end].decode().split("\n")
    if lines[1] != "format binary_little_endian 1.0":
        raise ValueError(f"{lines[1]!r}, expected binary_little_endian")
    comments = [line[8:] for line in lines if line.startswith("comment ")]
    counts = {line.split()[1]: int(line.split()[2]) for line in lines if line.startswith("element ")}
    properties = [line.split()[1:] for line in lines if line.startswith("property ")]
    vertex = np.dtype([(name, _PLY_TYPES[kind]) for kind, name in (p for p in properties if p[0] != "list")])
    face = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
    start = end + len("end_header\n")
    vertices = np.frombuffer(data, vertex, counts["vertex"], start)
    faces = np.frombuffer(data, face, counts["face"], start + vertices.nbytes)

    def columns(*names):
        return np.stack([vertices[name] for name in names], axis=1)

    # Sentences about the file stand behind the names and their texts.
    fixed = ("frame", "red", "expected_error", "provenance")
    about = {}
    for name, *rest in (comment.split(" ", 1) for comment in comments):
        for text in rest:
            if name not in fixed:
                about.setdefault(name, _unescaped(text))
    return Model(
        vertices=columns("x", "y", "z"),
        triangles=faces["corners"].astype(int),
        normals=columns("nx", "ny", "nz"),
        provenance=vertices["provenance"].copy(),
        expected_error=vertices["expected_error"].copy(),
        colors=columns("red", "green", "blue"),
        captures=vertices["captures"].copy() if "captures" in vertex.names else None,
        about=about,
    )


_COMPONENTS = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}


def _read_glb(data):
    if data[:4] != b"glTF":
        raise ValueError("not a binary glTF")
    size = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + size])
    binary = data[28 + size :]
    asset = document["asset"]
    if not asset.get("generator", "").startswith("scand "):
        raise ValueError(f"written by {asset.get('generator')!r}, not by scand")
    if document.get("extensionsRequired"):
        raise ValueError(f"needs {document['extensionsRequired']}, which is not read here")

    def view(index):
        view = document["bufferViews"][index]
        start = view.get("byteOffset", 0)
        return binary[start : start + view["byteLength"]]

    def values(index):
        accessor = document["accessors"][index]
        width = _WIDTHS[accessor["type"]]
        kind = _COMPONENTS[accessor["componentType"]]
        flat = np.frombuffer(view(accessor["bufferView"]), kind, accessor["count"] * width)
        return flat.reshape(-1, width) if width > 1 else flat

    def z_up(vectors):
        return np.stack([vectors[:, 0], -vectors[:, 2], vectors[:, 1]], axis=1)

    primitive = document["meshes"][0]["primitives"][0]
    attributes = primitive["attributes"]
    images = document.get("images", [])
    return Model(
        vertices=z_up(values(attributes["POSITION"])),
        triangles=values(primitive["indices"]).reshape(-1, 3).astype(int),
        normals=z_up(values(attributes["NORMAL"])),
        provenance=values(attributes["_PROVENANCE"]).astype(np.uint8),
        expected_error=values(attributes["_ERROR"]).copy(),
        uv=values(attributes["TEXCOORD_0"]) if "TEXCOORD_0" in attributes else None,
        texture=view(images[0]["bufferView"]) if images else None,
        captures=values(attributes["_CAPTURES"]).astype(np.uint32) if "_CAPTURES" in attributes else None,
        about=dict(asset.get("extras", {})),
    )
