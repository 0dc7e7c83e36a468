#!/usr/bin/env python3
"""Makes docs/reasons: a picture of what reasons of a verdict look like on the preview, from simulated captures with one fault
each. Every capture must really have the reason. Run it with Pillow installed, such as with make interop's Python:
target/interop/environment/bin/python scripts/reason-pictures.py [PROGRAM]"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parent.parent
PROGRAM = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "target/release/scand").resolve()
HULL = ["--depth-cameras", "0"]
# Reason, part of the sheet, what is simulated, what is asked of the reconstruction.
CASES = [
    ("camera_displaced", "outlines", ["--shape", "mug", *HULL, "--turned", "c02=2"], []),
    ("calibration_foreign", "outlines", ["--shape", "mug", *HULL], "foreign"),
    ("cameras_exchanged", "outlines", ["--shape", "mug", *HULL], "exchanged"),
    ("frame_cut", "outlines", ["--shape", "cup", *HULL, "--cut-off", "c03=0.3"], []),
    ("silhouette_uncovered", "outlines", ["--shape", "cup", *HULL, "--blurred", "c04=5"], []),
    ("overexposed", "outlines", ["--shape", "cup", *HULL, "--overexposed", "c01=3"], []),
    ("no_depth_camera", "views", ["--shape", "bowl", *HULL], []),
    ("no_depth", "depth", ["--shape", "bowl", "--no-depth"], []),
    ("region_unread", "depth", ["--shape", "cup"], []),
    ("depth_disagrees", "depth", ["--shape", "bowl", "--misregistration-px", "8"], []),
    ("many_handles", "views", ["--shape", "mug", "--turned", "c02=2"], []),
]

# The sheet (`report::preview`): widths and heights in pixels.
MARGIN, GAP, LINE, PANEL = 18, 8, 24, (307, 286)
CAMERAS = 8
WIDTH = 960


def scand(home, *arguments):
    done = subprocess.run([PROGRAM, *arguments], cwd=home, capture_output=True, text=True)
    assert done.returncode in (0, 3), f"scand {arguments}: {done.stderr}"


def calibration(home, kind):
    """The recording's calibration with a mistake in it."""
    scand(home, "info", "a.mcap", "--calibration", "a.toml")
    text = (home / "a.toml").read_text()
    if kind == "exchanged":
        for old, new in (("[cameras.c00]", "[cameras.x]"), ("[cameras.c01]", "[cameras.c00]"), ("[cameras.x]", "[cameras.c01]")):
            text = text.replace(old, new)
    else:
        # Another rig of the same kind: each camera looks a little beside the object.
        scand(home, "simulate", "--shape", "mug", *HULL, "--cameras", str(CAMERAS), "--size", "480x360", "--seed", "77", "--out", "b.mcap")
        scand(home, "info", "b.mcap", "--calibration", "b.toml")
        text = (home / "b.toml").read_text()
    (home / "wrong.toml").write_text(text)
    return ["--calibration", "wrong.toml"]


def part(sheet, name, depths):
    """A part of the sheet, found from its lower edge."""
    width, height = sheet.size
    outline = (width - 2 * MARGIN - (CAMERAS - 1) * GAP) // CAMERAS
    outlines = height - MARGIN - (min(outline, 200) + LINE)
    row = PANEL[1] + LINE + GAP
    depth = outlines - LINE - depths * row
    views = depth - LINE - GAP - 2 * row
    left, right = MARGIN, width - MARGIN
    half = left + 3 * PANEL[0] + 2 * GAP
    return sheet.crop(
        {
            "outlines": (left, outlines, right, height - MARGIN - LINE),
            "depth": (left, depth, right, depth + PANEL[1] + LINE),
            "views": (left, views, half, views + PANEL[1] + LINE),
        }[name]
    )


def picture(code, name, simulated, asked):
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        scand(home, "simulate", *simulated, "--cameras", str(CAMERAS), "--size", "480x360", "--out", "a.mcap")
        more = calibration(home, asked) if isinstance(asked, str) else asked
        scand(home, "replay", "a.mcap", "-q", *more)
        (report,) = home.glob("out/a/*/report.json")
        found = json.loads(report.read_text())
        codes = [reason["code"] for reason in found["verdict"]["reasons"]]
        assert code in codes, f"{code}: the capture has {codes}"
        sheet = Image.open(report.with_name("preview.png")).convert("RGB")
        shown = part(sheet, name, len(found["depth_cameras"]))
        if shown.width > WIDTH:
            shown = shown.resize((WIDTH, round(shown.height * WIDTH / shown.width)), Image.Resampling.LANCZOS)
        out = ROOT / "docs/reasons" / f"{code}.png"
        out.parent.mkdir(exist_ok=True)
        shown.quantize(128, dither=Image.Dither.NONE).save(out, optimize=True)
        print(f"{out.relative_to(ROOT)}: {out.stat().st_size} bytes; the verdict has {', '.join(codes)}", flush=True)


failures = []
for case in CASES:
    try:
        picture(*case)
    except AssertionError as error:
        failures.append(str(error))
for failure in failures:
    print(failure, file=sys.stderr)
sys.exit(bool(failures))
