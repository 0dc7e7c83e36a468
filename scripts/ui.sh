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
	npm ci --no-audit --no-fund --silent
	touch $installed
fi
npm run --silent build
