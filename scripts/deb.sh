#!/usr/bin/env bash
# Builds two Debian packages into target/debian, with cargo-deb, which is installed below target if it is missing: `scand`
# for a rig, and `scand-worker` for a machine that makes models for others, without camera libraries. The programs link
# Debian's libraries, so build them on the Debian on which they will run. They have no simulator; the rig's replaces the
# one in target/release (or target/debug). PROFILE=dev packs unoptimised programs into the folder OUTPUT. PACKAGES=scand
# makes the first alone. The operator's page is built with npm.
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
packages=${PACKAGES:-scand scand-worker}
program=target/${profile/#dev/debug}/scand
generated=target/generated
rm -rf $generated && mkdir -p $generated/bash $generated/zsh $generated/fish $generated/worker
optimised=()
# What travels to workers is packed: in a package, zstd's speed is worth the time that it takes to compile.
[ "$profile" = dev ] || optimised=(--config "profile.$profile.package.zstd-sys.opt-level=3")
build() { "$cargo" build --profile "$profile" "${optimised[@]}" --locked --package scand "${features[@]}"; }

if [[ " $packages " == *" scand-worker "* ]]; then
	features=(--no-default-features --features fleet)
	build
	# cargo-deb strips what cargo has just built; this is a copy.
	strip -o $generated/worker/scand-worker "$program"
fi
features=(--no-default-features --features rig,page,fleet)
scripts/ui.sh
build
# Man pages and completions, from the definition of the command line.
"$program" generate man $generated/man
# Both packages can be installed at once, so each file is in one of them.
mv $generated/man/scand-worker.1 $generated/worker/
"$program" generate completions bash >$generated/bash/scand
"$program" generate completions zsh >$generated/zsh/_scand
"$program" generate completions fish >$generated/fish/scand.fish
# The same input makes the same package.
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || echo 0)}
export SOURCE_DATE_EPOCH
pack() { "$tools/bin/cargo-deb" --no-build --locked "${features[@]}" --profile "$profile" --output "$output" "$@"; }
pack
if [[ " $packages " == *" scand-worker "* ]]; then
	pack --variant worker
fi
ls -l "$output"/*.deb
