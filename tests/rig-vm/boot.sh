#!/usr/bin/env bash
# Boots the guest that image.sh made into FOLDER, with the packages and the test program of the workers in it, and tells what
# was found there. SCAND is a program with the simulator, which the package's has not: it makes recordings here, and plays
# them in the guest. All chapters are done by two guests side by side, for most of them keep one processor busy; those that are named, by one.
#
#   tests/rig-vm/boot.sh FOLDER PACKAGE WORKER-PACKAGE SCAND WORKERS [CHAPTER...]
set -euo pipefail
cd "$(dirname "$0")/../.."
folder=$1 package=$2 worker=$3 scand=$4 workers=$5
shift 5
say() { echo "rig-vm: $*" >&2; }

# What is tested, and what tests it, are laid over the guest's root.
over=$folder/over
rm -rf "$over"
mkdir -p "$over/rig-vm" "$over/etc/systemd/system/multi-user.target.wants"
cp tests/rig-vm/guest/*.py "$over/rig-vm/"
cp "$package" "$over/rig-vm/scand.deb"
[ -z "$worker" ] || cp "$worker" "$over/rig-vm/scand-worker.deb"
sensor=$(tests/openni2-sensor/stage.sh)
cp -L "$sensor/OpenNI2/Drivers/libScandSensor.so.0" "$over/rig-vm/"
cp "$workers" "$over/rig-vm/workers"
cp "$scand" "$over/rig-vm/scand"
strip --strip-debug "$over/rig-vm/workers" "$over/rig-vm/scand"
# Recordings whose pictures cameras can play as they are: of a whole rig, and of cameras that give JPEG.
simulated() {
	if [ ! -e "$folder/$1" ]; then
		rm -f "$folder/part.mcap"
		"$scand" simulate --shape cup --size 640x480 --out "$folder/part.mcap" "${@:2}" >/dev/null
		mv "$folder/part.mcap" "$folder/$1"
	fi
	cp "$folder/$1" "$over/rig-vm/"
}
simulated rig.mcap --encoding bayer
simulated jpeg.mcap --encoding jpeg --cameras 3 --depth-cameras 0
cp tests/rig-vm/guest/rig-vm.service "$over/etc/systemd/system/"
ln -s ../rig-vm.service "$over/etc/systemd/system/multi-user.target.wants/"
chmod -R go+rX "$over"
{
	cat "$folder/base.cpio"
	(cd "$over" && find . | cpio --quiet -R 0:0 -o -H newc)
} >"$folder/all.cpio"
trap 'rm -rf "$folder/all.cpio" "$over"' EXIT

# A guest does these chapters. Its lines are told as they come, and kept in FOLDER/log-NAME.
#
# Emulated, copying by the processor's own instruction (erms) is slower than by any other way.
# On a machine that is busy the kernel would find its timer broken and give up: it is not to look (no_timer_check).
# A microvm has no disk, no screen, no network; its end is a reset. KVM is not asked for: where it half works it hangs.
# Once its time is over, the guest tells what it was at; it is ended from here if it does not.
seconds=${RIG_VM_TIMEOUT:-2400}
guest() {
	local name=$1 chapters=$2
	local log=$folder/log-$name journal=$folder/journal-$name.txt
	timeout $((seconds + 300)) qemu-system-x86_64 -M microvm,isa-serial=on,acpi=off \
		-accel tcg,thread=multi -cpu max,-erms,-fsrm -smp 2 -m 4G -nodefaults -no-user-config -display none -serial stdio -no-reboot \
		-kernel "$folder/vmlinuz" -initrd "$folder/all.cpio" \
		-append "console=ttyS0 panic=-1 reboot=t quiet loglevel=3 systemd.show_status=0 mitigations=off no_timer_check rig-vm.seconds=$seconds rig-vm.chapters=$chapters" </dev/null |
		sed -u 's/\r$//' | tee "$log" | sed -u '/^-----BEGIN/,/^-----END/d; /^Rebooting/d; /^\[.*reboot:/d' || true
	if grep -q '^-----BEGIN' "$log"; then
		sed -n '/^-----BEGIN/,/^-----END/p' "$log" | grep -v '^-----' | base64 -d | gzip -d >"$journal"
		say "the guest's journal is in $journal"
	fi
	if ! grep -q '^rig-vm: ' "$log"; then
		say "the guest $name ended before its chapters $chapters; its last words: $(tail -n 1 "$log")"
	fi
	grep -q '^rig-vm: passed' "$log"
}
# Those with many cameras, or a model.
heavy="video mixed"
# This one needs the worker's package, too, and is done where it is named.
named="fleet"
rm -f "$folder"/log* "$folder"/journal*
failed=0
if [ $# -ne 0 ]; then
	guest a "$(tr ' ' ',' <<<"$*")" || failed=1
else
	light=$(sed -n 's/^chapter = Chapter("\([a-z]*\)".*/\1/p' tests/rig-vm/guest/*.py | grep -vxF "${heavy// /$'\n'}"$'\n'"$named" | paste -sd,)
	guest a "$light" &
	first=$!
	# Each has up to 4 GB; where there is not so much, one after the other.
	if [ "$(sed -n 's/^MemAvailable: *\([0-9]*\).*/\1/p' /proc/meminfo)" -lt 9000000 ]; then
		wait "$first" || failed=1
		first=""
	fi
	guest b "${heavy// /,}" || failed=1
	[ -z "$first" ] || wait "$first" || failed=1
fi
if [ "$failed" -ne 0 ]; then
	say "FAILED"
	exit 1
fi
