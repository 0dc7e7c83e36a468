#!/usr/bin/env bash
# Builds the Debian package into target/debian, with cargo-deb, which is installed below target if it is not there. The
# program links Debian's libraries, so that it is to be built on the Debian that it is to run on. PROFILE=dev packs, into
# the folder OUTPUT, what was built for the tests.
set -euo pipefail
cd "$(dirname "$0")/.."

version=3.8.0
cargo=${CARGO:-cargo}
tools=target/tools
profile=${PROFILE:-release}
output=${OUTPUT:-target/debian/}
if ! "$tools/bin/cargo-deb" --version 2>/dev/null | grep -qwF "$version"; then
	# It runs for seconds: a short build is worth more than a fast program.
	CARGO_PROFILE_RELEASE_OPT_LEVEL=1 CARGO_PROFILE_RELEASE_LTO=off "$cargo" install cargo-deb --version "$version" --locked --root "$tools" --target-dir "$tools/build" --quiet
	rm -rf "$tools/build"
fi
if [ "$profile" = release ]; then
	"$cargo" build --release --locked --features rig
fi
# The same input makes the same package.
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || echo 0)}
export SOURCE_DATE_EPOCH
"$tools/bin/cargo-deb" --no-build --locked --features rig --profile "$profile" --output "$output"
ls -l "$output"/*.deb
