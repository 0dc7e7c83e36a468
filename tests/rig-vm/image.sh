#!/usr/bin/env bash
# Makes the guest's root and kernel, of Debian's packages alone: FOLDER/base.cpio, which has a whole Debian 12 with what
# the package of scand depends on, and FOLDER/vmlinuz. What is there of the same making is kept. Run as root.
#
#   tests/rig-vm/image.sh FOLDER PACKAGE.deb
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
folder=$(mkdir -p "$1" && cd "$1" && pwd)
package=$(realpath "$2")
mirror=${MIRROR:-http://deb.debian.org/debian}

# The devices: cameras, foot switches, and the gadgets that play USB devices.
modules="vivid uinput evdev dummy_hcd libcomposite usb_f_hid usbhid hid-generic videodev videobuf2-vmalloc"
# What hooks use: a speaker and a sound card. Debian's kernel has nothing that plays GPIO lines.
modules+=" pcspkr snd-dummy"
# What the checks use: Python, video and network tools, a fleet's server, and what hooks start.
tools=systemd,systemd-sysv,udev,kmod,iproute2,python3,v4l-utils,adduser,zstd,beep,alsa-utils,gpiod,brightnessctl,brightness-udev,nats-server
depends=$(dpkg-deb -f "$package" Depends | tr ',' '\n' | sed 's/(.*)//; s/|.*//; s/ //g' | paste -sd,)

key=$(cat "$here/image.sh" <(echo "$depends") | sha256sum | cut -c1-16)
if [ "$(cat "$folder/key" 2>/dev/null)" = "$key" ]; then
	exit
fi
say() { echo "rig-vm: $*" >&2; }
work=$folder/making
rm -rf "$folder/key" "$work"
mkdir -p "$work/kernel"
trap 'rm -rf --one-file-system "$work"' EXIT

say "making a Debian 12 for the guest"
# The kernel and its headers are unpacked beside it: installed, they would bring tools for a boot that there is not.
# shellcheck disable=SC2016
mmdebstrap --quiet --mode=root --variant=minbase --include="$tools,$depends" --aptopt='Apt::Install-Recommends "false"' \
	--aptopt='Acquire::Retries "5"' \
	--dpkgopt='path-exclude=/usr/share/doc/*' --dpkgopt='path-exclude=/usr/share/man/*' \
	--dpkgopt='path-exclude=/usr/share/locale/*' \
	--customize-hook='version=$(apt-cache depends linux-image-amd64 | sed -n "s/.*Depends: linux-image-//p" | head -n 1);
		cd "'"$work"'" && apt-get download -qq -o APT::Sandbox::User=root "linux-image-$version" "linux-headers-$version" \
			"linux-headers-${version%-amd64}-common" "linux-kbuild-${version%%.[0-9]-*}" v4l2loopback-dkms' \
	--customize-hook='rm -rf "$1"/var/cache/apt/* "$1"/var/lib/apt/lists/* "$1"/etc/dpkg/dpkg.cfg.d/*' \
	bookworm "$work/root" "deb $mirror bookworm main"
root=$work/root
for deb in "$work"/*.deb; do dpkg-deb -x "$deb" "$work/kernel"; done
version=$(ls "$work/kernel/lib/modules")

say "building v4l2loopback for Linux $version"
headers=$work/kernel/usr/src/linux-headers-$version
# Debian's headers name each other by the paths that they have when they are installed.
find "$work/kernel/usr/src" -maxdepth 2 -name Makefile -exec sed -i "s#/usr/src/linux-#$work/kernel/usr/src/linux-#g" {} +
ln -sfn "$(ls -d "$work"/kernel/usr/lib/linux-kbuild-*)/scripts" "$headers/scripts"
ln -sfn "$(ls -d "$work"/kernel/usr/lib/linux-kbuild-*)/tools" "$headers/tools"
make -s -C "$headers" M="$(ls -d "$work"/kernel/usr/src/v4l2loopback-*)" CC=cc modules >"$work/make.log" 2>&1 || {
	tail -n 20 "$work/make.log" >&2
	say "v4l2loopback does not build"
	exit 1
}
mv "$work/kernel/lib/modules" "$root/usr/lib/"
install -D -t "$root/usr/lib/modules/$version/extra" "$work"/kernel/usr/src/v4l2loopback-*/v4l2loopback.ko

# Only the modules that are used, with what they need.
chroot "$root" depmod "$version"
for module in $modules v4l2loopback; do chroot "$root" modprobe -S "$version" --show-depends "$module"; done |
	sed -n 's#^insmod /*\(usr/\)*lib/#usr/lib/#p' | sed 's/ *$//' | sort -u >"$work/modules"
(cd "$root" && tar -cf "$work/modules.tar" -T "$work/modules" "usr/lib/modules/$version/modules.order" \
	"usr/lib/modules/$version/modules.builtin" "usr/lib/modules/$version/modules.builtin.modinfo")
rm -rf "$root/usr/lib/modules"
tar -xf "$work/modules.tar" -C "$root"
chroot "$root" depmod "$version"

# The kernel starts /init. Nobody logs in, and there is no disk to mount.
ln -sfn usr/lib/systemd/systemd "$root/init"
: >"$root/etc/fstab"
: >"$root/etc/machine-id"
echo rig >"$root/etc/hostname"
for unit in serial-getty@ttyS0 getty@tty1 systemd-timesyncd apt-daily apt-daily-upgrade; do
	ln -sfn /dev/null "$root/etc/systemd/system/$unit.service"
done
(cd "$root" && find . -xdev -path ./dev/\* -prune -o -print0 | cpio --quiet -0 -o -H newc) >"$folder/base.cpio"
cp "$work"/kernel/boot/vmlinuz-* "$folder/vmlinuz"
echo "$key" >"$folder/key"
say "the guest has Linux $version and $(du -m "$folder/base.cpio" | cut -f1) MiB"
