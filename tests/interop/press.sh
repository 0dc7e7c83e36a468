#!/usr/bin/env bash
# From a press on the simulated rig to an archive package, a model, a dataset and a published page, each checked with
# somebody else's reader. SCAND names a program with cameras (features rig and lab), PYTHON one with the readers;
# press.sh FOLDER makes the folder. `make interop` runs it.
set -euo pipefail
root=$(cd "$(dirname "$0")/../.." && pwd)
scand=$(realpath "$SCAND")
work=$(realpath -m "$1")
rm -rf "$work"
mkdir -p "$(dirname "$work")"
# Cameras, daemon, background pictures, a session, a press, its model.
cd "$root"
OUT=$(realpath -m --relative-to=. "$work") SCAND=$(realpath --relative-to=. "$scand") ABOUT=operator=Zacharias scripts/rig-demo.sh recordings/cup.mcap
cd "$work"
"$scand" note demo-0001 accept --author Zacharias --recording recordings/demo.mcap
"$scand" archive demo --recordings recordings --models models -o package --date 2026-01-31
"$scand" verify package
"$scand" export models --format glb --lod 1 -o exported
"$scand" export recordings/demo.mcap --dataset colmap --model models -o colmap
"$scand" publish models --recordings recordings --address https://museum.example/3d -o site
"$PYTHON" "$root/tests/interop/check_press.py" .
