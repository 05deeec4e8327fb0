#!/usr/bin/env bash
# The graph of benches/engine.rs with ninja (Debian: ninja-build): ten copies in a row of each of ITEMS files.
# Prints the times of the first run, of one with nothing to do, and of one after a change of a single source.
set -euo pipefail
items=${1:-30000}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
mkdir n0
head -c 1014 /dev/zero >zeros
for ((i = 0; i < items; i++)); do
    printf '%010d' "$i" | cat - zeros >"n0/$i"
done
{
    printf 'rule cp\n  command = cp $in $out\n'
    for node in {1..10}; do
        for ((i = 0; i < items; i++)); do
            printf 'build n%d/%d: cp n%d/%d\n' "$node" "$i" "$((node - 1))" "$i"
        done
    done
} >build.ninja
seconds() { local start=$EPOCHREALTIME; "$@" >/dev/null; awk "BEGIN { print $EPOCHREALTIME - $start }"; }
echo "first run: $(seconds ninja --quiet) s"
for _ in 1 2 3; do echo "nothing changed: $(seconds ninja --quiet) s"; done
echo changed >"n0/$((items / 2))"
echo "one source changed: $(seconds ninja --quiet) s"
