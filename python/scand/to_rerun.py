"""`python -m scand.to_rerun RECORDING -o FILE.rrd`: captures for the viewer Rerun, with depth as depth.

Rerun opens a recording of scand as it is, but takes its depth for a picture of grey values: its importer (tried with 0.41) knows
depth only in ROS's `sensor_msgs/Image`, whatever a topic is called, and scand's recordings have `foxglove.RawImage`, which
Foxglove shows as depth. This module turns readings into metres by the recorded response and logs them as depth images in the
cameras' frames. Lenses are shown without their distortion. It needs `rerun-sdk`."""

import argparse
import importlib.util
import sys
from pathlib import Path

import numpy as np

from . import Recording, read_model
from .recording import stem_of


def log_capture(rr, stream, capture, names, model=None):
    """Logs what each camera saw of a capture, and its model; `names` are the readable words for bytes of pictures."""
    stream.set_time("capture", timestamp=capture.time_ns * 1e-9)
    stream.log("rig", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for id, view in capture.colors.items():
        place = f"rig/color/{id}"
        log_camera(rr, stream, place, view)
        stream.log(f"{place}/image", picture(rr, view, names))
    for id, view in capture.depths.items():
        place = f"rig/depth/{id}"
        log_camera(rr, stream, place, view)
        median = np.ma.median(np.ma.masked_equal(view.readings, 0), axis=0).filled(0)
        # 0 is no reading there too.
        metres = view.metres(median)
        stream.log(f"{place}/image", rr.DepthImage(np.nan_to_num(metres).astype(np.float32), meter=1.0))
    if model is not None:
        mesh = rr.Mesh3D(vertex_positions=model.vertices, triangle_indices=model.triangles, vertex_colors=model.colors)
        stream.log("rig/model", mesh)


def picture(rr, view, names):
    """A camera's picture as the viewer knows it; a raw one of a mosaic is shown grey."""
    pixels = view.picture
    if isinstance(pixels, bytes):
        return rr.EncodedImage(contents=pixels, media_type=names.get(view.encoding))
    if view.encoding == "bgr8":
        return rr.Image(pixels, color_model="BGR")
    if pixels.ndim == 3 and pixels.shape[2] == 2:
        # The viewer knows only the order Y, U, Y, V.
        pixels = pixels[..., ::-1] if view.encoding in ("uyvy", "yuv422") else pixels
        height, width = pixels.shape[:2]
        return rr.Image(bytes=pixels.tobytes(), width=width, height=height, pixel_format=rr.PixelFormat.YUY2)
    return rr.Image(pixels)


def log_camera(rr, stream, place, view):
    """Logs a camera's pose and lens, as far as the recording has them."""
    if view.rig_from_camera is not None:
        pose = view.rig_from_camera
        stream.log(place, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    if view.lens is not None:
        size = [view.lens.width, view.lens.height]
        pinhole = rr.Pinhole(image_from_camera=view.lens.matrix, resolution=size, camera_xyz=rr.ViewCoordinates.RDF)
        stream.log(f"{place}/image", pinhole)


def convert(recording, out, models=None):
    """Writes the captures of a recording, and their models below the folder `models`; the number of captures."""
    import rerun as rr

    names = {"jpeg": "image/jpeg", "png": "image/png"}
    name = stem_of(Path(recording))
    stream = rr.RecordingStream("scand", recording_id=name)
    stream.save(str(out))
    count = 0
    for capture in Recording(recording).captures():
        folder = Path(models) / name / capture.id if models else None
        model = read_model(folder) if folder and (folder / "model.ply").is_file() else None
        log_capture(rr, stream, capture, names, model)
        count += 1
    stream.flush()
    return count


def main():
    parser = argparse.ArgumentParser(prog="python -m scand.to_rerun", description="Captures for the viewer Rerun, with depth as depth.")
    parser.add_argument("recording", type=Path)
    parser.add_argument("-o", "--out", type=Path, help="default: the recording's name with .rrd, here")
    parser.add_argument("--models", type=Path, help="show the models of this folder, such as out")
    asked = parser.parse_args()
    if not asked.recording.is_file():
        sys.exit(f"to_rerun: {asked.recording} is no file: give the recording that is to be converted")
    if importlib.util.find_spec("rerun") is None:
        sys.exit("to_rerun: the package rerun-sdk is missing: install it with pip install rerun-sdk")
    out = asked.out or Path(stem_of(asked.recording) + ".rrd")
    try:
        count = convert(asked.recording, out, asked.models)
    except (OSError, ValueError) as error:
        sys.exit(f"to_rerun: {error}")
    print(f"{out}: {count} capture{'' if count == 1 else 's'}; open it with: rerun {out}")


if __name__ == "__main__":
    main()
