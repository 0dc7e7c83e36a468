#!/usr/bin/env python3
"""Makes docs/reasons: a picture of what each amber or red reason of a verdict looks like on the preview, from simulated
captures with one fault each. Every capture must really have the reason. Two pictures are drawn here, from the model: the
preview does not show expected errors, and no capture makes a model that is not closed. Run it with numpy, Pillow and mcap
installed, such as with make interop's Python: target/interop/environment/bin/python scripts/reason-pictures.py [PROGRAM
[CODE...]]"""

import json
import re
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageChops, ImageDraw

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "python"))
from scand import read_model  # noqa: E402

PROGRAM = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "target/release/scand").resolve()
WANTED = sys.argv[2:]
HULL = ["--depth-cameras", "0"]
DOUBT = "2 of 8 cameras saw the board fewer than 10 times"
# The sheet (`report::preview`): widths and heights in pixels, then panels in a row and cameras with photographs.
MARGIN, GAP, LINE, TITLE, PANEL = 18, 8, 24, 56, (307, 286)
PANELS, VIEWS = 6, 4
CAMERAS = 8
WIDTH = 960
# A picture that is drawn here, its colours, and the expected error that is red.
DRAWN, PAPER, INK, ERROR_MM = (440, 320), (35, 38, 46), (200, 205, 215), 6
# Room for the object's size on the right of the title.
SIZE_WORDS = 500
# Bytes of a picture.
LARGEST = 40_000


