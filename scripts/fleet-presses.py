#!/usr/bin/env python3
"""Measures whether a fleet delays captures: the time from a press to `durable`, in blocks that take turns, while the
process of the fleet does not run, while its server is there, while it is away, and while it is slow (each answer 0.3 s
late, 200 kB/s). The rig is simulated, on this machine; the server's jobs wait, so that no worker takes processor time.
After each block its jobs are withdrawn, so that each begins with none. Then it measures how long it takes until the rig
tells `done`, press by press, made here and by one worker. Ends with 1 if, beside a server in any state, the median press
is more than 5 % later than without the fleet, or the 95th percentile more than 10 %. No root: it runs in a network
namespace of its own.

    scripts/fleet-presses.py [--presses 200] [--done 20] [--scand target/release/scand]

Needs Debian's nats-server, and a scand with the features aravis and fleet.
"""

import argparse
import json
import os
import random
import shutil
import signal
import socket
import statistics
import sys
import threading
import time

from simulated_rig import SimulatedRig, enter_namespace

CAMERAS = 6
BLOCK = 20
SERVER_PORT = 4222
SLOW_PORT = 4223
# How much later a press may be because of the fleet.
MOST_MEDIAN, MOST_P95 = 0.05, 0.10
WAYS = ["without the fleet", "server there", "server away", "server slow"]


class SlowWire:
    """Leads to the server, and carries each way at most 200 kB/s, 0.3 s late."""

    RATE, LATE = 200_000, 0.3

    def __init__(self):
        listener = socket.create_server(("127.0.0.1", SLOW_PORT))
        threading.Thread(target=self.listen, args=[listener], daemon=True).start()

    def listen(self, listener):
        while True:
            near = listener.accept()[0]
            try:
                far = socket.create_connection(("127.0.0.1", SERVER_PORT))
            except OSError:
                near.close()
                continue
            for ends in [(near, far), (far, near)]:
                threading.Thread(target=self.carry, args=ends, daemon=True).start()

    def carry(self, near, far):
        try:
            while data := near.recv(20_000):
                time.sleep(self.LATE if len(data) < 2000 else len(data) / self.RATE)
                far.sendall(data)
        except OSError:
            pass
        near.close()
        far.close()


