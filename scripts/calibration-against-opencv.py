#!/usr/bin/env python3
"""Calibrates the same pictures with scand and with OpenCV, by turns, and prints for each camera how many views each program
used, the residuals (rms), the focal length, and how well the lens fits OpenCV's corners: all of them, and those of
placements that were held out (the even ones, then the odd ones). Then it prints the distances between cameras and the
times: each program's best run, with reading the pictures and finding the board.

    scripts/calibration-against-opencv.py [PICTURES] [--board 9x6:25mm] [--runs 3] [--truth truth.toml] [--sectors]
        [--scand target/release/scand]

PICTURES is a folder with left01.jpg, right01.jpg and so on, or with a folder for each camera, or a recording. Without it a
session is simulated, and the focal lengths are compared with its truth. `--scand` may be given several times, such as with
the program before a change: then the times of the others are compared with those of the first. OpenCV is installed from
PyPI into target/tools/opencv. It calibrates each camera by itself and then pairs; it detects the board with its classic
detector and refines in windows of a quarter of a square. `--sectors` adds its sector-based detector, which takes far longer.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import venv
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ENVIRONMENT = ROOT / "target/tools/opencv"
PACKAGES = ["opencv-python-headless==4.13.0.92", "numpy==2.4.6", "mcap==1.6.0", "lz4==4.4.5", "zstandard==0.25.0"]
#: A camera's name, perhaps, and the number of a picture.
NUMBERED = re.compile(r"(.*?)[_-]?(\d+)\.(?:bmp|jpe?g|pbm|pgm|png|pnm|ppm|tiff?)", re.IGNORECASE)
#: Fewest views from which a camera is calibrated.
FEWEST = 3


def enter_environment():
    """Goes on with the Python of an environment that has OpenCV, which is made first where it is missing."""
    python, lock = ENVIRONMENT / "bin/python", ENVIRONMENT / "packages"
    if not lock.is_file() or lock.read_text() != " ".join(PACKAGES):
        venv.create(ENVIRONMENT, clear=True, with_pip=True)
        pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, *PACKAGES], check=True)
        lock.write_text(" ".join(PACKAGES))
    if Path(sys.prefix).resolve() != ENVIRONMENT.resolve():
        os.execv(python, [str(python), str(Path(__file__).resolve()), *sys.argv[1:]])


@dataclass
class Board:
    text: str

    def __post_init__(self):
        found = re.fullmatch(r"(\d+)x(\d+):([\d.]+)mm", self.text)
        if not found:
            sys.exit(f"--board is {self.text!r}, expected COLUMNSxROWS:SIDEmm in inner corners, such as 9x6:25mm")
        self.size = (int(found[1]), int(found[2]))
        x, y = np.meshgrid(np.arange(self.size[0]), np.arange(self.size[1]))
        square = 1e-3 * float(found[3])
        self.points = (np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3) * square).astype(np.float32)


@dataclass
class Lens:
    matrix: "np.ndarray"
    distortion: "np.ndarray"

    def squares(self, board, corners):
        """Squared distances of a view's corners from where the lens sees them, with the board where they fit best."""
        _, turn, place = cv2.solvePnP(board.points, corners, self.matrix, self.distortion)
        seen, _ = cv2.projectPoints(board.points, turn, place, self.matrix, self.distortion)
        return ((seen - corners) ** 2).sum(axis=-1).ravel()


@dataclass
class Calibrated:
    """A camera as one program calibrated it."""

    views: int
    rms: float
    lens: Lens


@dataclass
class Result:
    """What one program made of all pictures, its cameras by their names."""

    cameras: dict = field(default_factory=dict)
    #: Distance in metres between the first camera and others.
    distances: dict = field(default_factory=dict)
    #: By wall clock, and of all processors, in seconds.
    times: tuple = (float("inf"), float("inf"))


