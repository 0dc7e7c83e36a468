#!/usr/bin/env python3
"""Measures how soon the daemon tells how the captures of one object lie: the time from `durable` to `registered`, from
`registered` to `fused`, and by how much that delays the `done` of the capture. The rig is simulated, on this machine:
eleven colour cameras and a depth camera show an object in four poses. Each round presses once for each pose and waits
until all that the press began is over; in half of the rounds the presses name a subject, in the others they do not, and
the two take turns. Then it fuses the four captures by hand, and measures time and memory of that process. Last it fuses
four captures of 5 megapixels by hand, under the limits of memory and time that a worker has. Ends with 1 if, by the
median, `registered` is later than 10 s with two captures or 15 s with four, or `done` is delayed by more than 5 s, or if
by hand poses take more than 12 s, all takes more than 25 s or memory is more than 1.5 GB, or if 5 megapixels need more
than a worker may take. No root: it runs in a network namespace of its own.

    scripts/fuse-times.py [--rounds 5] [--size 1280x960] [--shape cup] [--only large] [--scand target/release/scand]

Needs libopenni2-0, and a scand with the feature rig; `--only large` needs no more than `scand simulate`.
"""

import argparse
import json
import os
import resource
import shutil
import socket
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path

from simulated_rig import SimulatedRig, enter_namespace

ROOT = Path(__file__).parent.parent
CAMERAS = 11
POSES = ["upright", "flip", "side:35", "turn:90"]
# Seconds: from `durable` to `registered`, by the number of captures, and by how much `done` may be later.
MOST_REGISTERED = {2: 10, 4: 15}
MOST_DELAY = 5
# By hand, four captures of 1.2 megapixels on two cores: seconds for poses and for all, and bytes.
MOST_POSES, MOST_ALL, MOST_BYTES = 12, 25, 1.5e9
# By hand, large pictures: bytes and seconds that a worker may take, unless workers.memory_mb and workers.time_limit_s say
# otherwise.
LARGE, WORKER_BYTES, WORKER_SECONDS = "2560x1920", 4000 * 1_000_000, 900
SUBJECT = "17"
# Seconds after which something that was waited for does not come any more.
PATIENCE = 300


class Events:
    """All events of the daemon, each with the time at which it came."""

    def __init__(self, path):
        self.found = []
        self.changed = threading.Condition()
        self.client = socket.socket(socket.AF_UNIX)
        self.client.connect(path)
        self.client.sendall(b'{"type":"events"}\n')
        threading.Thread(target=self.listen, daemon=True).start()
        self.wait("listening")

    def listen(self):
        for line in self.client.makefile():
            event = json.loads(line)
            with self.changed:
                self.found.append((time.monotonic(), event))
                self.changed.notify_all()

    def wait(self, kind, **members):
        """Seconds at which the event came, and the event."""
        failed = {"done": "job_failed"}.get(kind)
        end = time.monotonic() + PATIENCE
        with self.changed:
            while True:
                for when, event in self.found:
                    if all(event.get(name) == value for name, value in members.items()):
                        if event["type"] == kind:
                            return when, event
                        if event["type"] == failed:
                            sys.exit(f"fuse-times: {json.dumps(event)}")
                if not self.changed.wait(end - time.monotonic()):
                    sys.exit(f"fuse-times: no event {kind} {members} within {PATIENCE} s")


class Rig(SimulatedRig):
    def __init__(self, options):
        super().__init__("fuse-times", options)
        self.options = options

    def prepare(self):
        stage = subprocess.run([ROOT / "tests/openni2-sensor/stage.sh"], check=True, capture_output=True, text=True)
        shutil.copy(ROOT / "config/loopback.toml", self.home / "rig.toml")
        self.simulate("served", self.options.size)
        self.command("info", "served.mcap", "--calibration", "calibration.toml")
        served = ["served.mcap", "--empty", "--sensor-frames", "frames"]
        self.start("cameras", self.scand, "simulate", "--serve", *served, said=["serving"])
        self.play(0)
        ready = [f"camera {name} is ready: " for name in [*(f"c{n:02}" for n in range(CAMERAS)), "kinect"]]
        sensor = {"SCAND_OPENNI2_FRAMES": self.home / "frames", "SCAND_OPENNI2_CONTROL": self.home / "control"}
        libraries = {"LD_LIBRARY_PATH": stage.stdout.strip()}
        self.start("daemon", self.scand, "run", "--config", "rig.toml", said=ready, **sensor, **libraries)
        self.command("background", "--socket", "scand.sock")
        self.command("session", "start", "times", "--socket", "scand.sock")
        self.events = Events(str(self.home / "scand.sock"))

    def simulate(self, name, size):
        """Records the object in all poses."""
        poses = ["--poses", ",".join(POSES), "--calibration-px", "0.15"]
        shape = ["--shape", self.options.shape, "--textured", "--size", size, "--encoding", "bayer"]
        self.command("simulate", *shape, *poses, "--subject", SUBJECT, "--out", f"{name}.mcap")

    def play(self, pose):
        """What the depth camera plays from now on; it says so in a file beside, which is there as long as it plays."""
        (self.home / "control.part").write_text(f"* capture {pose}\n")
        (self.home / "control.part").rename(self.home / "control")

    def show(self, pose):
        """Puts the object into a pose."""
        obeyed = self.log("cameras").count("ok\n")
        self.tell_cameras(f"captures {pose}")
        self.play(pose)
        self.until(lambda: self.log("cameras").count("ok\n") > obeyed, lambda: "the cameras do not obey")
        heard = self.home / "control.heard-kinect"
        is_heard = lambda: not heard.exists() or heard.read_text() == f"* capture {pose}\n"
        self.until(is_heard, lambda: "the depth camera does not obey")

    def round(self, number, has_subject):
        """For each number of captures the seconds that it took, by name."""
        subject = f"object-{number}" if has_subject else None
        found = {}
        for pose in range(len(POSES)):
            self.show(pose)
            about = {"subject": subject} if subject else {}
            _, reply = self.press(f"round-{number}-{pose}", "durable", **about)
            capture = reply["capture"]
            durable, _ = self.events.wait("durable", capture=capture)
            done, _ = self.events.wait("done", capture=capture)
            times = {"done": done - durable}
            if has_subject and pose > 0:
                registered, told = self.events.wait("registered", subject=subject, capture=capture)
                fused, _ = self.events.wait("fused", subject=subject, capture=capture)
                times |= {"registered": registered - durable, "fused": fused - registered}
                if told["verdict"] == "red":
                    print(f"{pose + 1} captures: {told['words']}")
            found[pose + 1] = times
        return found

    def by_hand(self, name, most_bytes=None):
        """Seconds for poses and for all, and bytes of memory at most, of fusing a recording; with a limit of memory, if
        there is one, as a worker has it."""

        def limit():
            if most_bytes is not None:
                resource.setrlimit(resource.RLIMIT_DATA, (most_bytes, most_bytes))

        began = time.monotonic()
        said = self.home / f"fuse-{name}.log"
        with open(said, "wb") as log:
            fuse = [self.scand, "fuse", f"{name}.mcap", "--subject", SUBJECT, "--out", "by-hand", "--quiet"]
            process = subprocess.Popen(fuse, cwd=self.home, stdout=log, stderr=log, preexec_fn=limit)
            _, status, used = os.wait4(process.pid, 0)
        took = time.monotonic() - began
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode != 0:
            sys.exit(f"fuse-times: scand fuse {name}.mcap ended with {process.returncode}: {said.read_text()}")
        report = json.loads((self.home / f"by-hand/{name}/{SUBJECT}.object/report.json").read_text())
        stages = {stage["stage"]: stage["seconds"] for stage in report["timing"]["stages"]}
        return stages["registration"], took, 1024 * used.ru_maxrss


