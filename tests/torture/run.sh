#!/usr/bin/env bash
# Faults: tests the promises of docs/promises.md with larger counts than `make test`. Prints one line for each promise:
# its result, how long the test took, and its figures. The exit code is 1 if a promise was broken; the script then names
# the log and the other files of its test.
#
# N=60 takes 60 times as many of each, which is hours. Root and a loop device are needed to cut the power of a disk.
#
#   tests/torture/run.sh [CHAPTER...]      power kill disk damage presses cameras workers upgrades soak fuzz
set -euo pipefail
cd "$(dirname "$0")/../.."
cargo=${CARGO:-cargo}
folder=$PWD/target/torture
export SCAND_TORTURE=${N:-1}

# Chapter, what is promised, the test program ("lib" is the rig's own tests, "core" those of crates/core), and the tests' names.
promises() {
	cat <<-'END'
		power|a power cut loses no durable capture|lib|daemon::disaster_tests::power_cuts
		kill|a killed daemon loses nothing that a client was told|lib|daemon::disaster_tests::kills daemon::service_tests::a_kill_between
		kill|a killed rig of twelve cameras loses no durable capture|rig|what_was_acknowledged_survives
		kill|a killed replay leaves whole models or none|offline|disasters::long::a_replay_that_is_killed
		kill|a killed fusion leaves a whole model or none|offline|disasters::long::a_fusion_that_is_killed
		kill|killed workers, or their daemon, lose no job|workers|a_killed_daemon a_killed_worker
		kill|recovery is fast|offline|disasters::a_recording_that_was_cut_off
		disk|a call that the disk refuses is never acknowledged falsely|lib|daemon::disaster_tests::a_disk
		disk|a replay whose disk refuses leaves no half output|offline|disasters::long::a_replay_whose_disk
		disk|a full disk fails one capture, a slow one disturbs no camera|rig|a_full_disk a_slow_disk
		damage|damaged and hostile recordings: an error, bounded, no panic|offline|hostile::
		damage|recordings cut, flipped and recovered at every byte|core|recording::
		damage|damaged inputs of every parser: no panic|offline|fuzzing::
		presses|every press has one final answer and at most one capture|lib|daemon::service_tests::a_thousand_presses daemon::service_tests::told_to_end
		presses|storms and nonsense harm neither capture, memory nor log|lib|daemon::hostile_tests::
		cameras|cameras that fail are named and come back|rig|cameras_that_fail a_late_frame
		cameras|lost, repeated, reordered and damaged packets make no wrong picture|rig|a_network_that
		cameras|a wall clock that steps by an hour moves no timestamp|lib|daemon::disaster_tests::a_wall_clock
		cameras|cameras that come and go leave nothing behind|gige|faults::
		cameras|a camera that is unplugged is named and comes back each time|lib|drivers::live::supervisor_tests::an_unplugged
		workers|crashes, hangs and memory fail one job alone|lib|workers::tests::
		workers|a panic in any stage fails one capture alone|offline|hostile::tiny::a_panic
		workers|real workers: memory beyond the limit, confinement|workers|one_that_
		upgrades|files of released versions are read, later ones refused|offline|golden::
		soak|memory, files, threads and latency stay flat|rig|soak
	END
}

wanted=" ${*:-power kill disk damage presses cameras workers upgrades soak} "
mkdir -p "$folder"
rm -f "$folder"/*.log
echo "torture: building" >&2
programs=$("$cargo" test --locked --features rig,page --no-run --message-format=json 2>"$folder/build.log" |
	sed -n 's#.*"kind":\["\([a-z]*\)"\].*"name":"\([^"]*\)","src_path".*"executable":"\([^"]*\)".*#\1 \2 \3#p') || {
	tail -n 20 "$folder/build.log" >&2
	exit 1
}

# The program of a name.
program() {
	local kind="test $1"
	[ "$1" != lib ] || kind="lib scand"
	[ "$1" != core ] || kind="lib scand_core"
	sed -n "s#^$kind ##p" <<<"$programs"
}

# The names, after that of a program, that no name of its tests contains: such a test was renamed or moved.
unknown() {
	local all name
	all=$("$1" --list 2>/dev/null | sed -n 's/: test$//p')
	for name in "${@:2}"; do grep -qF -- "$name" <<<"$all" || echo "$name"; done
}

kept=0 broken=0 unseen=0 number=0
# Says what became of a promise: outcome, seconds, words.
tell() { printf '%-6s %-9s %4s s  %s\n' "$1" "$chapter" "$2" "$3"; }

while IFS='|' read -r chapter promise target tests; do
	[[ $wanted == *" $chapter "* ]] || continue
	number=$((number + 1))
	log=$folder/$chapter-$number.log
	begin=$SECONDS
	program=$(program "$target")
	# shellcheck disable=SC2086 # several tests
	missing=$(unknown "$program" $tests | paste -sd ' ')
	if [ -n "$missing" ]; then
		broken=$((broken + 1))
		tell BROKEN 0 "$promise: no test of $target is called so: $missing"
		continue
	fi
	# shellcheck disable=SC2086 # several tests
	timeout $((900 * SCAND_TORTURE)) "$program" --nocapture --test-threads=1 $tests >"$log" 2>&1 </dev/null && ended=0 || ended=$?
	took=$((SECONDS - begin))
	passed=$(sed -n 's/^test result: ok\. \([0-9]*\) passed.*/\1/p' "$log" | awk '{ all += $1 } END { print all + 0 }')
	if [ "$ended" -ne 0 ] || [ "$passed" -eq 0 ]; then
		broken=$((broken + 1))
		tell BROKEN "$took" "$promise: $log"
		grep -m 3 -a "panicked at" -A 3 "$log" | sed 's/^/         /' || true
	elif skipped=$(grep -a -m 1 -o "skipped[,:].*" "$log"); then
		unseen=$((unseen + 1))
		tell unseen "$took" "$promise: $skipped"
	else
		kept=$((kept + 1))
		tell kept "$took" "$promise ($passed tests)"
		sed -n 's/^.*shown: /         /p' "$log"
	fi
done < <(promises)

if [[ $wanted == *" fuzz "* ]]; then
	chapter=fuzz begin=$SECONDS
	if tests/torture/fuzz.sh "$folder"; then
		kept=$((kept + 1))
		tell kept $((SECONDS - begin)) "the fuzzer found nothing"
	else
		broken=$((broken + 1))
		tell BROKEN $((SECONDS - begin)) "the fuzzer found something, or cannot run: $folder"
	fi
fi
echo "$kept promises kept, $broken broken, $unseen not to be seen on this machine"
[ "$broken" -eq 0 ]
