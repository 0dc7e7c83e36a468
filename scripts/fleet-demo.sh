#!/usr/bin/env bash
# A fleet on this machine: Debian's nats-server, a simulated rig, and two workers that make the models of its captures. The
# rig takes twelve captures; when four models are there, one worker is killed. Then the recording is made again as an
# archive, by the worker that is left. No root: it runs in a network namespace of its own. What it makes lies in
# out/fleet-demo (OUT names another folder).
set -euo pipefail
cd "$(dirname "$0")/.."

if [ -z "${SCAND_IN_NAMESPACE:-}" ]; then
	SCAND_IN_NAMESPACE=1 exec unshare --user --map-root-user --net "scripts/$(basename "$0")" "$@"
fi
cameras=6
presses=12
ip link set lo up
for n in $(seq 1 $cameras); do ip address add "127.0.1.$n/8" dev lo 2>/dev/null || true; done

scand=$(realpath "${SCAND:-target/release/scand}")
out=${OUT:-$PWD/out/fleet-demo}
fleet=nats://127.0.0.1:4222
say() { echo "fleet-demo: $*"; }
if [ -e "$out" ]; then
	say "$out already exists; remove it first" >&2
	exit 1
fi
command -v nats-server >/dev/null || { say "install nats-server" >&2 && exit 1; }
mkdir -p "$out"
cd "$out"
started=()
finish() {
	[ ${#started[@]} -eq 0 ] || kill "${started[@]}" 2>/dev/null || true
	wait 2>/dev/null || true
	rm -f commands
}
trap finish EXIT
start() { # NAME COMMAND…: starts it; what it says goes to NAME.log
	local name=$1
	shift
	"$@" >"$name.log" 2>&1 &
	started+=($!)
}
until_true() { # WHAT COMMAND…: waits for a minute at most
	local what=$1
	shift
	for _ in $(seq 600); do
		if "$@"; then return; fi
		sleep 0.1
	done
	say "$what: not within a minute; see $out/*.log" >&2
	exit 1
}
made() { [ "$(find models -name model.glb 2>/dev/null | wc -l)" -ge "$1" ]; }

say "a rig of $cameras simulated cameras, its daemon, and the process that offers its captures"
"$scand" simulate --shape mug --cameras $cameras --size 320x240 --depth-cameras 0 --textured --out served.mcap 2>simulate.log
"$scand" info served.mcap --calibration calibration.toml >/dev/null
cat >rig.toml <<TOML
[rig]
name = "demonstration"
calibration = "calibration.toml"
[sync]
window_ms = 3000.0
[capture]
largest_skew_ms = 500.0
patience_ms = 4000
[recording]
folder = "recordings"
keep_free_mb = 200
[hull]
resolution = 120.0
[workers]
folder = "models"
fleet = "$fleet"
recheck = 0.25
[socket]
path = "scand.sock"
[verdict]
hull_is_wanted = true
[aravis.defaults]
trigger = "software"
transfer = "srgb"
packet_size = 9000
TOML
for n in $(seq 1 $cameras); do
	printf '[aravis.cameras.c%02d]\naddress = "127.0.1.%d"\n' $((n - 1)) "$n" >>rig.toml
done
mkfifo commands
"$scand" simulate --serve served.mcap --empty <commands >cameras.log 2>&1 &
started+=($!)
exec 3>commands
until_true "the cameras" grep -q serving cameras.log
start daemon "$scand" run --config rig.toml
for n in $(seq 1 $cameras); do until_true "the daemon" grep -q "camera c0$((n - 1)) is ready: " daemon.log; done
start fleet "$scand" fleet run --config rig.toml --name hall

say "a server and two workers"
start server nats-server --jetstream --addr 127.0.0.1 --port 4222 --store_dir "$out/store"
until_true "the server" grep -q "Server is ready" server.log
start first "$scand" worker --fleet "$fleet" --name first --scratch "$out/scratch"
first=${started[-1]}
start second "$scand" worker --fleet "$fleet" --name second --scratch "$out/scratch"

"$scand" background --socket scand.sock
echo captures >&3
"$scand" session start demo --socket scand.sock
for _ in $(seq $presses); do "$scand" trigger --socket scand.sock >/dev/null; done
say "$presses captures are on the disk"
until_true "four models" made 4
say "the first worker is killed"
kill -9 "$first"
until_true "all models" made $presses
"$scand" fleet status --fleet "$fleet"
"$scand" session close --socket scand.sock

say "the recording once more, as an archive"
"$scand" --replay recordings/demo.mcap --out again --fleet "$fleet" --name archive --quiet
say "$(find models again -name model.glb | wc -l) models lie in $out"
