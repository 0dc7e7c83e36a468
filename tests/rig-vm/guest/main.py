"""Everything that is looked at in the guest, chapter after chapter, told on the console. At a failure the journal goes
there, too, packed."""

import base64
import gzip
import os
import re
import sys
import threading
import time

import day
import fleet
import mixed
import pedal
import removal
import sandbox
import service
import video
import webcam
from harness import run

CHAPTERS = [module.chapter for module in (service, sandbox, webcam, video, pedal, day, fleet, mixed, removal)]


def tell(line):
    print(" ".join(line.split("\n")) if not line.startswith("-----") else line, flush=True)


def journal():
    """What there is to know of a failure, for the host."""
    # Without the kernel's traces: vivid fills pages with them when the processors are slow.
    lines = run("journalctl", "-b", "--no-pager", "-o", "short-monotonic", "-n", "20000", expected=None).splitlines()
    words = [
        "\n".join(line for line in lines if "kernel:  " not in line),
        run("systemctl", "--no-pager", "--all", "list-units", "scand*", expected=None),
        run("find", "/dev/scand", "/var/lib/scand", "/dev/input", "-ls", expected=None),
    ]
    packed = base64.encodebytes(gzip.compress("\n".join(words).encode())).decode()
    tell(f"-----BEGIN JOURNAL-----\n{packed}-----END JOURNAL-----")


def asked(what):
    """What the host asks for, on the kernel's command line."""
    found = re.search(rf"rig-vm\.{what}=(\S*)", open("/proc/cmdline", encoding="ascii").read())
    return found[1] if found else ""


def give_up(chapters):
    """Ends it all when its time is over, and tells where it was."""
    at = next((f"{c.name}: {c.at}" for c in chapters if c.at), "between two chapters")
    tell(f"rig-vm: FAILED: not at its end within {asked('seconds')} s, but at: {at}")
    journal()
    os._exit(1)


def main():
    wanted = asked("chapters").split(",")
    chapters = [c for c in CHAPTERS if c.name in wanted]
    limit = threading.Timer(float(asked("seconds")), give_up, [chapters])
    limit.daemon = True
    limit.start()
    service.install()
    passed, failed = 0, []
    for chapter in chapters:
        well, fault = chapter.go(tell)
        passed += well
        failed += [fault] if fault else []
    if failed:
        journal()
        tell(f"rig-vm: {passed} checks passed, FAILED: {'; '.join(failed)}")
    elif passed:
        tell(f"rig-vm: passed {passed} checks, {time.monotonic():.0f} s after the start")


try:
    main()
except BaseException as error:
    tell(f"rig-vm: FAILED: {type(error).__name__}: {error}")
    journal()
    raise
sys.stdout.flush()
