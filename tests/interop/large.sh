#!/usr/bin/env bash
# Readers that are too large for CI, over what run.sh made: Open3D, MeshLab, Blender, Rerun, and the parser of a neural
# renderer (nerfstudio). `INTEROP=all make interop` runs it. It downloads about 5 GB into target/interop/large and
# target/interop/neural, most of it PyTorch. requirements-large.txt and requirements-neural.txt lock versions and hashes of all
# packages, for Python 3.11 on Linux (x86-64); lock.py makes them.
set -euo pipefail
cd "$(dirname "$0")/../.."

# Installs what a list locks into target/interop/NAME, once for each version of the list.
environment() {
	local name=$1
	local folder=target/interop/$name list=tests/interop/requirements-$name.txt
	local lock
	lock=$(sha256sum "$list" | cut -d ' ' -f 1)
	[ "$(cat "$folder/lock" 2>/dev/null)" != "$lock" ] || return 0
	rm -rf "$folder"
	python3 -m venv "$folder"
	"$folder/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile --require-hashes --no-deps \
		--only-binary :all: -r "$list"
	echo "$lock" >"$folder/lock"
}

environment large
for reader in open3d meshlab rerun blender; do
	PYTHONPATH=python target/interop/large/bin/python tests/interop/check_large.py target/interop/work $reader
done
environment neural
target/interop/neural/bin/python tests/interop/check_large.py target/interop/work nerfstudio
