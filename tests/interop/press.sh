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
export ABOUT=operator=Zacharias SUBJECT=1884.3
OUT=$work SCAND=$scand scripts/rig-demo.sh recordings/cup.mcap
cd "$work"
"$scand" note demo-0001 accept --author Zacharias --recording recordings/demo.mcap
# The object's number, the session and the capture each name the same recording here.
for name in $SUBJECT demo demo-0001; do
	"$scand" archive "$name" --recordings recordings --models models -o "by/$name" --date 2026-01-31
	"$scand" verify "by/$name"
done
mv "by/$SUBJECT" package
diff -r package by/demo
diff -r package by/demo-0001
"$scand" export models --format glb --lod 1 -o exported
"$scand" export recordings/demo.mcap --dataset colmap --model models -o colmap
"$scand" publish models --recordings recordings --address https://museum.example/3d -o site
"$PYTHON" "$root/tests/interop/check_press.py" .
