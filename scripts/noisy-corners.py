#!/usr/bin/env python3
"""Compares OpenCV's detectors on the pictures that scand's test of noisy corners writes.

SCAND_PICTURES=/tmp/noisy cargo test --release -p scand-lab --test rendered noisy_corners:: -- --nocapture
python3 scripts/noisy-corners.py /tmp/noisy     (needs opencv-python)
"""

import sys
from pathlib import Path

import cv2
import numpy as np

COLUMNS, ROWS, SQUARE = 9, 6, 0.025
SECTORS = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY


def classic(picture):
    """Corners of the classic detector, refined in a window of 11 pixels."""
    found, corners = cv2.findChessboardCorners(picture, (COLUMNS, ROWS))
    if not found:
        return None
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    return cv2.cornerSubPix(picture, corners, (5, 5), (-1, -1), criteria)


def sectors(picture):
    """Corners of the sector-based detector."""
    found, corners = cv2.findChessboardCornersSB(picture, (COLUMNS, ROWS), SECTORS)
    return corners if found else None


def off(corners, truth):
    """Squared distances of corners from where they are, in the better of the two orders."""
    orders = [corners.reshape(-1, 2), corners.reshape(-1, 2)[::-1]]
    return min((((order - truth) ** 2).sum(axis=1) for order in orders), key=np.sum)


def measure(folder, detector):
    """Root mean square residual of the calibration, of the distances from the truth, and how many pictures were used."""
    x, y = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
    board = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(np.float32) * SQUARE
    seen, distances, size = [], [], None
    for path in sorted(folder.glob("*.pgm")):
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        size = picture.shape[::-1]
        corners = detector(picture)
        if corners is not None:
            seen.append(corners.astype(np.float32))
            distances.append(off(corners, np.loadtxt(path.with_suffix(".txt"))))
    rms = cv2.calibrateCamera([board] * len(seen), seen, size, None, None)[0]
    return rms, np.sqrt(np.mean(np.concatenate(distances))), len(seen)


for folder in sorted(Path(sys.argv[1]).glob("noise-*"), key=lambda f: float(f.name[6:])):
    for detector in (classic, sectors):
        rms, distance, count = measure(folder, detector)
        print(f"{folder.name} {detector.__name__}: rms {rms:.3f} px, {distance:.3f} px off the truth, {count} pictures")
