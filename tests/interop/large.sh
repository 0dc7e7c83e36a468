#!/usr/bin/env bash
# Readers that are too large for CI, over what run.sh made: Open3D, MeshLab, Blender, Rerun. `INTEROP=all make
# interop` runs it. It downloads about 1 GB into target/interop/large; versions are fixed, hashes are not.
set -euo pipefail
cd "$(dirname "$0")/../.."
environment=target/interop/large
if [ ! -e $environment/ready ]; then
	rm -rf $environment
	python3 -m venv $environment
	pip=($environment/bin/python -m pip install --quiet --disable-pip-version-check --no-compile)
	"${pip[@]}" open3d==0.20.0 pymeshlab==2025.7.post1 bpy==4.2.0 rerun-sdk==0.41.0 mcap==1.6.0
	touch $environment/ready
fi
for reader in open3d meshlab rerun blender; do
	PYTHONPATH=python $environment/bin/python tests/interop/check_large.py target/interop/work $reader
done