def drawn(model, colors, inside, turn_deg):
    """A model from above at a slant. Each triangle has its colour, or `inside` where its back is seen, and light from the upper left."""
    turn, tilt = np.radians(turn_deg), np.radians(38)
    around = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    upon = np.array([[1, 0, 0], [0, np.sin(tilt), np.cos(tilt)], [0, -np.cos(tilt), np.sin(tilt)]])
    # Right, up, towards the viewer.
    corners = ((model.vertices - model.vertices.mean(axis=0)) @ (upon @ around).T)[model.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    is_back = normals[:, 2] < 0
    light = np.abs(normals @ (np.array([-0.4, 0.6, 0.7]) / np.linalg.norm([-0.4, 0.6, 0.7])))
    shown = np.where(is_back[:, None], inside, colors) * (0.45 + 0.55 * light[:, None])
    flat = corners[:, :, :2].reshape(-1, 2)
    low, high = flat.min(axis=0), flat.max(axis=0)
    # Twice as large as it is shown, for smooth edges.
    scale = 2 * min((np.array(DRAWN) - 2 * MARGIN) / (high - low))
    places = (corners[:, :, :2] - (low + high) / 2) * scale * [1, -1] + np.array(DRAWN)
    sheet = Image.new("RGB", (2 * DRAWN[0], 2 * DRAWN[1]), PAPER)
    draw = ImageDraw.Draw(sheet)
    for triangle in np.argsort(corners[:, :, 2].mean(axis=1)):
        draw.polygon([tuple(place) for place in places[triangle]], fill=tuple(int(c) for c in shown[triangle]))
    return sheet.resize(DRAWN, Image.Resampling.LANCZOS)


def beside(*pictures):
    sheet = Image.new("RGB", (sum(p.width for p in pictures), max(p.height for p in pictures)), PAPER)
    at = 0
    for each in pictures:
        sheet.paste(each, (at, 0))
        at += each.width
    return sheet


def errors(model):
    """The model's colours, and beside them its expected errors with their scale."""
    at = np.clip(1e3 * model.expected_error / ERROR_MM, 0, 1)[:, None]
    scale = [np.array(color, float) for color in ((48, 90, 160), (235, 220, 120), (200, 45, 35))]
    mixed = [scale[i] * (1 - part) + scale[i + 1] * part for i, part in ((0, 2 * at), (1, 2 * at - 1))]
    colors = np.where(at < 0.5, *mixed)
    sheet = beside(*(drawn(model, of[model.triangles].mean(axis=1), (90, 90, 90), 20) for of in (model.colors.astype(float), colors)))
    legend = Image.new("RGB", (sheet.width, 40), PAPER)
    draw = ImageDraw.Draw(legend)
    left = legend.width - DRAWN[0] // 2 - 100
    for x in range(200):
        at = x / 100
        color = scale[0] * (1 - at) + scale[1] * at if at < 1 else scale[1] * (2 - at) + scale[2] * (at - 1)
        draw.line([(left + x, 4), (left + x, 14)], fill=tuple(int(c) for c in color))
    draw.text((left, 20), "0", fill=INK)
    draw.text((left + 100 - 45, 20), "expected error", fill=INK)
    draw.text((left + 200 - 24, 20), f"{ERROR_MM} mm", fill=INK)
    below = Image.new("RGB", (sheet.width, sheet.height + legend.height), PAPER)
    below.paste(sheet, (0, 0))
    below.paste(legend, (0, sheet.height))
    return below


def opened(model):
    """The model as it is, and with a part of its wall taken out, so that it does not enclose a solid. Backs are red."""
    colors = np.full((len(model.triangles), 3), 190.0)
    whole = drawn(model, colors, (215, 40, 40), 20)
    middles = model.vertices[model.triangles].mean(axis=1)
    # The place of the wall that is nearest to the viewer, below the rim.
    low, high = model.vertices[:, 2].min(), model.vertices[:, 2].max()
    wall = middles[np.abs(middles[:, 2] - low - 0.6 * (high - low)) < 0.05 * (high - low)]
    front = wall[np.argmin(wall @ [np.sin(np.radians(20)), np.cos(np.radians(20)), 0])]
    kept = np.linalg.norm(middles - front, axis=1) > 0.11 * np.ptp(model.vertices[:, 0])
    model.triangles = model.triangles[kept]
    return beside(whole, drawn(model, colors[kept], (215, 40, 40), 20))


def scand(home, *arguments):
    done = subprocess.run([PROGRAM, *arguments], cwd=home, capture_output=True, text=True)
    assert done.returncode in (0, 3), f"scand {arguments}: {done.stderr}"


def part(sheet, name, found):
    """A part of the sheet, found from its lower edge; of an object's sheet, from that of the part above the captures."""
    width, height = sheet.size
    row = PANEL[1] + LINE + GAP
    if captures := len(found.get("fusion", {}).get("captures", ())):
        height -= LINE + 2 * row * -(-(1 + captures) // PANELS) + MARGIN
    cameras = len(found["color_cameras"])
    in_row = min(max(cameras, PANELS), 2 * PANELS)
    outline = (width - 2 * MARGIN - (in_row - 1) * GAP) // in_row
    outlines = height - MARGIN - -(-cameras // in_row) * (min(outline, 200) + LINE)
    depth = outlines - LINE - len(found["depth_cameras"]) * row
    views = depth - LINE - GAP - -(-min(cameras, VIEWS) // 2) * row
    left, right = MARGIN, width - MARGIN
    half = left + 3 * PANEL[0] + 2 * GAP
    shown = sheet.crop(
        {
            "head": (0, 0, right, views),
            "outlines": (left, outlines, right, height - MARGIN - LINE),
            "depth": (left, depth, right, depth + PANEL[1] + LINE),
            "views": (left, views, half, views + PANEL[1] + LINE),
            "above": (left, views + row, half, views + row + PANEL[1] + LINE),
        }[name]
    )
    return written(shown) if name == "head" else shown


def written(head):
    """The head as far as its sentences go, without the object's size on the right."""
    below = TITLE + MARGIN
    paper = Image.new("RGB", head.size, head.getpixel((0, 0)))
    head.paste(paper.crop((0, 0, SIZE_WORDS, below)), (head.width - SIZE_WORDS, 0))
    words = ImageChops.difference(head, paper).crop((0, below, head.width, head.height)).getbbox()
    return head.crop((0, 0, max(words[2] + MARGIN, WIDTH), below + words[3] + MARGIN))


def cut(home):
    """Loses the end of the recording, as a copy does that was broken off."""
    recording = home / "a.mcap"
    whole = recording.read_bytes()
    recording.write_bytes(whole[: len(whole) * 7 // 10])
    return []


def misspelt(home):
    """Names a calibration's topic wrongly."""
    return changed(home, lambda data: data.replace(b"/color/c05/calibration", b"/color/c05/kalibration"))


def low(home):
    """The volume ends at half the height of the object."""

    def halved(found):
        height = found[2].decode()
        return found[1] + f"{0.5 * float(height):.15f}"[: len(height)].ljust(len(height), "0").encode() + b"]"

    return changed(home, lambda data: re.sub(rb'("max":\[[^],]*,[^],]*,)([0-9.]*)\]', halved, data))


def changed(home, change):
    """Changes the recording, of the same length, and leaves out the checksums that would show it."""
    recording = home / "a.mcap"
    before = recording.read_bytes()
    data = bytearray(change(before))
    assert len(data) == len(before) and data != before
    # The checksums of chunks, of the data and of the summary, by their records' opcodes.
    checksums, at = {0x06: 24, 0x0F: 0, 0x02: 16}, 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode in checksums:
            struct.pack_into("<I", data, at + 9 + checksums[opcode], 0)
        at += 9 + length
    recording.write_bytes(data)
    return []


def foreign(home):
    """The calibration of another rig of the same kind: each camera looks a little beside the object."""
    scand(home, "simulate", "--shape", "mug", *HULL, "--cameras", str(CAMERAS), "--size", "480x360", "--seed", "77", "--out", "b.mcap")
    scand(home, "info", "b.mcap", "--calibration", "wrong.toml")
    return ["--calibration", "wrong.toml"]


def exchanged(home):
    """The recording's calibration with two cameras at each other's place."""
    scand(home, "info", "a.mcap", "--calibration", "a.toml")
    text = (home / "a.toml").read_text()
    for old, new in (("[cameras.c00]", "[cameras.x]"), ("[cameras.c01]", "[cameras.c00]"), ("[cameras.x]", "[cameras.c01]")):
        text = text.replace(old, new)
    (home / "wrong.toml").write_text(text)
    return ["--calibration", "wrong.toml"]


def short(home):
    """The recording's calibration, of which the depth camera's holds only as far as the rim: readings of the inside do not count."""
    scand(home, "info", "a.mcap", "--calibration", "a.toml")
    text = (home / "a.toml").read_text()
    assert "\nslope = " in text, text
    (home / "short.toml").write_text(text.replace("\nslope = ", "\nrange = [0.5, 0.78]\nslope = "))
    return ["--calibration", "short.toml"]


def focal(home, cameras):
    """The recording's calibration with focal lengths of such cameras that are 6 % too large."""
    scand(home, "info", "a.mcap", "--calibration", "a.toml")
    longer = lambda found: found[1] + ", ".join(str(1.06 * float(length)) for length in found[2].split(","))
    text, count = re.subn(rf"(\[cameras\.{cameras}\]\nsize = .*\nfocal_px = \[)([^]]*)", longer, (home / "a.toml").read_text())
    assert count, text
    (home / "wrong.toml").write_text(text)
    return ["--calibration", "wrong.toml"]


FAULTS = {
    "cut": cut,
    "misspelt": misspelt,
    "low": low,
    "foreign": foreign,
    "exchanged": exchanged,
    "short": short,
    "focal of depth": lambda home: focal(home, "kinect"),
    "focal of colour": lambda home: focal(home, r"c\d\d"),
}


def reconstruct(home, asked):
    """Makes the model, with what a case asks for."""
    if asked == "fuse":
        return scand(home, "fuse", "a.mcap", "--subject", "17", "-q")
    if isinstance(asked, str):
        asked = FAULTS[asked](home)
    scand(home, "replay", "a.mcap", "-q", *asked)


def picture(code, name, simulated, asked):
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        rig = ["--cameras", str(CAMERAS)] if "--cameras" not in simulated else []
        simulated = [*simulated, *rig, "--subject", "17", "--size", "480x360"]
        scand(home, "simulate", *simulated, "--out", "a.mcap")
        reconstruct(home, asked)
        report = min(home.glob("out/a/*/report.json"))
        found = json.loads(report.read_text())
        reasons = found["verdict"]["reasons"]
        codes = [reason["code"] for reason in reasons if reason["level"] != "green"]
        if callable(name):
            assert code in codes or name is opened, f"{code}: the capture has {codes}"
            shown = name(read_model(report.parent))
        else:
            assert code in codes, f"{code}: the capture has {codes}"
            shown = part(Image.open(report.with_name("preview.png")).convert("RGB"), name, found)
        if shown.width > WIDTH:
            shown = shown.resize((WIDTH, round(shown.height * WIDTH / shown.width)), Image.Resampling.LANCZOS)
        out = ROOT / "docs/reasons" / f"{code}.png"
        out.parent.mkdir(exist_ok=True)
        # Fewer colours make a smaller file. Words need the colours of small areas, photographs those of large; a scale
        # needs each of its colours.
        method = Image.Quantize.MAXCOVERAGE if name in ("head", errors) else Image.Quantize.MEDIANCUT
        for colors in (128, 64, 32, 16):
            shown.quantize(colors, method, dither=Image.Dither.NONE).save(out, optimize=True)
            if out.stat().st_size <= LARGEST:
                break
        assert out.stat().st_size <= LARGEST, f"{code}: {out.stat().st_size} bytes"
        print(f"{out.relative_to(ROOT)}: {out.stat().st_size} bytes; the verdict has {', '.join(codes)}", flush=True)


# Reason, part of the sheet, what is simulated, what is asked of the reconstruction or, in one word, done besides.
CASES = [
    ("camera_displaced", "outlines", ["--shape", "mug", *HULL, "--turned", "c02=2"], []),
    ("calibration_foreign", "outlines", ["--shape", "mug", *HULL], "foreign"),
    ("cameras_exchanged", "outlines", ["--shape", "mug", *HULL], "exchanged"),
    ("frame_cut", "outlines", ["--shape", "cup", *HULL, "--cut-off", "c03=0.3"], []),
    ("volume_cut", "above", ["--shape", "cup"], "low"),
    ("silhouette_uncovered", "outlines", ["--shape", "cup", *HULL, "--blurred", "c04=5"], []),
    ("overexposed", "outlines", ["--shape", "cup", *HULL, "--overexposed", "c01=3"], []),
    ("underexposed", "views", ["--shape", "cup", *HULL, "--masks", "--overexposed", "c00=-14", "--read-noise", "0"], []),
    ("blurred", "views", ["--shape", "cup", *HULL, "--blurred", "c00=12"], []),
    ("backdrop_changed", "outlines", ["--shape", "cup", *HULL, "--overexposed", "c01=-4"], []),
    ("told_by_outline", "outlines", ["--shape", "ball", *HULL, "--encoding", "mono", "--exposure-drift", "0.1"], []),
    # No simulated background is old.
    ("background_old", "head", ["--shape", "bowl"], ["--set", "verdict.background_age_h.amber=0"]),
    ("skew", "head", ["--shape", "mug", "--late", "c03=40"], []),
    ("calibration_doubtful", "head", ["--shape", "bowl", "--doubtful-calibration", DOUBT], []),
    ("camera_left_out", "head", ["--shape", "bowl", "--missing", "c03"], []),
    ("warning", "head", ["--shape", "bowl"], "misspelt"),
    ("damage", "head", ["--shape", "bowl", "--captures", "2"], "cut"),
    ("depth_not_used", "above", ["--shape", "bowl"], ["--method", "hull"]),
    # Nearly all of this plate is restored; only the rim of a larger one would be so small a share.
    ("region_large", "depth", ["--shape", "plate"], ["--set", "verdict.region_share.amber=0.9"]),
    ("depth_biased", "depth", ["--shape", "bowl", "--depth-bias-mm", "30"], []),
    ("depth_outline", "depth", ["--shape", "bowl"], "focal of depth"),
    ("depth_elsewhere", "depth", ["--shape", "egg"], "focal of colour"),
    # Of a cup a smaller part is interpolated than the limit.
    ("holes_bridged", "above", ["--shape", "cup"], ["--set", "verdict.bridged.amber=0.1"]),
    ("carving_undone", "depth", ["--shape", "bowl", "--misregistration-px", "16"], []),
    # Simulated captures have fewer stray pieces than the limit.
    ("pieces_dropped", "head", ["--shape", "mug", *HULL, "--turned", "c02=5"], ["--set", "verdict.dropped_pieces.amber=0"]),
    ("several_components", "views", ["--shape", "goblet", *HULL, "--lost-piece", "0=25"], []),
    ("opened_by_depth", "above", ["--shape", "bowl", "--misregistration-px", "16"], []),
    ("unpainted", "head", ["--shape", "cup", *HULL, "--cameras", "3"], []),
    ("pose_doubtful", "head", ["--shape", "two-pits", "--poses", "upright,turn:90"], "fuse"),
    ("turn_unknown", "head", ["--shape", "bowl", "--poses", "upright,flip"], "fuse"),
    ("capture_left_out", "head", ["--shape", "mug", "--poses", "upright,flip,side", "--exchanged", "2=bigger:8"], "fuse"),
    ("no_depth_camera", "views", ["--shape", "bowl", *HULL], []),
    ("no_depth", "depth", ["--shape", "bowl", "--no-depth"], []),
    ("region_unread", "depth", ["--shape", "cup"], []),
    ("lid_unread", "depth", ["--shape", "bowl"], "short"),
    ("unobserved", "above", ["--shape", "vase"], []),
    ("error_large", errors, ["--shape", "fruit-bowl"], []),
    ("not_watertight", opened, ["--shape", "bowl"], []),
    ("depth_disagrees", "depth", ["--shape", "bowl", "--misregistration-px", "8"], []),
    ("many_handles", "views", ["--shape", "mug", "--turned", "c02=2"], []),
]

failures = []
unknown = set(WANTED) - {code for code, *_ in CASES}
if unknown:
    sys.exit(f"no case makes {', '.join(sorted(unknown))}")
for case in CASES:
    if WANTED and case[0] not in WANTED:
        continue
    try:
        picture(*case)
    except AssertionError as error:
        failures.append(str(error))
for failure in failures:
    print(failure, file=sys.stderr)
sys.exit(bool(failures))
