"""Everything that is looked at in the guest, chapter after chapter, told on the console. At a failure the journal goes
there, too, packed."""

import base64
import gzip
import sys
import time

import mixed
import pedal
import sandbox
import service
import video
import webcam
from harness import run

CHAPTERS = [module.chapter for module in (service, sandbox, webcam, video, pedal, mixed)]


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


def main():
    wanted = open("/rig-vm/chapters", encoding="ascii").read().split()
    chapters = [c for c in CHAPTERS if not wanted or c.name in wanted]
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