class Rig(SimulatedRig):
    def __init__(self, options):
        super().__init__("fleet-presses", options)
        self.size = options.size
        # A debug build of changes that are not committed has no name that others could have; a release build ignores this.
        os.environ["SCAND_FLEET_TEST_PROGRAM"] = "bench"

    def configure(self, name, address=None):
        fleet = f'fleet = "{address}"' if address else ""
        sections = [f'[aravis.cameras.c{n:02}]\naddress = "127.0.1.{n + 1}"' for n in range(CAMERAS)]
        (self.home / f"{name}.toml").write_text(
            f"""[rig]
name = "loopback"
calibration = "calibration.toml"
[sync]
window_ms = 3000.0
[capture]
largest_skew_ms = 500.0
patience_ms = 4000
retry = 0
[recording]
folder = "recordings"
keep_free_mb = 200
[workers]
folder = "models"
{fleet}
[socket]
path = "scand.sock"
[aravis.defaults]
trigger = "software"
transfer = "srgb"
packet_size = 9000
"""
            + "\n".join(sections)
        )

    def prepare(self):
        for port in [SERVER_PORT, SLOW_PORT]:
            self.configure(port, f"nats://127.0.0.1:{port}")
        self.configure("local")
        shape = ["--shape", "mug", "--cameras", str(CAMERAS), "--size", self.size, "--depth-cameras", "0", "--textured"]
        self.command("simulate", *shape, "--out", "served.mcap")
        self.command("info", "served.mcap", "--calibration", "calibration.toml")
        self.start("cameras", self.scand, "simulate", "--serve", "served.mcap", "--empty", said=["serving"])
        ready = [f"camera c{n:02} is ready: " for n in range(CAMERAS)]
        self.ready = ready
        self.start_daemon(SERVER_PORT)
        self.command("background", "--socket", "scand.sock")
        self.tell_cameras("captures")
        time.sleep(0.3)
        self.command("session", "start", "bench", "--socket", "scand.sock")

    def start_daemon(self, configuration):
        (self.home / "daemon.log").unlink(missing_ok=True)
        self.start("daemon", self.scand, "run", "--config", f"{configuration}.toml", said=self.ready)

    def timed(self, number, until="durable"):
        """One press; milliseconds until it is `durable`, or `done`."""
        seconds, _ = self.press(f"bench-{number}", until)
        return 1000 * seconds

    def jobs(self):
        return list((self.home / "recordings/jobs").glob("*.job"))

    def withdraw_jobs(self):
        """Says of each job that it failed, as the process of the fleet would; the daemon ends it."""
        for job in self.jobs():
            answer = {"failed": {"reason": "the measurement is over", "words": ""}}
            written = job.with_suffix(".part")
            written.write_text(json.dumps(answer))
            written.rename(job.with_suffix(".answer"))
        self.until(lambda: not self.jobs(), lambda: "the daemon does not end its jobs")

    def start_server(self):
        server = ["nats-server", "--jetstream", "--addr", "127.0.0.1", "--port", str(SERVER_PORT)]
        self.start("server", *server, "--store_dir", str(self.home / "store"))
        while True:
            try:
                socket.create_connection(("127.0.0.1", SERVER_PORT)).close()
                break
            except OSError:
                time.sleep(0.05)

    def until_done(self, presses):
        """Milliseconds from presses to `done`, one after the other: made here, and by one worker."""
        found = {}
        for way in ["here", "one worker"]:
            self.stop("daemon")
            self.start_daemon("local" if way == "here" else SERVER_PORT)
            if way == "one worker":
                self.start_server()
                self.start("fleet", self.scand, "fleet", "run", "--config", f"{SERVER_PORT}.toml", "--name", "hall")
                address = f"nats://127.0.0.1:{SERVER_PORT}"
                self.start("worker", self.scand, "worker", "--fleet", address, "--name", "w", "--scratch", "scratch")
                time.sleep(2)
            found[way] = [self.timed(f"done-{way[:3]}-{n}", "done") for n in range(presses)]
        for name in ["worker", "fleet", "server"]:
            self.stop(name)
        return found

    def block(self, way, number):
        if way in ["server there", "server slow"]:
            self.start_server()
        if way != "without the fleet":
            port = SLOW_PORT if way == "server slow" else SERVER_PORT
            self.start("fleet", self.scand, "fleet", "run", "--config", f"{port}.toml", "--name", "hall")
            time.sleep(1)
        # Not in step with anything else that comes again and again.
        dice = random.Random(number)
        times = []
        for press in range(BLOCK):
            times.append(self.timed(number * BLOCK + press))
            time.sleep(dice.uniform(0.2, 0.5))
        self.withdraw_jobs()
        self.stop("fleet")
        self.stop("server", signal.SIGKILL)
        shutil.rmtree(self.home / "store", ignore_errors=True)
        return times


def quantile(values, share):
    return sorted(values)[min(len(values) - 1, int(len(values) * share))]


def main():
    parser = argparse.ArgumentParser(description="Measures whether a fleet delays captures.")
    parser.add_argument("--presses", type=int, default=200, help="each way, in blocks of 20")
    parser.add_argument("--done", type=int, default=20, help="presses that are timed until `done`, each way")
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--scand", default="target/release/scand")
    parser.add_argument("--folder", help="where recordings are meanwhile (default: temporary files)")
    options = parser.parse_args()
    if options.presses < BLOCK or options.presses % BLOCK:
        parser.error(f"--presses is {options.presses}: expected a multiple of {BLOCK}, the presses in a block")
    enter_namespace(CAMERAS)
    SlowWire()
    rig = Rig(options)
    try:
        rig.prepare()
        found = {way: [] for way in WAYS}
        number = 0
        for turn in range(options.presses // BLOCK):
            # Each way comes at each place.
            for way in WAYS[turn % len(WAYS) :] + WAYS[: turn % len(WAYS)]:
                found[way] += rig.block(way, number)
                number += 1
        done = rig.until_done(options.done)
    finally:
        rig.end("worker", "fleet", "daemon", "cameras", "server")
    alone = found["without the fleet"]
    delayed = []
    for way, times in found.items():
        median, p95 = statistics.median(times), quantile(times, 0.95)
        compared = (median / statistics.median(alone) - 1, p95 / quantile(alone, 0.95) - 1)
        print(
            f"{way}: {len(times)} presses, press to durable: median {median:.1f} ms, p95 {p95:.1f} ms; against the rig "
            f"without the fleet {100 * compared[0]:+.1f} % and {100 * compared[1]:+.1f} %"
        )
        if compared[0] > MOST_MEDIAN or compared[1] > MOST_P95:
            delayed.append(way)
    for way, times in done.items():
        print(f"press to done, made by {way}: {len(times)} presses, median {statistics.median(times):.0f} ms")
    if delayed:
        sys.exit(f"fleet-presses: captures are delayed: {', '.join(delayed)}")


if __name__ == "__main__":
    main()
