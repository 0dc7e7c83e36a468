#!/usr/bin/env bash
# Installs both packages on a clean Debian 12 in a folder of its own, checks whether they run, and removes them again: the
# worker's alone first, then both beside each other. Run as root; needs mmdebstrap. The clean Debian is kept below target
# for the next time.
#
#   scripts/deb-test.sh target/debian/scand_0.1.0-1_amd64.deb target/debian/scand-worker_0.1.0-1_amd64.deb
set -euo pipefail
cd "$(dirname "$0")/.."

say() { echo "deb-test: $*" >&2; }
if [ "$(id -u)" -ne 0 ]; then
	say "it makes a Debian of its own: run it as root"
	exit 1
fi
package=$(realpath "${1:-$(ls -t target/debian/scand_*.deb | head -n 1)}")
worker=$(realpath "${2:-$(ls -t target/debian/scand-worker_*.deb | head -n 1)}")
mirror=${MIRROR:-http://deb.debian.org/debian}
base=target/debian/bookworm.tar
command -v mmdebstrap >/dev/null || apt-get install -y -qq --no-install-recommends mmdebstrap >/dev/null

if [ ! -e "$base" ]; then
	say "making a clean Debian 12"
	mmdebstrap --quiet --variant=minbase --include=systemd,udev --aptopt='Apt::Install-Recommends "false"' \
		bookworm "${base%.tar}.part.tar" "deb $mirror bookworm main"
	mv "${base%.tar}.part.tar" "$base"
fi
root=$(mktemp -d)
cleanup() {
	umount "$root/proc" 2>/dev/null || true
	rm -rf --one-file-system "$root"
}
trap cleanup EXIT
tar -xf "$base" -C "$root"
mount -t proc proc "$root/proc"
cp /etc/resolv.conf "$root/etc/resolv.conf"
cp "$package" "$root/tmp/scand.deb"
cp "$worker" "$root/tmp/scand-worker.deb"
cp recordings/cup.mcap "$root/tmp/cup.mcap"
inside() { chroot "$root" env DEBIAN_FRONTEND=noninteractive LC_ALL=C PATH=/usr/sbin:/usr/bin:/sbin:/bin "$@"; }
files() { (cd "$root" && find . -xdev -path ./proc -prune -o -print | grep -vE '^\./(tmp|var/(cache|log|lib/(apt|dpkg|systemd))|run|root)(/|$)' | sort); }

fail() {
	say "FAILED: $*"
	exit 1
}

depends() { dpkg-deb -f "$1" Depends | tr ',' '\n' | sed 's/(.*)//; s/|.*//'; }
accounts() { cat "$root/etc/passwd" "$root/etc/group"; }

say "the worker alone"
inside apt-get update -qq
# Dependencies are installed first, so that the comparisons at the end show only the packages.
inside apt-get install -y -qq --no-install-recommends $(depends "$worker") >/dev/null
before_worker=$(files)
accounts_before_worker=$(accounts)
inside apt-get install -y -qq --no-install-recommends /tmp/scand-worker.deb >/dev/null
inside scand-worker --version
libraries=$(inside ldd /usr/bin/scand-worker)
[[ $libraries != *"not found"* ]] || fail "the worker lacks libraries: $libraries"
! grep -qiE 'aravis|openni|v4l|glib' <<<"$libraries $(depends "$worker")" || fail "the worker has camera libraries: $libraries"
words=$(inside systemd-analyze verify scand-worker@a.service 2>&1) || fail "$words"
[ -z "$words" ] || fail "$words"
inside systemd-analyze security --offline=true --threshold=20 /lib/systemd/system/scand-worker@.service >/dev/null ||
	fail "scand-worker@.service is too open"
inside getent passwd scand-worker >/dev/null || fail "no user scand-worker"
[ -z "$(find "$root/etc/systemd/system" -name 'scand-*')" ] || fail "the worker is enabled"
[[ $(inside scand-worker fleet key /tmp/worker.key) == U* ]] || fail "no key was made"
inside scand-worker --replay /tmp/cup.mcap --out /tmp/of-worker --quiet || fail "the worker's replay"
code=0
words=$(inside scand-worker worker --fleet nats://rig:secret@127.0.0.1 2>&1) || code=$?
[ "$code" -ne 0 ] && [[ $words != *secret* ]] || fail "an address with a password: exit code $code: $words"
# What whoever runs it makes: a key, the server's address, a worker that starts at boot, and its files.
mkdir -p "$root/etc/scand-worker" "$root/var/cache/scand-worker/a"
touch "$root/etc/scand-worker/a.key" "$root/etc/default/scand-worker" "$root/var/cache/scand-worker/a/capture"
inside systemctl enable --quiet scand-worker@a
inside apt-get remove -y -qq scand-worker >/dev/null
[ -e "$root/etc/scand-worker/a.key" ] || fail "removing took the worker's key"
inside getent passwd scand-worker >/dev/null || fail "removing took the worker's user"
inside apt-get purge -y -qq scand-worker >/dev/null
left=$(diff <(echo "$before_worker") <(files) | grep '^[<>]' || true)
[ -z "$left" ] || fail "the worker left behind: $left"
[ "$accounts_before_worker" = "$(accounts)" ] || fail "the worker's user is left"

say "installing both"
inside apt-get install -y -qq --no-install-recommends $(depends "$package") >/dev/null
before=$(files)
users=$(accounts)
inside apt-get install -y -qq --no-install-recommends /tmp/scand-worker.deb >/dev/null
inside apt-get install -y -qq --no-install-recommends /tmp/scand.deb >/dev/null

dpkg-deb --info "$package" preinst >/dev/null || fail "the package has no preinst"

say "running"
inside scand --version
[ "$(inside ldd /usr/bin/scand | grep -c 'not found')" -eq 0 ] || fail "libraries are missing"
inside scand pedal --help >/dev/null
for file in man/man1/scand-replay.1.gz bash-completion/completions/scand; do
	[ -s "$root/usr/share/$file" ] || fail "/usr/share/$file is missing"
done
code=0
words=$(inside scand simulate --shape cup --out /tmp/a.mcap 2>&1) || code=$?
[ "$code" -eq 2 ] && [[ $words == *"no simulator"* ]] || fail "scand simulate: exit code $code, expected 2 and where the simulator is: $words"
inside scand --replay /tmp/cup.mcap --out /tmp/out --quiet || fail "the replay"
model=$(cd "$root/tmp/out" && find . -name model.glb | grep .) || fail "no model"
cmp "$root/tmp/out/$model" "$root/tmp/of-worker/$model" || fail "the worker made another model"
words=$(inside systemd-analyze verify scand.service scand.socket scand-page.service scand-fleet.service scand-pedal@event0.service 2>&1) || fail "$words"
[ -z "$words" ] || fail "$words"
for unit in scand.service scand-page.service scand-fleet.service scand-pedal@.service; do
	inside systemd-analyze security --offline=true --threshold=20 "/lib/systemd/system/$unit" >/dev/null ||
		fail "$unit is too open"
done
inside getent passwd scand >/dev/null || fail "no user scand"
inside id -nG scand-page | grep -qw scand || fail "the page's user is not in the group scand"
[ -z "$(find "$root/etc/systemd/system" -name 'scand-page*')" ] || fail "the page is enabled"
[ -z "$(find "$root/etc/systemd/system" -name 'scand-fleet*' -o -name 'scand-worker*')" ] || fail "the fleet is enabled"
mkdir -p "$root/tmp/page"
printf 'listen = "127.0.0.1:18437"\nstate = "state"\ncontrol = "control"\n' >"$root/tmp/page/page.toml"
words=$(inside sh -c 'cd /tmp/page; scand page --config page.toml 2>log & page=$!
	for n in $(seq 100); do [ -S control ] && break; sleep 0.1; done
	scand page pair --config page.toml; kill $page' 2>&1) || true
[[ $words == *'/#pair='* ]] || fail "the page gives no link: $words $(cat "$root/tmp/page/log")"
[ -L "$root/etc/systemd/system/sockets.target.wants/scand.socket" ] || fail "the socket is not enabled"
[ "$(inside stat -c '%U:%G %a' /var/lib/scand/recordings)" = "scand:scand 750" ] || fail "the recordings' folder"
code=0
inside scand check --config /usr/share/doc/scand/examples/rig.toml >/dev/null 2>&1 || code=$?
[ "$code" -eq 78 ] || fail "check: exit code $code, expected 78 (no calibration)"

say "removing"
cp recordings/cup.mcap "$root/var/lib/scand/recordings/kept.mcap"
# Recordings of a rig whose configuration names another folder.
mkdir -p "$root/var/lib/scand/hall" && cp recordings/cup.mcap "$root/var/lib/scand/hall/kept.mcap"
ln -s /etc/passwd "$root/var/lib/scand/recordings/link"
mkdir -p "$root/etc/scand" && echo "# mine" >"$root/etc/scand/rig.toml"
mkdir -p "$root/var/lib/scand/models" && touch "$root/var/lib/scand/models/a"
inside apt-get purge -y -qq scand-worker >/dev/null
inside scand --version >/dev/null || fail "purging the worker took the rig's program"
inside apt-get remove -y -qq scand >/dev/null
[ -e "$root/etc/scand/rig.toml" ] || fail "removing took the configuration"
inside apt-get purge -y -qq scand >/dev/null
expected=$(printf '> ./var/lib/scand%s\n' "" /hall /hall/kept.mcap /recordings /recordings/kept.mcap /recordings/link)
expect_recordings_alone() {
	left=$(diff <(echo "$before") <(files) | grep '^[<>]' || true)
	[ "$left" = "$expected" ] || fail "left behind: $left"
	[ "$users" = "$(accounts)" ] || fail "users are left"
}
expect_recordings_alone
for folder in recordings hall; do
	cmp recordings/cup.mcap "$root/var/lib/scand/$folder/kept.mcap" || fail "the recording in $folder"
done

say "installing again after the purge"
inside apt-get install -y -qq --no-install-recommends /tmp/scand.deb >/dev/null
others=$(inside find /var/lib/scand ! -user scand -o ! -group scand)
[ -z "$others" ] || fail "not the daemon's: $others"
[ "$(inside stat -c '%U:%G' /etc/passwd)" = root:root ] || fail "what a link leads to has another owner"
inside apt-get purge -y -qq scand >/dev/null
expect_recordings_alone
say "ok: both packages were installed, ran, and left nothing but recordings"
