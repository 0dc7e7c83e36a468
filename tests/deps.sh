#!/usr/bin/env bash
# Installs what the tests need beyond Rust and a C compiler, once: a C compiler itself where there is none, Debian's
# libraries of the live cameras, a camera simulator, and the Khronos validator for the models. What cannot be installed
# without root is named, not hidden.
set -euo pipefail
cd "$(dirname "$0")"

# Installs the Debian packages that are not there yet.
need() {
	local missing=() package
	for package in "$@"; do
		if ! dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed'; then
			missing+=("$package")
		fi
	done
	if [ ${#missing[@]} -eq 0 ]; then
		return
	fi
	if [ "$(id -u)" -ne 0 ]; then
		echo "deps: run 'apt-get install ${missing[*]}' as root" >&2
		exit 1
	fi
	apt-get update -qq
	DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}"
}

if ! command -v cc >/dev/null; then
	need gcc libc6-dev
fi

# GigE Vision cameras. Debian's libaravis-dev forgets that its pkg-config file needs libusb's.
need pkg-config libaravis-dev libusb-1.0-0-dev
# Depth cameras; and V4L2, whose headers are read with clang.
need libopenni2-dev libclang-dev
# Tests on networks of their own, bad ones among them, and on disks that are slow, refuse, or lose their power;
# and under clocks that step.
need iproute2 nftables util-linux strace e2fsprogs mount libfaketime
# The service: its units are judged, and its socket handed over, by systemd's own programs. And its package, whose
# dependencies dpkg's tools find.
need systemd dpkg-dev

# The stand-alone camera simulator is in a package that would bring a desktop along; the program alone needs none of it.
simulator=arv-fake-gv-camera-0.8
if ! command -v $simulator >/dev/null && [ ! -x aravis-tools/usr/bin/$simulator ]; then
	unpacked=$(mktemp -d)
	# Without root, too, but for the lists of packages.
	if ! (cd "$unpacked" && apt-get download -qq aravis-tools); then
		echo "deps: cannot download the package aravis-tools: run 'apt-get update' as root" >&2
		exit 1
	fi
	dpkg-deb -x "$unpacked"/aravis-tools_*.deb "$unpacked/x"
	install -D "$unpacked/x/usr/bin/$simulator" aravis-tools/usr/bin/$simulator
	rm -r "$unpacked"
fi

if command -v npm >/dev/null; then
	if [ ! -d gltf/node_modules/gltf-validator ]; then
		(cd gltf && npm install --no-audit --no-fund --silent)
	fi
else
	echo "deps: no npm: the tests will say that they skip the Khronos validator" >&2
fi
