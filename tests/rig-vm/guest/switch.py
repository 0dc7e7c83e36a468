"""A foot switch that we press ourselves (uinput)."""

import fcntl
import os
import struct
import time
from pathlib import Path

from harness import run, until

KEY_B = 48
SCROLL_LOCK = 2
EV_SYN, EV_KEY, EV_LED = 0, 1, 0x11
UI_SET_EVBIT, UI_SET_KEYBIT, UI_SET_LEDBIT, UI_DEV_SETUP, UI_DEV_CREATE, UI_DEV_DESTROY = (
    0x40045564,
    0x40045565,
    0x40045569,
    0x405C5503,
    0x5501,
    0x5502,
)


class Switch:
    """A foot switch of PCsensor, or another input device with a key."""

    def __init__(self, vendor=0x0C45, product=0x7403, name="PCsensor FootSwitch", leds=False):
        run("modprobe", "-a", "uinput", "evdev")
        before = set(Path("/dev/input").glob("event*"))
        self.file = os.open("/dev/uinput", os.O_WRONLY)
        fcntl.ioctl(self.file, UI_SET_EVBIT, EV_KEY)
        # All letters and digits: a foot switch is a keyboard to the kernel.
        for key in range(1, 84):
            fcntl.ioctl(self.file, UI_SET_KEYBIT, key)
        if leds:
            fcntl.ioctl(self.file, UI_SET_EVBIT, EV_LED)
            fcntl.ioctl(self.file, UI_SET_LEDBIT, SCROLL_LOCK)
        fcntl.ioctl(self.file, UI_DEV_SETUP, struct.pack("<HHHH80sI", 3, vendor, product, 1, name.encode(), 0))
        fcntl.ioctl(self.file, UI_DEV_CREATE)
        self.device = until("the switch is there", lambda: set(Path("/dev/input").glob("event*")) - before).pop()
        run("udevadm", "settle")

    @property
    def unit(self):
        """The unit that reads it."""
        return f"scand-pedal@{self.device.name}.service"

    def key(self, value, code=KEY_B):
        """Moves a key: 1 is down, 0 up, 2 a repeat."""
        for kind, code, number in ((EV_KEY, code, value), (EV_SYN, 0, 0)):
            os.write(self.file, struct.pack("<qqHHi", 0, 0, kind, code, number))

    def press(self, gaps_ms=(), held_ms=120):
        """Presses and lets go; the contact bounces, each time after such a gap. Gives the longest that a gap can have been."""
        longest = 0.0
        for last in (1, 0):
            level, gaps = last, list(gaps_ms)
            if len(gaps) % 2:
                gaps.append(gaps[-1])
            begin = time.monotonic()
            self.key(level)
            for gap in gaps:
                # Slept through but for the end: a sleep may be long, and a bounce may not.
                time.sleep(max(0, gap / 1000 - 0.01))
                while time.monotonic() < begin + gap / 1000:
                    pass
                level, before, begin = 1 - level, begin, time.monotonic()
                self.key(level)
                # The kernel's time of a move is somewhere between the begin of its call and the end.
                longest = max(longest, time.monotonic() - before)
            time.sleep(held_ms / 1000)
        return longest * 1000

    def remove(self):
        """Pulls it out."""
        fcntl.ioctl(self.file, UI_DEV_DESTROY)
        os.close(self.file)
        run("udevadm", "settle")