def in_folder(folder):
    """The pictures of each camera by their numbers."""
    pictures = {}
    for path in sorted(folder.rglob("*")):
        found = NUMBERED.fullmatch(path.name)
        if found and path.is_file():
            name = (found[1] if path.parent == folder else path.parent.name) or "camera"
            camera = re.sub("[^a-z0-9_-]", "_", name.lower())[:32]
            pictures.setdefault(camera, {})[int(found[2])] = path
    return pictures


def in_recording(path, folder):
    """The same of a recording; its pictures are written as grey PNG files."""
    sys.path.insert(0, str(ROOT / "python"))
    from scand import Recording

    pictures = {}
    for index, capture in enumerate(Recording(path).captures()):
        for camera, view in capture.colors.items():
            file = folder / camera / f"{index:03}.png"
            file.parent.mkdir(exist_ok=True)
            cv2.imwrite(str(file), grey(view))
            pictures.setdefault(camera, {})[index] = file
    return pictures


def grey(view):
    picture = view.picture
    if isinstance(picture, bytes):
        return cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_GRAYSCALE)
    # OpenCV names a mosaic after its second row.
    mosaics = {"rggb": cv2.COLOR_BayerBG2GRAY, "bggr": cv2.COLOR_BayerRG2GRAY}
    mosaics |= {"gbrg": cv2.COLOR_BayerGR2GRAY, "grbg": cv2.COLOR_BayerGB2GRAY}
    for order, code in mosaics.items():
        if view.encoding.startswith(f"bayer_{order}"):
            return cv2.cvtColor(picture, code)
    if picture.ndim == 3:
        code = cv2.COLOR_BGR2GRAY if view.encoding == "bgr8" else cv2.COLOR_RGB2GRAY
        return cv2.cvtColor(picture, code)
    return picture


def in_common(pictures):
    """The files of each camera, of the placements that all cameras have."""
    pictures = {camera: files for camera, files in sorted(pictures.items()) if len(files) >= FEWEST}
    if not pictures:
        sys.exit(f"there is no camera with {FEWEST} numbered pictures or more")
    common = sorted(set.intersection(*(set(files) for files in pictures.values())))
    if len(common) < FEWEST:
        sys.exit(f"the cameras {', '.join(pictures)} have {len(common)} pictures of the same numbers, expected {FEWEST}")
    return {camera: [files[number] for number in common] for camera, files in pictures.items()}


def classic(picture, board):
    """Corners of the classic detector, refined in windows of a quarter of a square on either side."""
    found, corners = cv2.findChessboardCorners(picture, board.size)
    if not found:
        return None
    side = np.linalg.norm(np.diff(corners.reshape(board.size[1], board.size[0], 2), axis=1), axis=2).min()
    half = int(np.clip(side / 4, 2, 11))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    return cv2.cornerSubPix(picture, corners, (half, half), (-1, -1), criteria)


def sectors(picture, board):
    """Corners of the sector-based detector."""
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(picture, board.size, flags)
    return corners.reshape(-1, 1, 2).astype(np.float32) if found else None


def by_opencv(pictures, board, detector):
    """What OpenCV makes of the pictures, and the corners that it found: of each camera by placement."""
    began, used = time.perf_counter(), time.process_time()
    result, found, size = Result(), {}, {}
    for camera, files in pictures.items():
        found[camera] = {}
        for placement, file in enumerate(files):
            picture = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
            if picture is None:
                sys.exit(f"{file}: OpenCV cannot read it")
            size[camera] = picture.shape[::-1]
            corners = detector(picture, board)
            if corners is not None:
                found[camera][placement] = corners
        calibrated = calibrate(list(found[camera].values()), size[camera], board)
        if calibrated:
            result.cameras[camera] = calibrated
    first = next(iter(pictures))
    for other in [camera for camera in result.cameras if camera != first and first in result.cameras]:
        shared = sorted(found[first].keys() & found[other].keys())
        if len(shared) >= FEWEST:
            pair = [[found[camera][placement] for placement in shared] for camera in (first, other)]
            lenses = [result.cameras[camera].lens for camera in (first, other)]
            known = [value.copy() for lens in lenses for value in (lens.matrix, lens.distortion)]
            points = [board.points] * len(shared)
            flags = cv2.CALIB_USE_INTRINSIC_GUESS
            solved = cv2.stereoCalibrate(points, *pair, *known, size[first], flags=flags)
            # Cameras that see the board the other way up may count its corners from different ends.
            if solved[0] <= 3 * max(result.cameras[camera].rms for camera in (first, other)):
                result.distances[other] = float(np.linalg.norm(solved[6]))
    result.times = (time.perf_counter() - began, time.process_time() - used)
    return result, found, size


