#!/usr/bin/env bash
# Readers that are too large for CI, over what run.sh made: Open3D, MeshLab, Blender, Rerun, and the parser of a neural
# renderer (nerfstudio). `INTEROP=all make interop` runs it. It downloads about 5 GB into target/interop/large and
# target/interop/neural, most of it PyTorch; versions are fixed, hashes are not.
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
# nerfstudio without what only training and viewing need: --no-deps, because its own requirements are stricter and larger.
environment=target/interop/neural
if [ ! -e $environment/ready ]; then
	rm -rf $environment
	python3 -m venv $environment
	pip=($environment/bin/python -m pip install --quiet --disable-pip-version-check --no-compile)
	"${pip[@]}" torch==2.7.1 torchvision==0.22.1 numpy==1.26.4 tyro==1.0.17 rich==14.3.4 jaxtyping==0.3.11 imageio==2.38.1 \
		opencv-python-headless==4.11.0.86 plyfile==1.1.3 requests==2.34.2 viser==1.1.1 tensorboard==2.21.0 open3d==0.20.0
	"${pip[@]}" --no-deps nerfstudio==1.1.5
	touch $environment/ready
fi
$environment/bin/python tests/interop/check_large.py target/interop/work nerfstudio
