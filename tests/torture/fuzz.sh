#!/usr/bin/env bash
# Runs each target of the fuzzer for a minute (times N) and keeps its log. Needs nightly Rust, cargo-fuzz and a C++
# compiler. What it finds lies in fuzz/artifacts; it goes to fuzz/found/TARGET, where `make test` looks from then on.
#
#   tests/torture/fuzz.sh [FOLDER FOR LOGS]
set -euo pipefail
cd "$(dirname "$0")/../.."
folder=${1:-target/torture}
mkdir -p "$folder"
# Our own code has no memory to corrupt: without the sanitizer, panics and hangs are found in half the time.
options=(--sanitizer none)
cargo +nightly fuzz build "${options[@]}" >"$folder/fuzz-build.log" 2>&1 || {
	tail -n 5 "$folder/fuzz-build.log" >&2
	exit 1
}
failed=0
for target in $(cargo +nightly fuzz list); do
	log=$folder/fuzz-$target.log
	mkdir -p "fuzz/corpus/$target" "fuzz/found/$target"
	if [ "$target" = recording ]; then
		cp -n tests/golden/format-*/*.mcap "fuzz/corpus/$target/"
	elif [ "$target" = configuration ]; then
		cp -n config/*.toml "fuzz/corpus/$target/"
	elif [ "$target" = calibration ]; then
		cp -n tests/golden/format-*/*.toml "fuzz/corpus/$target/"
	fi
	if cargo +nightly fuzz run "${options[@]}" "$target" "fuzz/corpus/$target" "fuzz/found/$target" -- \
		-max_total_time=$((60 * ${N:-1})) -timeout=20 -rss_limit_mb=3000 >"$log" 2>&1; then
		echo "         $target: $(sed -n 's/^Done \([0-9]*\) runs in \([0-9]*\).*/\1 inputs in \2 s/p' "$log")"
	else
		failed=1
		echo "         $target: $(grep -a -m 1 -E 'panicked|ERROR|SUMMARY' "$log") ($log)"
	fi
done
exit $failed