def calibrate(corners, size, board):
    """A camera by OpenCV; None from too few views."""
    if len(corners) < FEWEST:
        return None
    rms, matrix, distortion, _, _ = cv2.calibrateCamera([board.points] * len(corners), corners, size, None, None)
    return Calibrated(len(corners), rms, Lens(matrix, distortion.ravel()))


def by_scand(program, pictures, board):
    """What scand makes of the pictures; all cameras at once."""
    command = [program, "calibrate", "--board", f"checkerboard:{board.text}", "--json", "--quiet", "--pictures"]
    for camera, (first, *others) in pictures.items():
        command += [f"{camera}={first}", *map(str, others)]
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as errors:
        began = time.perf_counter()
        process = subprocess.Popen(command, stdout=out, stderr=errors)
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - began
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        errors.seek(0)
        words, told = errors.read().decode(), out.read()
    if not told:
        print(f"{program} ended with {process.returncode}: {words.strip()}", file=sys.stderr)
        return Result()
    told = json.loads(told)
    result = Result(times=(wall, usage.ru_utime + usage.ru_stime))
    for camera, entry in told["cameras"].items():
        (fx, fy), (cx, cy) = entry["focal_px"], entry["center_px"]
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], float)
        lens = Lens(matrix, np.array(entry["distortion"] or [0] * 5, float))
        result.cameras[camera] = Calibrated(entry["views"], entry["figures"]["rms_px"], lens)
    first = next(iter(pictures))
    place = {camera: np.array(entry["translation"]) for camera, entry in told["cameras"].items()}
    others = [camera for camera in place if camera != first and first in place]
    result.distances = {camera: float(np.linalg.norm(place[camera] - place[first])) for camera in others}
    return result


def rms(squares):
    return np.sqrt(np.mean(np.concatenate(squares))) if squares else np.nan


def held_out(calibrated_from, corners, count, board):
    """The rms of each camera's corners in one half of the placements, with its lens from the other half."""
    squares = {camera: [] for camera in corners}
    for half in (0, 1):
        cameras = calibrated_from(range(half, count, 2))
        for camera, found in corners.items():
            tested = [view for placement, view in found.items() if placement % 2 != half]
            if camera in cameras:
                squares[camera] += [cameras[camera].lens.squares(board, view) for view in tested]
    return {camera: rms(own) for camera, own in squares.items()}


