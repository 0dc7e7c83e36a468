#!/usr/bin/env bash
# Installs what the tests need beyond Rust and a C compiler, once: a C compiler itself where there is none,
# and the Khronos validator for the models. What cannot be installed without root is named, not hidden.
set -euo pipefail
cd "$(dirname "$0")"

if ! command -v cc >/dev/null; then
	if [ "$(id -u)" -ne 0 ]; then
		echo "deps: no C compiler: run 'apt-get install gcc libc6-dev' as root" >&2
		exit 1
	fi
	apt-get update -qq
	apt-get install -y -qq gcc libc6-dev
fi

if command -v npm >/dev/null; then
	if [ ! -d gltf/node_modules/gltf-validator ]; then
		(cd gltf && npm install --no-audit --no-fund --silent)
	fi
else
	echo "deps: no npm: the tests will say that they skip the Khronos validator" >&2
fi