def told(values):
    return f"median {statistics.median(values):.1f} s, at most {max(values):.1f} s"


def main():
    parser = argparse.ArgumentParser(description="Measures how soon captures of one object are registered and fused.")
    parser.add_argument("--rounds", type=int, default=5, help="of four presses, with a subject and without")
    parser.add_argument("--size", default="1280x960")
    parser.add_argument("--shape", default="cup")
    parser.add_argument("--scand", default="target/release/scand")
    parser.add_argument("--only", choices=["rounds", "large"], help="only presses, or only pictures of 5 megapixels")
    parser.add_argument("--folder", help="where recordings are meanwhile (default: temporary files)")
    options = parser.parse_args()
    if options.rounds < 1:
        parser.error(f"--rounds is {options.rounds}: expected 1 or more")
    if options.only != "large":
        enter_namespace(CAMERAS)
    rig = Rig(options)
    try:
        late = rounds(rig, options) if options.only != "large" else []
        late += large(rig, options) if options.only != "rounds" else []
    finally:
        rig.end("daemon", "cameras")
    if late:
        sys.exit(f"fuse-times: {', '.join(late)}")


def rounds(rig, options):
    """Presses for objects, with and without a subject, and fuses by hand; what is not as it must be."""
    alone, together = [], []
    rig.prepare()
    for turn in range(options.rounds):
        # Each kind comes first as often as the other.
        for has_subject in [False, True] if turn % 2 else [True, False]:
            (together if has_subject else alone).append(rig.round(2 * turn + has_subject, has_subject))
    poses, whole, memory = rig.by_hand("served")
    late = []
    print(f"{options.shape}, {options.size}, {os.cpu_count()} processors, {options.rounds} rounds:")
    for count in range(2, len(POSES) + 1):
        of = {name: [found[count][name] for found in together] for name in ["done", "registered", "fused"]}
        done = [found[count]["done"] for found in alone]
        delay = statistics.median(of["done"]) - statistics.median(done)
        print(
            f"{count} captures: durable to registered {told(of['registered'])}; registered to fused {told(of['fused'])}; durable to "
            f"done {told(of['done'])}, without a subject {told(done)}: {delay:+.1f} s"
        )
        if statistics.median(of["registered"]) > MOST_REGISTERED.get(count, max(MOST_REGISTERED.values())):
            late.append(f"{count} captures are registered late")
        if delay > MOST_DELAY:
            late.append(f"registering {count} captures delays a capture's model")
    print(f"by hand, {len(POSES)} captures: {whole:.1f} s, of them {poses:.1f} s for poses, {memory / 1e9:.2f} GB at most")
    if poses > MOST_POSES or whole > MOST_ALL or memory > MOST_BYTES:
        late.append("fusing by hand takes more than it may")
    return late


def large(rig, options):
    """Fuses large pictures by hand within a worker's memory; what is not as it must be."""
    rig.simulate("large", LARGE)
    poses, whole, memory = rig.by_hand("large", WORKER_BYTES)
    print(
        f"by hand, {options.shape}, {LARGE}, {len(POSES)} captures: {whole:.1f} s, of them {poses:.1f} s for poses, "
        f"{memory / 1e9:.2f} GB at most, of {WORKER_BYTES / 1e9:.2f} GB that a worker may take"
    )
    return ["large pictures take more than a worker may"] if memory > WORKER_BYTES or whole > WORKER_SECONDS else []


if __name__ == "__main__":
    main()
