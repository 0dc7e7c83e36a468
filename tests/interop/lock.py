"""Locks the readers that are too large for CI: `python3 tests/interop/lock.py large` makes requirements-large.txt of
requirements-large.in, `… neural` the other one. Each package gets the one file that pip takes on this machine, and its digest: a list of
the files for all machines would have 3000 lines. Run it with Python 3.11 on Linux (x86-64), as large.sh does. It downloads little."""

import json
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent


def found(*arguments):
    """What pip would install: (name, version, digest)."""
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed", "--disable-pip-version-check", "--report", "-"]
    report = json.loads(subprocess.run([*pip, *arguments], check=True, capture_output=True, text=True).stdout)
    for each in report["install"]:
        about, file = each["metadata"], each["download_info"]
        # What is built needs packages that no lock has.
        assert file["url"].endswith(".whl"), file["url"]
        yield about["name"].lower(), about["version"], file["archive_info"]["hashes"]["sha256"]


def main(name):
    asked = HERE / f"requirements-{name}.in"
    # A package whose own requirements are left aside has this word behind it.
    lines = [line.split("#") for line in asked.read_text().splitlines() if line and not line.startswith("#")]
    alone = [line[0].strip() for line in lines if line[1:] == [" alone"]]
    with_needs = [line[0].strip() for line in lines if line[1:] != [" alone"]]
    packages = set(found(*with_needs)) | (set(found("--no-deps", *alone)) if alone else set())
    out = [f"# Made by lock.py of {asked.name}, for Python 3.11 on Linux (x86-64). Complete: install it with --no-deps."]
    out += [f"{package}=={version} --hash=sha256:{digest}" for package, version, digest in sorted(packages)]
    asked.with_suffix(".txt").write_text("\n".join(out) + "\n")
    print(f"{asked.with_suffix('.txt').name}: {len(packages)} packages")


main(sys.argv[1])
