#!/usr/bin/env bash
# Builds OpenNI2's driver for the Kinect v1 and puts it where Debian's OpenNI2 finds its drivers. Debian packages no
# such driver, but its libfreenect source package holds one: that source is fetched through apt, which checks it
# against Debian's signed list, by a source entry of this script's own that nothing else sees. Run as root.
#
# With DESTINATION set, the driver is put into that folder instead.
set -euo pipefail

version=1:0.5.3-3
suite=bookworm
keyring=/usr/share/keyrings/debian-archive-keyring.gpg
driver=libFreenectDriver.so.0

say() { echo "kinect-driver: $*" >&2; }

if [ "$(id -u)" -ne 0 ]; then
	say "it installs packages and a driver: run it as root"
	exit 1
fi

export DEBIAN_FRONTEND=noninteractive
# libfreenect0.5 brings the rules by which the group plugdev may use the camera.
packages=(cmake g++ make libusb-1.0-0-dev libopenni2-0 libfreenect0.5)
installed=$(dpkg-query -W -f '${Status}\n' "${packages[@]}" 2>/dev/null | grep -c 'ok installed' || true)
if [ "$installed" -ne ${#packages[@]} ]; then
	say "installing ${packages[*]}"
	apt-get update -qq
	apt-get install -y -qq --no-install-recommends "${packages[@]}" >/dev/null
fi

library=$(find /usr/lib -maxdepth 2 -name libOpenNI2.so.0 | head -n 1)
destination=${DESTINATION:-$(dirname "$library")/OpenNI2/Drivers}

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

say "fetching the source of libfreenect $version"
mkdir -p "$work/lists/partial" "$work/cache/archives/partial"
echo "deb-src [signed-by=$keyring] http://deb.debian.org/debian $suite main" >"$work/sources.list"
private=(
	-o "Dir::Etc::SourceList=$work/sources.list" -o Dir::Etc::SourceParts=-
	-o "Dir::State::Lists=$work/lists" -o "Dir::Cache=$work/cache" -o APT::Sandbox::User=root
)
cd "$work"
apt-get "${private[@]}" update -qq
# Only the upstream source: Debian's changes concern parts that are not built here.
apt-get "${private[@]}" source --tar-only --download-only -qq "libfreenect=$version" >/dev/null
mkdir source build
tar -xzf libfreenect_*.orig.tar.gz -C source --strip-components=1

say "building"
cmake -S source -B build -DCMAKE_BUILD_TYPE=Release -DBUILD_OPENNI2_DRIVER=ON -DBUILD_EXAMPLES=OFF \
	-DBUILD_FAKENECT=OFF -DBUILD_CPP=OFF -DBUILD_C_SYNC=OFF -DCMAKE_CXX_FLAGS=-fpermissive >build.log 2>&1 &&
	cmake --build build --parallel "$(nproc)" --target FreenectDriver >>build.log 2>&1 || {
	tail -n 30 build.log >&2
	say "it does not build"
	exit 1
}
built=$(find build -type f -name 'libFreenectDriver.so.*' | head -n 1)

say "loading it into OpenNI2"
# A folder in which it is the only driver: OpenNI2 starts only if it accepts the driver.
mkdir -p stage/OpenNI2/Drivers
ln -s "$library" stage/libOpenNI2.so.0
cp "$built" "stage/OpenNI2/Drivers/$driver"
cat >check.c <<'C'
int oniInitialize(int version);
void oniShutdown(void);
const char *oniGetExtendedError(void);
int puts(const char *);
int main(void)
{
	int status = oniInitialize(2002);
	if (status != 0)
		puts(oniGetExtendedError());
	oniShutdown();
	return status;
}
C
cc check.c -o check stage/libOpenNI2.so.0
if ! LD_LIBRARY_PATH="$work/stage" ./check >check.log 2>&1; then
	cat check.log >&2
	say "OpenNI2 does not load it; nothing was installed"
	exit 1
fi

install -d "$destination"
install -m 644 "$built" "$destination/$driver"
say "installed $destination/$driver"