def compare(pictures, board, options, truth):
    count = len(next(iter(pictures.values())))
    ways = {}
    for program in options.scand:
        ways[program] = lambda program=program: by_scand(program, pictures, board)
    detectors = {"OpenCV": classic} | ({"OpenCV, sectors": sectors} if options.sectors else {})
    found = {}

    def opencv(name, detector):
        result, *found[name] = by_opencv(pictures, board, detector)
        return result

    for name, detector in detectors.items():
        ways[name] = lambda name=name, detector=detector: opencv(name, detector)
    results, times = {}, {name: [] for name in ways}
    for _ in range(options.runs):
        for name, way in ways.items():
            results[name] = way()
            times[name].append(results[name].times)
    corners, _ = found["OpenCV"]

    def of_scand(program, part):
        some = {camera: [files[placement] for placement in part] for camera, files in pictures.items()}
        return by_scand(program, some, board).cameras

    def of_opencv(name, part):
        own, size = found[name]
        some = {camera: [views[p] for p in part if p in views] for camera, views in own.items()}
        solved = {camera: calibrate(views, size[camera], board) for camera, views in some.items()}
        return {camera: calibrated for camera, calibrated in solved.items() if calibrated}

    unseen = {}
    for name in ways:
        calibrated_from = of_opencv if name in detectors else of_scand
        unseen[name] = held_out(lambda part: calibrated_from(name, part), corners, count, board)
    print(f"{count} placements, {len(pictures)} cameras; corners of OpenCV are those of its classic detector")
    heading = f"{'camera':<12} {'program':<32} {'views':>5} {'rms px':>7} {'on OpenCV corners':>17} {'held out':>8}"
    print(f"{heading} {'focal px':>18}{'  focal off %' if truth else ''}")
    for camera in pictures:
        for name, result in results.items():
            own = result.cameras.get(camera)
            if own is None:
                print(f"{camera:<12} {name[-32:]:<32} not calibrated")
                continue
            on_corners = rms([own.lens.squares(board, view) for view in corners[camera].values()])
            focal = np.diag(own.lens.matrix)[:2]
            line = f"{camera:<12} {name[-32:]:<32} {own.views:>5} {own.rms:>7.3f} {on_corners:>17.4f}"
            line += f" {unseen[name][camera]:>8.4f} {focal[0]:>9.2f}{focal[1]:>9.2f}"
            if camera in truth:
                line += f" {100 * np.abs(focal / truth[camera] - 1).max():>12.4f}"
            print(line)
    first = next(iter(pictures))
    for camera in pictures:
        told = [f"{name} {1e3 * r.distances[camera]:.3f} mm" for name, r in results.items() if camera in r.distances]
        if told:
            print(f"from {first} to {camera}: {', '.join(told)}")
    best = {name: [min(own[k] for own in all_times) for k in (0, 1)] for name, all_times in times.items()}
    for name, (wall, processor) in best.items():
        line = f"{name}: {wall:.2f} s, {processor:.2f} s of processors (best of {options.runs})"
        if name in options.scand[1:]:
            line += f", {wall / best[options.scand[0]][0]:.2f} times the first program's"
        print(line)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pictures", nargs="?", type=Path)
    parser.add_argument("--board", default="9x6:25mm")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--sectors", action="store_true")
    parser.add_argument("--scand", action="append")
    options = parser.parse_args()
    if options.runs < 1:
        parser.error("--runs must be 1 or more")
    options.scand = [str(Path(program).resolve()) for program in options.scand or [ROOT / "target/release/scand"]]
    return options


def main(options):
    with tempfile.TemporaryDirectory(prefix="calibration-against-opencv-") as home:
        home = Path(home)
        if options.pictures is None:
            options.pictures, options.truth = home / "session.mcap", home / "truth.toml"
            command = [options.scand[0], "simulate", "--calibration-session", "--size", "1280x960", "--encoding", "mono"]
            command += ["--out", str(options.pictures), "--truth", str(options.truth)]
            subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
        truth = {}
        if options.truth:
            cameras = tomllib.loads(options.truth.read_text())["cameras"]
            truth = {camera: np.array(entry["focal_px"]) for camera, entry in cameras.items()}
        if options.pictures.is_dir():
            pictures = in_folder(options.pictures.resolve())
        elif options.pictures.is_file():
            pictures = in_recording(options.pictures, home)
        else:
            sys.exit(f"{options.pictures}: there is no such folder and no such recording")
        compare(in_common(pictures), Board(options.board), options, truth)


if __name__ == "__main__":
    given = arguments()
    enter_environment()
    import tomllib

    import cv2
    import numpy as np

    main(given)
