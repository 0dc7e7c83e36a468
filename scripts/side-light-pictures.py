#!/usr/bin/env python3
"""Makes docs/fairing.png: models of a cup and of a bowl, lit from the side, without fairing of the hull (left)
and with it. Run it with numpy and Pillow installed: python3 scripts/side-light-pictures.py [PROGRAM]"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).parent.parent
PROGRAM = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "target/release/scand").resolve()
SHAPES = ("cup", "bowl")
SIZE, SAMPLES, GAP = (560, 420), 3, 8
# From the object to the eye: above the horizon by so many degrees; the light comes from the left, nearly at a right angle.
ELEVATION, LIGHT = 28, (-0.85, -0.25, 0.45)
CLAY, PAPER, AMBIENT = np.array([205, 196, 182]), 255, 0.15


def scand(*arguments):
    done = subprocess.run([PROGRAM, *arguments], capture_output=True, text=True)
    assert done.returncode in (0, 3), done.stderr


def models(shape, folder):
    """Vertices (n, 3) and triangles (m, 3) of the models of a shape, without fairing and with it."""
    recording = Path(folder) / f"{shape}.mcap"
    scand("simulate", "--shape", shape, "--size", "1280x960", "--out", recording)
    for fairing in ("none", "touch"):
        out = Path(folder) / f"{shape}-{fairing}"
        scand("replay", recording, "--out", out, "--set", f"hull.fairing={fairing}")
        yield read(next(out.rglob("model.ply")))


def read(path):
    head, data = path.read_bytes().split(b"end_header\n", 1)
    types = {"float": "<f4", "uchar": "u1", "ushort": "<u2", "uint": "<u4", "int": "<i4"}
    counts, fields = {}, []
    for line in head.decode().splitlines():
        match line.split():
            case ["element", name, count]:
                counts[name] = int(count)
            case ["property", kind, name] if kind in types:
                fields.append((name, types[kind]))
    rows = np.frombuffer(data, fields, counts["vertex"])
    vertices = np.stack([rows[axis] for axis in "xyz"], axis=1).astype(float)
    faces = np.frombuffer(data, [("count", "u1"), ("corners", "<u4", 3)], counts["face"], rows.nbytes)
    return vertices, faces["corners"].astype(int)


def seen(vertices):
    """Vertices as they are seen: right, down and towards the eye."""
    angle = np.radians(ELEVATION)
    axes = np.array([[1, 0, 0], [0, -np.sin(angle), -np.cos(angle)], [0, -np.cos(angle), np.sin(angle)]])
    return vertices @ axes.T


def drawn(vertices, triangles, scale):
    """A picture in parallel projection, each triangle flat, as dense points of which the nearest counts."""
    places = seen(vertices)
    places[:, :2] -= (places[:, :2].min(0) + places[:, :2].max(0)) / 2
    corners = (places * [scale, scale, 1])[triangles]
    sides = (places[triangles[:, 1:]] - places[triangles[:, :1]]).transpose(1, 0, 2)
    # What is seen points down, so that the frame is left-handed.
    normals = -np.cross(*sides)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
    light = np.clip(normals @ (np.array(LIGHT) / np.linalg.norm(LIGHT)), 0, 1)
    size = np.array(SIZE) * SAMPLES
    picture, nearest = np.full((size[1] * size[0], 3), PAPER, float), np.full(size[1] * size[0], -np.inf)
    steps = int(np.ceil(np.abs(corners[:, 1:, :2] - corners[:, :1, :2]).max())) + 2
    for i in range(steps + 1):
        for j in range(steps + 1 - i):
            weights = np.array([i, j, steps - i - j]) / steps
            points = np.einsum("k,nkc->nc", weights, corners)
            at = np.round(points[:, :2] + size / 2).astype(int)
            index = np.clip(at[:, 1], 0, size[1] - 1) * size[0] + np.clip(at[:, 0], 0, size[0] - 1)
            order = np.argsort(points[:, 2], kind="stable")
            order = order[points[order, 2] > nearest[index[order]]]
            nearest[index[order]] = points[order, 2]
            picture[index[order]] = CLAY * (AMBIENT + (1 - AMBIENT) * light[order])[:, None]
    picture = picture.reshape(SIZE[1], SAMPLES, SIZE[0], SAMPLES, 3).mean((1, 3))
    return Image.fromarray(np.round(picture).astype(np.uint8))


def main():
    width, height = SIZE
    sheet = Image.new("RGB", (2 * width + GAP, len(SHAPES) * (height + GAP) - GAP), (PAPER,) * 3)
    with tempfile.TemporaryDirectory() as folder:
        for row, shape in enumerate(SHAPES):
            made = list(models(shape, folder))
            extents = np.max([np.ptp(seen(vertices), axis=0)[:2] for vertices, _ in made], axis=0)
            scale = 0.94 * SAMPLES * (np.array(SIZE) / extents).min()
            for column, found in enumerate(made):
                sheet.paste(drawn(*found, scale), (column * (width + GAP), row * (height + GAP)))
    sheet.quantize(128, dither=Image.Dither.NONE).save(ROOT / "docs/fairing.png", optimize=True)


main()
