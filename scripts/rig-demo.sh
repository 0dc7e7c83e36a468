#!/usr/bin/env bash
# A rig without hardware: eleven GigE Vision cameras and a depth camera play a recording to the daemon, which takes the
# backgrounds of the empty rig and one capture and makes a model of it; a replay of the recording makes another. No root: it
# runs in a network namespace of its own. What it makes lies in out/rig-demo (OUT names another folder). With PRESSES=N it
# takes N captures, one after the other, and prints how long each took from the command to the disk; only the first
# becomes a model, by the replay. UNTIL=captured or UNTIL=done times them up to there; with done all become models.
# ABOUT=KEY=VALUE is a fact about the session, SUBJECT the object's number.
set -euo pipefail
cd "$(dirname "$0")/.."

if [ -z "${SCAND_IN_NAMESPACE:-}" ]; then
	SCAND_IN_NAMESPACE=1 exec unshare --user --map-root-user --net "scripts/$(basename "$0")" "$@"
fi
ip link set lo up
for n in $(seq 1 11); do ip address add "127.0.1.$n/8" dev lo 2>/dev/null || true; done

# Absolute, for the folder changes below.
scand=$(realpath -m "${SCAND:-target/release/scand}")
recording=$(realpath -m "${1:-recordings/cup.mcap}")
out=$(realpath -m "${OUT:-out/rig-demo}")
if [ -e "$out" ]; then
	echo "rig-demo: $out already exists; remove it first" >&2
	exit 1
fi
mkdir -p "$out"
presses=${PRESSES:-1}
until=${UNTIL:-durable}
subject=${SUBJECT:-demo}
models=0
if [ "$presses" -eq 1 ] || [ "$until" = done ]; then models=1; fi
libraries=$(tests/openni2-sensor/stage.sh)

cp config/loopback.toml "$out/rig.toml"
"$scand" info "$recording" --calibration "$out/calibration.toml" >/dev/null
cd "$out"

# The cameras. Their commands go through a pipe that stays open.
mkfifo commands
"$scand" simulate --serve "$recording" --empty --sensor-frames frames <commands >cameras.log 2>&1 &
cameras=$!
exec 3>commands
daemon=
finish() {
	[ -z "$daemon" ] || kill "$daemon" 2>/dev/null || true
	kill "$cameras" 2>/dev/null || true
	wait 2>/dev/null || true
	rm -f commands
}
trap finish EXIT
until_said() {
	for _ in $(seq 300); do
		grep -q "$1" "$2" 2>/dev/null && return
		sleep 0.1
	done
	echo "rig-demo: $2 does not say $1:" >&2
	cat "$2" >&2
	exit 1
}
until_said serving cameras.log

LD_LIBRARY_PATH=$libraries SCAND_OPENNI2_FRAMES=$out/frames "$scand" run --config rig.toml --set workers.count=$models 2>daemon.log &
daemon=$!
until_said listening daemon.log
for camera in $(cut -d' ' -f1 <cameras.log | grep '^c') kinect; do until_said "camera $camera is ready: " daemon.log; done

"$scand" background --socket scand.sock
echo captures >&3
"$scand" session start demo --about "${ABOUT:-project=demonstration}" --socket scand.sock
if [ "$presses" -eq 1 ]; then
	"$scand" trigger --socket scand.sock --subject "$subject" --until done
else
	"$scand" trigger --socket scand.sock --subject "$subject"
	begin=$EPOCHREALTIME
	for _ in $(seq 2 "$presses"); do
		pressed=$EPOCHREALTIME
		"$scand" trigger --socket scand.sock --until "$until" >/dev/null
		echo "$(((${EPOCHREALTIME/./} - ${pressed/./}) / 1000))"
	done | sort -n >latencies
	took=$(((${EPOCHREALTIME/./} - ${begin/./}) / 1000))
	awk -v took="$took" -v until="$until" '{ ms[NR] = $1 } END {
		p99 = int(NR * 0.99 + 0.999)
		printf "%d captures: trigger to %s p50 %d ms, p99 %d ms; %.2f captures a second\n", \
			NR, until, ms[int((NR + 1) / 2)], ms[p99], NR * 1000 / took
	}' latencies
fi
"$scand" status --socket scand.sock
"$scand" session close --socket scand.sock
kill -TERM "$daemon"
wait "$daemon"
daemon=
"$scand" --replay recordings/demo.mcap --capture demo-0001 --out replayed
