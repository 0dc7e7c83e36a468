#!/usr/bin/env bash
# Builds the Debian package into target/debian, with cargo-deb, which is installed below target if it is missing. The
# program links Debian's libraries, so build it on the Debian on which it will run. The program in the package has no
# simulator; it replaces the one in target/release (or target/debug). PROFILE=dev packs an unoptimised program into the
# folder OUTPUT. The operator's page is built with npm.
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
features=(--no-default-features --features rig,page,fleet)
scripts/ui.sh
"$cargo" build --profile "$profile" --locked --package scand "${features[@]}"
# Man pages and completions, from the definition of the command line.
program=target/${profile/#dev/debug}/scand
generated=target/generated
rm -rf $generated && mkdir -p $generated/bash $generated/zsh $generated/fish
"$program" generate man $generated/man
"$program" generate completions bash >$generated/bash/scand
"$program" generate completions zsh >$generated/zsh/_scand
"$program" generate completions fish >$generated/fish/scand.fish
# The same input makes the same package.
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || echo 0)}
export SOURCE_DATE_EPOCH
"$tools/bin/cargo-deb" --no-build --locked "${features[@]}" --profile "$profile" --output "$output"
ls -l "$output"/*.deb
