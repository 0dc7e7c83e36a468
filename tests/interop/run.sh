#!/usr/bin/env bash
# `make interop`: from a simulated recording to a model, an archive package, exports, datasets and a published folder,
# each checked with other people's readers, and then all of it from a press on the simulated rig (press.sh), if the
# program has cameras. The readers are installed into target/interop, versions and hashes locked, and may take
# 500 MB. SCAND names the program. INTEROP=all also runs readers that are larger (large.sh).
set -euo pipefail
cd "$(dirname "$0")/../.."
root=$PWD
here=$root/tests/interop
environment=target/interop/environment
work=target/interop/work
scand=$(realpath "${SCAND:-target/release/scand}")
python=$environment/bin/python
# What Python compiles would count with the readers.
export PYTHONDONTWRITEBYTECODE=1

# Once for each version of the lock.
lock=$(sha256sum $here/requirements.txt | cut -d ' ' -f 1)
if [ "$(cat $environment/lock 2>/dev/null)" != "$lock" ]; then
	rm -rf $environment
	python3 -m venv $environment
	pip=("$python" -m pip install --quiet --disable-pip-version-check --require-hashes)
	# What builds bagit comes first, so that building it fetches nothing.
	grep -v '^bagit' $here/requirements.in | grep -E '^(setuptools|setuptools-scm|wheel)==' >$environment/build.txt
	"$python" - $here/requirements.txt $environment/build.txt <<-'EOF'
		# Keeps of the lock what builds packages.
		import re, sys
		lock, wanted = open(sys.argv[1]).read(), open(sys.argv[2]).read()
		names = [line.split("==")[0] for line in wanted.split()] + ["packaging"]
		entries = re.split(r"\n(?=[a-z])", lock)
		open(sys.argv[2], "w").write("\n".join(e for e in entries if e.split("==")[0] in names) + "\n")
	EOF
	"${pip[@]}" --no-compile -r $environment/build.txt
	"${pip[@]}" --no-compile --no-build-isolation -r $here/requirements.txt
	echo "$lock" >$environment/lock
fi
"$python" -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps --force-reinstall ./python
"$python" -m pytest -q -p no:cacheprovider python/tests
rm -rf python/build python/*.egg-info

rm -rf $work
mkdir -p $work
cd $work
python=../environment/bin/python
"$scand" simulate --shape cup --textured --cameras 8 --size 640x480 --encoding jpeg --captures 2 --out plain.mcap
"$python" $here/entitle.py plain.mcap cup.mcap
rm plain.mcap
"$scand" note cup-000 accept --author Zacharias --recording cup.mcap
"$scand" replay cup.mcap -q
"$scand" archive cup.mcap -o package --date 2026-01-31
for format in obj stl 3mf usdz glb; do
	"$scand" export out --format $format
	"$scand" export out/cup/cup-000 --format $format --lod 1
done
"$scand" export out --format glb --compress -o small
for program in colmap nerfstudio openmvs; do
	"$scand" export cup.mcap --dataset $program --model out -o $program
done
"$scand" publish out --recordings . --address https://museum.example/3d -o site
"$python" $here/check.py .
cd "$root"
version=$("$scand" --version)
if [[ $version == *aravis* && $version == *openni2* ]]; then
	SCAND=$scand PYTHON=$(realpath -s target/interop/environment/bin/python) $here/press.sh target/interop/press
elif [ "${SCAND_REQUIRE_ALL:-}" = 1 ]; then
	echo "interop: $scand has no cameras, and so no press" >&2
	exit 1
else
	echo "skipped: from a press: $scand has no cameras (make interop builds them where tests/deps.sh has installed their libraries)"
fi
took=$SECONDS
size() { { du -smc --apparent-size "$@" 2>/dev/null || true; } | tail -n 1 | cut -f 1; }
readers=$(size $environment)
echo "interop: $readers MB of readers, $(size $work target/interop/press) MB made, $took s"
# Machines differ, so a long time is told and fails nothing.
if [ "$took" -gt 300 ]; then echo "interop: took $took s, more than 300 s"; fi
if [ "$readers" -gt 500 ]; then
	echo "interop: the readers take $readers MB, more than 500 MB: move the largest to large.sh" >&2
	exit 1
fi
if [ "${INTEROP:-}" = all ]; then $here/large.sh; fi
