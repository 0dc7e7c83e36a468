#!/usr/bin/env bash
# A fleet on this machine: Debian's nats-server, two workers, and a recording whose captures they make into models. A third
# of the way one worker is killed. What it makes lies in out/fleet-demo (OUT names another folder). Needs no root.
set -euo pipefail
cd "$(dirname "$0")/.."

scand=$PWD/${SCAND:-target/release/scand}
out=${OUT:-$PWD/out/fleet-demo}
port=${PORT:-14222}
if [ -e "$out" ]; then
	echo "fleet-demo: $out already exists; remove it first" >&2
	exit 1
fi
command -v nats-server >/dev/null || { echo "fleet-demo: install nats-server" >&2 && exit 1; }
mkdir -p "$out"
started=()
finish() {
	[ ${#started[@]} -eq 0 ] || kill "${started[@]}" 2>/dev/null || true
	wait 2>/dev/null || true
}
trap finish EXIT

nats-server --jetstream --addr 127.0.0.1 --port "$port" --store_dir "$out/store" >"$out/server.log" 2>&1 &
started+=($!)
for _ in $(seq 100); do
	(exec 3<>"/dev/tcp/127.0.0.1/$port") 2>/dev/null && break
	sleep 0.1
done
for name in first second; do
	"$scand" worker --fleet "nats://127.0.0.1:$port" --name $name --scratch "$out/scratch" >"$out/$name.log" 2>&1 &
	started+=($!)
done
first=${started[1]}
"$scand" simulate --shape cup --cameras 5 --size 320x240 --captures 12 --masks --depth-frames 10 --out "$out/cups.mcap"
(
	until [ "$(find "$out/models" -name '.*.fleet' 2>/dev/null | wc -l)" -ge 4 ]; do sleep 0.2; done
	echo "fleet-demo: the first worker is killed"
	kill -9 "$first"
) &
"$scand" --replay "$out/cups.mcap" --out "$out/models" --fleet "nats://127.0.0.1:$port" --name demo
"$scand" fleet status --fleet "nats://127.0.0.1:$port"
