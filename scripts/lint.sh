#!/usr/bin/env bash
# `make lint`: what needs neither root nor an installed camera library, nor runs the program. Format, spelling, clippy
# over each combination of features, licences and documentation. A combination whose system library is missing is named
# as skipped; SCAND_REQUIRE_ALL=1 makes that a failure.
set -euo pipefail
cd "$(dirname "$0")/.."
cargo=${CARGO:-cargo}
typos_version=1.52.0
deny_version=0.20.2

part() { scripts/part.sh "$@"; }

# Says what is not checked, and what is missing for it.
skip() {
	echo "skipped: $1: $2" >&2
	[ "${SCAND_REQUIRE_ALL:-}" != 1 ] || { echo "lint: SCAND_REQUIRE_ALL=1 allows no skip" >&2 && exit 1; }
}

has_aravis() { pkg-config --exists 'aravis-0.8 >= 0.8.25' 2>/dev/null; }

# The bindings of V4L2 are made with libclang, which may be in a folder named after its version.
has_libclang() {
	[ -n "${LIBCLANG_PATH:-}" ] || ldconfig -p 2>/dev/null | grep -q 'libclang[-.]' || compgen -G '/usr/lib/llvm*/lib/libclang*.so*' >/dev/null
}

# Clippy of the package with these features, and of the other packages that cargo's options name. Its tests are checked,
# too: what they depend on gives libraries other features, and with those scand-core would be checked again.
lint() {
	local features=$1
	shift
	part "clippy, $features" "$cargo" clippy --locked --package scand "$@" --all-targets --features "$features" -- -D warnings
}

# Clippy of the package alone, without the laboratory, with these features: what an installed program is.
lint_installed() {
	part "clippy, installed${1:+ with $1}" "$cargo" clippy --locked --package scand --all-targets --no-default-features ${1:+--features "$1"} -- -D warnings
}

# rustfmt leaves comments as they are.
narrow_comments() {
	local wide
	wide=$(find src tests benches fuzz build.rs crates -name '*.rs' -not -path '*/target/*' -exec grep -Hn '^ *//' {} + 2>/dev/null |
		LC_ALL=C.UTF-8 sed -nE '/^[^:]*:[0-9]*:.{121}/p' || true)
	[ -z "$wide" ] || { printf 'lint: comments are wrapped at 120 columns:\n%s\n' "$wide" >&2 && return 1; }
}

# The package typos on PyPI has the program; installing it takes two seconds.
spelling() {
	local folder=target/tools/typos
	local typos=$folder/bin/typos
	if [ "$($typos --version 2>/dev/null)" != "typos-cli $typos_version" ]; then
		if ! { python3 -m venv $folder && $folder/bin/pip install -q --disable-pip-version-check "typos==$typos_version"; }; then
			skip "spelling" "python3-venv and PyPI give typos $typos_version"
			return
		fi
	fi
	part "spelling" $typos
}

# Licences, bans and sources, by deny.toml. cargo-deny runs for a second: a short build is worth more than a fast program.
licences() {
	local folder=target/tools
	if ! $folder/bin/cargo-deny --version 2>/dev/null | grep -qwF "$deny_version"; then
		part "cargo-deny, built once" env CARGO_PROFILE_RELEASE_OPT_LEVEL=0 CARGO_PROFILE_RELEASE_LTO=off \
			"$cargo" install cargo-deny --version "$deny_version" --locked --root $folder --target-dir $folder/build --quiet
		rm -rf $folder/build
	fi
	part "licences" $folder/bin/cargo-deny --log-level error --locked check licenses bans sources
}

part "format" "$cargo" fmt --all -- --check
narrow_comments
spelling
licences

# Those that need the same libraries with the same features stand together: they are checked once.
part "clippy, default" "$cargo" clippy --locked --workspace --all-targets -- -D warnings
lint live
lint openni2
lint_installed ""
if has_libclang; then
	lint v4l2
else
	skip "clippy, v4l2" "there is no libclang (libclang-dev)"
fi
lint page
lint fleet
# Cargo.toml says `test = false` of them, so that --all-targets leaves them out.
part "clippy, tests of the fleet" "$cargo" clippy --locked --package scand --features fleet --test fleet -- -D warnings
lint_installed fleet
documented=live
if has_aravis; then
	lint aravis,pedal
else
	lint pedal
	skip "clippy, aravis" "pkg-config finds no aravis-0.8 (libaravis-dev)"
fi
if has_aravis && has_libclang; then
	lint rig,page,fleet --package scand-lab
	lint_installed rig,page,fleet
	documented=rig,page,fleet
else
	skip "clippy, rig" "it wants aravis and libclang"
fi
part "documentation" env RUSTDOCFLAGS="-D warnings" "$cargo" doc --locked --workspace --no-deps --features "$documented"
