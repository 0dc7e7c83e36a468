#!/usr/bin/env bash
# Installs what the tests need beyond Rust and a C compiler, once: a C compiler if there is none, Debian's libraries of
# the live cameras, a camera simulator, OpenCV's pictures of a chessboard, and the Khronos validator for the models.
# Without root, the script names what it cannot install. npm and Chromium, which bring hundreds of packages along, are
# installed only if SCAND_REQUIRE_ALL=1 demands that no test is skipped.
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
# For tests on their own networks, some of them bad, on disks that are slow, fail or lose their power, and with clocks
# that jump.
need iproute2 nftables util-linux strace e2fsprogs mount libfaketime
# The service: its units are judged, and its socket handed over, by systemd's own programs. And its package, whose
# dependencies dpkg's tools find.
need systemd dpkg-dev
# The server of a fleet, for tests on ports of their own; its service is not needed.
need nats-server openssl
# Spelling: typos comes from PyPI.
need python3-venv

# Unpacks a Debian package that is not to be installed; gives the folder, which the caller removes. Needs no root, once
# the lists of packages are there.
unpack() {
	local unpacked
	unpacked=$(mktemp -d)
	if ! (cd "$unpacked" && apt-get -o APT::Sandbox::User=root download -qq "$1"); then
		echo "deps: cannot download the package $1: run 'apt-get update' as root" >&2
		return 1
	fi
	dpkg-deb -x "$unpacked/$1"_*.deb "$unpacked"
	echo "$unpacked"
}

# The stand-alone camera simulator is in a package that would bring a desktop along; the program alone needs none of it.
simulator=arv-fake-gv-camera-0.8
if ! command -v $simulator >/dev/null && [ ! -x aravis-tools/usr/bin/$simulator ]; then
	unpacked=$(unpack aravis-tools)
	install -D "$unpacked/usr/bin/$simulator" aravis-tools/usr/bin/$simulator
	rm -r "$unpacked"
fi

# Other people's pictures of a board, with published results: 0.7 MB of a package of 96.
if [ ! -f opencv/right14.jpg ]; then
	unpacked=$(unpack opencv-doc)
	mkdir -p opencv
	cp "$unpacked"/usr/share/doc/opencv-doc/examples/data/{left,right}[0-9][0-9].jpg opencv
	rm -r "$unpacked"
fi

if [ "${SCAND_REQUIRE_ALL:-}" = 1 ]; then
	if ! command -v npm >/dev/null; then
		need npm
	fi
	# For `make page-test`.
	need chromium
fi
if command -v npm >/dev/null; then
	if [ ! -d gltf/node_modules/gltf-validator ]; then
		(cd gltf && npm install --no-audit --no-fund --silent)
	fi
else
	echo "deps: no npm: the tests will skip the Khronos validator, and say so" >&2
fi
