#!/usr/bin/env bash
# Builds the test sensor and lays out a folder where Debian's libOpenNI2 finds it without root: a link to the library
# and the drivers beside it. A process takes it when LD_LIBRARY_PATH names the folder as it starts. Prints the folder.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
target=${1:-$here/../../target/openni2-sensor}
"${CARGO:-cargo}" build --quiet --locked --manifest-path "$here/Cargo.toml" --target-dir "$target" >&2
debian=
for folder in /usr/lib/*-linux-gnu; do
	[ ! -e "$folder/libOpenNI2.so.0" ] || debian=$folder
done
if [ -z "$debian" ]; then
	echo "libOpenNI2.so.0 is missing: apt-get install libopenni2-0" >&2
	exit 1
fi
stage=$target/stage
mkdir -p "$stage/OpenNI2/Drivers"
ln -sfn "$debian/libOpenNI2.so.0" "$stage/libOpenNI2.so.0"
ln -sfn "$debian/OpenNI2/Drivers/libOniFile.so.0" "$stage/OpenNI2/Drivers/libOniFile.so.0"
ln -sfn "$(realpath "$target")/debug/libopenni2_sensor.so" "$stage/OpenNI2/Drivers/libScandSensor.so.0"
realpath "$stage"
