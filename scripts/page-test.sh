#!/usr/bin/env bash
# The part of `make test` that tries the operator's page in a browser, with the program that the rig's tests were built
# with. Where npm or Chromium is missing it says so; SCAND_REQUIRE_ALL=1 makes that a failure.
set -euo pipefail
cd "$(dirname "$0")/.."

for program in npm chromium; do
	if ! command -v $program >/dev/null; then
		echo "skipped: the page in a browser: there is no $program (apt-get install $program)" >&2
		[ "${SCAND_REQUIRE_ALL:-}" != 1 ] || exit 1
		exit 0
	fi
done
exec make page-test SCAND=target/debug/scand
