#!/usr/bin/env bash
# Makes a release of this checkout: checks whether it can be released, runs the whole gate, commits the version and the
# date, builds the package from that commit and tries it on a clean Debian, and tags the commit. Nothing is pushed. Run
# as root on Debian 12, as `.ci/run` is.
#
#   scripts/release.sh 0.2.0
set -euo pipefail
cd "$(dirname "$0")/.."
cargo=${CARGO:-cargo}

refuse() {
	echo "release: $*" >&2
	exit 1
}

version=${1:-}
[[ $version =~ ^[0-9]+\.[0-9]+\.[0-9]+$ ]] || refuse "expected a version such as 0.2.0, found '$version'"
[ -z "$(git status --porcelain)" ] || refuse "commit or remove these first: $(git status --porcelain | head -n 3 | tr '\n' ' ')"
branch=$(git symbolic-ref --short HEAD 2>/dev/null) || refuse "no branch is checked out"
[ "$branch" = main ] || refuse "releases are made of main, and '$branch' is checked out"
! git rev-parse -q --verify "refs/tags/v$version" >/dev/null || refuse "there is a tag v$version already"
grep -qF "## [$version] – unreleased" CHANGELOG.md || refuse "CHANGELOG.md has no '## [$version] – unreleased'"
format=$(ls -d tests/golden/format-* | sort -V | tail -n 1)
echo "release: does this version write recordings of the format in $format? If not, stop and see CONTRIBUTING.md." >&2

# The version is set first, because the gate must test what is released.
sed -i "0,/^version = \".*\"/s//version = \"$version\"/" Cargo.toml
sed -i "s/^## \[$version\] – unreleased/## [$version] – $(date -u +%F)/" CHANGELOG.md
"$cargo" metadata --offline --format-version 1 >/dev/null
git add Cargo.toml Cargo.lock CHANGELOG.md
git commit -q -m "Release $version"
undo() { git reset -q --hard HEAD~1 && echo "release: the commit was taken back" >&2; }
trap undo ERR

.ci/run
make deb-test
[ -z "$(git status --porcelain)" ] || { undo && refuse "the gate left files behind"; }
trap - ERR

# The tag's message is this version's section of the changelog.
awk -v head="## [$version]" 'index($0, "## [") == 1 { on = index($0, head) == 1 } on' CHANGELOG.md |
	git tag -a "v$version" -F - --cleanup=verbatim
target/release/scand --version
sha256sum target/debian/scand{,-worker}_"$version"*.deb
echo "release: to publish it: git push origin main v$version" >&2
