#!/usr/bin/env python3
"""Measures what a fleet costs on this machine: processor time, bytes on the wire and wall time for the same captures made
locally, by one worker and by two, in alternating order. Packing, hashing, checking, committing, and the share that the rig
makes again are counted; the server's time is stated apart. One worker is compared with a replay of one capture at a time, and
with what a rig without a fleet does: a confined process for each capture. Two workers stand for two machines: each has half
of this one's processors. They are compared with a replay of two captures at a time, and with such processes. Prints a line
for each run, then the best run of each way, and how long it takes until the model of a capture is heard of when no other
one waits.

    scripts/fleet-bench.py [--captures 100] [--rounds 3] [--size 1280x960] [--scand target/release/scand]

Needs Debian's nats-server. A debug build works as well; its figures are its own.
"""

import argparse
import json
import os
import shutil
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def wait(process):
    """Waits for a process; the processor time of it and of all children that it waited for, in seconds."""
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return usage.ru_utime + usage.ru_stime


def stop(process):
    process.send_signal(signal.SIGTERM)
    return wait(process)


class Bench:
    def __init__(self, options):
        self.options = options
        self.scand = str(Path(options.scand).resolve())
        self.home = Path(tempfile.mkdtemp(prefix="fleet-bench-", dir=options.folder))
        self.recording = self.home / "captures.mcap"
        # A debug build of changes that are not committed has no name that others could have; a release build ignores this.
        self.environment = {**os.environ, "SCAND_FLEET_TEST_PROGRAM": "bench"}
        command = ["simulate", "--shape", "cup", "--size", options.size, "--cameras", str(options.cameras)]
        command += ["--captures", str(options.captures), "--masks", "--depth-frames", "10", "--out", str(self.recording)]
        subprocess.run([self.scand, *command], check=True, stderr=subprocess.DEVNULL)

    def replay(self, out, *more):
        command = [self.scand, "--replay", str(self.recording), "--out", str(out), "--json", "--quiet", *more]
        began = time.monotonic()
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=self.environment)
        results, heard = [], [began]
        for line in process.stdout:
            results.append(json.loads(line)["result"])
            heard.append(time.monotonic())
        processor = wait(process)
        if process.returncode != 0 or set(results) != {"done"}:
            sys.exit(f"fleet-bench: the replay ended with {process.returncode}: {results}")
        # From one capture to the next; the first has to wait for the program, too.
        apart = [b - a for a, b in zip(heard[1:], heard[2:])]
        return {
            "processor_s": processor,
            "wall_s": time.monotonic() - began,
            "median_s_apart": statistics.median(apart) if apart else 0.0,
        }

    def local(self, *more):
        out = self.home / "local"
        found = self.replay(out, *more)
        shutil.rmtree(out)
        return found

    def as_a_rig(self):
        """Makes each capture as the daemon does: by a process of its own, confined and of the lowest priority."""
        out, settings = self.home / "rig", self.home / "settings.toml"
        settings.write_text("", encoding="utf-8")
        began, processor = time.monotonic(), 0.0
        for number in range(self.options.captures):
            command = [self.scand, "make-model", f"--parent={os.getpid()}", "--memory-mb=4000", "--nice=19"]
            command += ["--replay", str(self.recording), "--capture", f"cup-{number:03}", "--out", str(out)]
            process = subprocess.Popen([*command, "--config", str(settings), "--quiet"], stderr=subprocess.DEVNULL)
            processor += wait(process)
            if process.returncode != 0:
                sys.exit(f"fleet-bench: make-model ended with {process.returncode}")
        wall = time.monotonic() - began
        shutil.rmtree(out)
        return {"processor_s": processor, "wall_s": wall, "median_s_apart": wall / self.options.captures}

    def fleet(self, workers, *more):
        port, monitor = free_port(), free_port()
        store, out = self.home / "store", self.home / "fleet"
        command = ["nats-server", "--jetstream", "--addr", "127.0.0.1", "--port", str(port), "--http_port", str(monitor)]
        server = subprocess.Popen([*command, "--store_dir", str(store)], stderr=subprocess.DEVNULL)
        address = f"nats://127.0.0.1:{port}"
        while True:
            try:
                socket.create_connection(("127.0.0.1", port)).close()
                break
            except OSError:
                time.sleep(0.05)
        running = []
        processors = sorted(os.sched_getaffinity(0))
        for number in range(workers):
            command = [self.scand, "worker", "--fleet", address, "--name", f"w{number}"]
            command += ["--scratch", str(self.home / "scratch")]
            own = processors[number::workers] or processors
            command = ["taskset", "--cpu-list", ",".join(map(str, own)), *command]
            running.append(subprocess.Popen(command, env=self.environment, stderr=subprocess.DEVNULL))
        found = self.replay(out, "--fleet", address, "--name", "bench", *more)
        found["processor_s"] += sum(stop(worker) for worker in running)
        with urllib.request.urlopen(f"http://127.0.0.1:{monitor}/varz") as answer:
            counts = json.load(answer)
        for name in ["in_bytes", "out_bytes"]:
            found[f"server_{name}_a_capture"] = counts[name] / self.options.captures
        found["server_processor_s"] = stop(server)
        for folder in [store, out]:
            shutil.rmtree(folder)
        return found

    def run(self):
        ways = {
            "local": self.local,
            "local, a process each": self.as_a_rig,
            "one worker": lambda: self.fleet(1),
            "local, two at a time": lambda: self.local("--jobs", "2"),
            "two workers": lambda: self.fleet(2),
        }
        compared_with = [
            ("one worker", "local"),
            ("one worker", "local, a process each"),
            ("two workers", "local, two at a time"),
            ("two workers", "local, a process each"),
        ]
        best = {}
        for number in range(self.options.rounds):
            for name, way in ways.items():
                found = way()
                print(f"round {number}, {name}: {words(found)}", flush=True)
                if name not in best or found["processor_s"] < best[name]["processor_s"]:
                    best[name] = found
        for name, found in best.items():
            print(f"best, {name}: {words(found)}")
        for name, other in compared_with:
            more = best[name]["processor_s"] / best[other]["processor_s"] - 1
            print(f"{name}, processor time against {other}: {100 * more:+.1f} %")
        some = [f"--capture=cup-{number:03}" for number in range(min(8, self.options.captures))]
        alone = {"local": self.local(*some), "one worker": self.fleet(1, "--in-flight", "1", *some)}
        for name, found in alone.items():
            print(f"{len(some)} captures one after the other, {name}: {found['median_s_apart']:.2f} s until a model is heard of")


def words(found):
    return ", ".join(f"{name} {value:.2f}" for name, value in found.items())


def main():
    parser = argparse.ArgumentParser(description="Measures what a fleet costs on this machine.")
    parser.add_argument("--captures", type=int, default=100)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--size", default="1280x960")
    parser.add_argument("--cameras", type=int, default=6)
    parser.add_argument("--scand", default="target/release/scand")
    parser.add_argument("--folder", help="where recordings and models are meanwhile (default: temporary files)")
    bench = Bench(parser.parse_args())
    try:
        bench.run()
    finally:
        shutil.rmtree(bench.home)


if __name__ == "__main__":
    main()
