#!/usr/bin/env bash
# A rig in a guest: boots a Debian 12 with our package under plain qemu, where the kernel plays cameras and foot
# switches, and checks whether everything works together. Prints one line for each check. If one fails, the guest's
# journal is kept beside the log. Run as root, to install packages and to make the guest's Debian; needs no KVM, no
# mount and no device.
#
# PROFILE=dev uses the programs that are built for the tests, which takes less time than those of a release.
#
#   tests/rig-vm/run.sh [CHAPTER...]
set -euo pipefail
cd "$(dirname "$0")/../.."
cargo=${CARGO:-cargo}
profile=${PROFILE:-release}
folder=$PWD/target/rig-vm

say() { echo "rig-vm: $*" >&2; }
if [ "$(id -u)" -ne 0 ]; then
	say "it makes a Debian of its own: run it as root"
	exit 1
fi
for chapter in "$@"; do
	if ! grep -qs '^chapter = ' "tests/rig-vm/guest/$chapter.py"; then
		say "no chapter $chapter, but$(grep -l '^chapter = ' tests/rig-vm/guest/*.py | sed 's#.*/# #; s#\.py$##' | tr -d '\n')"
		exit 1
	fi
done
mkdir -p "$folder"
# Installs what is not there yet.
missing=()
for name in cpio gcc libelf1 make mmdebstrap qemu-system-x86; do
	dpkg-query -W -f '${Status}' "$name" 2>/dev/null | grep -q 'ok installed' || missing+=("$name")
done
if [ ${#missing[@]} -ne 0 ]; then
	say "installing ${missing[*]}"
	apt-get -o Acquire::Retries=5 update -qq
	DEBIAN_FRONTEND=noninteractive apt-get -o Acquire::Retries=5 install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
fi

# The test of the workers' confinement, to be run in the daemon's own; the program that was built beside it, which has the
# simulator; and the packages, whose programs have none.
say "building ($profile)"
output=$folder/debian
[ "$profile" = dev ] || output=target/debian
workers=$("$cargo" test --profile "${profile/dev/test}" --locked --features rig,page --test workers --no-run --message-format=json 2>"$folder/build.log" |
	sed -n 's#.*"executable":"\([^"]*/workers-[^"]*\)".*#\1#p') || {
	tail -n 20 "$folder/build.log" >&2
	exit 1
}
mkdir -p "$folder/lab"
cp "target/${profile/dev/debug}/scand" "$folder/lab/scand"
# The worker's is of one chapter's need, which has to be asked for.
packages=scand
[[ " $* " != *" fleet "* ]] || packages="scand scand-worker"
PROFILE=$profile OUTPUT=$output/ PACKAGES=$packages scripts/deb.sh >/dev/null
package=$(ls -t "$output"/scand_*.deb | head -n 1)
worker=
[ "$packages" = scand ] || worker=$(ls -t "$output"/scand-worker_*.deb | head -n 1)
tests/rig-vm/image.sh "$folder" "$package"
tests/rig-vm/boot.sh "$folder" "$package" "$worker" "$folder/lab/scand" "$workers" "$@"
