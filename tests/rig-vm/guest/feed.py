"""Writes the JPEG files of a recording into a loopback device, ten in a second, until it is ended."""

import sys
import time

import webcam

with open(sys.argv[1], "wb", buffering=0) as device:
    files = webcam.jpegs()
    while True:
        for file in files:
            device.write(file)
            time.sleep(0.1)
