#!/usr/bin/env bash
# Runs one part of a gate and prints how long it took, on stderr and, if SCAND_PARTS names a file, into that file.
#
#   scripts/part.sh NAME COMMAND...
set -uo pipefail
name=$1
shift
begin=$SECONDS
"$@"
code=$?
took=$((SECONDS - begin))
line=$(printf '%3d min %02d s  %s' $((took / 60)) $((took % 60)) "$name")
[ "$code" -eq 0 ] || line="$line: FAILED"
echo "$line" >&2
[ -z "${SCAND_PARTS:-}" ] || echo "$line" >>"$SCAND_PARTS"
exit "$code"
