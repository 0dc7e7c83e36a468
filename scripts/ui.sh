#!/usr/bin/env bash
# Builds the operator's page into ui/dist, from where the build with the feature `page` takes it. Needs npm with Node 18 or
# later; the packages are those of ui/package-lock.json.
set -euo pipefail
cd "$(dirname "$0")/../ui"

if ! command -v npm >/dev/null; then
	echo "ui: npm is missing: run 'apt-get install npm' as root" >&2
	exit 1
fi
installed=node_modules/.package-lock.json
if [ ! -e $installed ] || [ package-lock.json -nt $installed ]; then
	# `npm ci` refuses a lock file without the packages of other systems, which not every registry tells.
	npm install --no-save --no-audit --no-fund --silent
	touch $installed
fi
# What is newer than the last build; without any the program need not be built again either.
if [ -e dist/licences.txt ] && [ -z "$(find . -path ./node_modules -prune -o -path ./dist -prune -o -path './test*' -prune -o -type f -newer dist/licences.txt -print)" ]; then
	exit 0
fi
npm run --silent build
# A build of the program that found no page looks again when this file is newer (build.rs).
touch -r dist/licences.txt index.html
