#!/usr/bin/env bash
# The graph of benches/engine.rs (ten copies in a row of each of ITEMS files of a kilobyte) with our engine, with ninja
# (Debian: ninja-build) and with Snakemake (pip install snakemake; put it on the PATH), one after the other. Snakemake
# gets SNAKE_ITEMS items, because it takes a tenth of a second for each copy: compare times per action.
#
#   benches/engine_peers.sh [ITEMS [SNAKE_ITEMS [FOLDER]]]
#
# Prints the first run, the median of three with nothing to do, and one after a change of a single source.
set -euo pipefail
items=${1:-30000}
snake_items=${2:-100}
base=${3:-$(mktemp -d)}
cd "$(dirname "$0")/.."
folder=$(mktemp -d -p "$base")
trap 'rm -rf "$folder"' EXIT

seconds() {
    local start=$EPOCHREALTIME
    "$@" >/dev/null 2>&1
    awk "BEGIN { printf \"%.3f\", $EPOCHREALTIME - $start }"
}
median() { printf '%s\n' "$@" | sort -n | sed -n "$((($# + 1) / 2))p"; }
tell() { # name, actions, seconds
    awk "BEGIN { printf \"%-34s %10.3f s %12.1f us an action\n\", \"$1\", $3, $3 * 1e6 / $2 }"
}
sources() { # folder, count
    mkdir -p "$1"
    head -c 1014 /dev/zero >"$folder/zeros"
    for ((i = 0; i < $2; i++)); do printf '%010d' "$i" | cat - "$folder/zeros" >"$1/$i"; done
}

echo "tauflow, $items items:"
cargo bench --quiet --bench engine -- "$items" "$folder"

if command -v ninja >/dev/null; then
    sources "$folder/ninja/n0" "$items"
    {
        printf 'rule cp\n  command = cp $in $out\n'
        for node in {1..10}; do
            for ((i = 0; i < items; i++)); do printf 'build n%d/%d: cp n%d/%d\n' "$node" "$i" "$((node - 1))" "$i"; done
        done
    } >"$folder/ninja/build.ninja"
    actions=$((10 * items))
    tell "ninja, first run" "$actions" "$(seconds ninja -C "$folder/ninja" --quiet)"
    idle=(); for _ in 1 2 3; do idle+=("$(seconds ninja -C "$folder/ninja" --quiet)"); done
    tell "ninja, nothing changed" "$actions" "$(median "${idle[@]}")"
    echo changed >"$folder/ninja/n0/$((items / 2))"
    tell "ninja, one source changed" "$actions" "$(seconds ninja -C "$folder/ninja" --quiet)"
else
    echo "ninja is not there: skipped"
fi

if command -v snakemake >/dev/null; then
    sources "$folder/snake/n0" "$snake_items"
    cat >"$folder/snake/Snakefile" <<SNAKE
rule all:
    input: expand("n10/{i}", i=range($snake_items))
SNAKE
    for node in {1..10}; do
        printf 'rule n%d:\n    input: "n%d/{i}"\n    output: "n%d/{i}"\n    shell: "cp {input} {output}"\n' \
            "$node" "$((node - 1))" "$node" >>"$folder/snake/Snakefile"
    done
    snake() { (cd "$folder/snake" && snakemake --cores 2 --quiet all); }
    actions=$((10 * snake_items))
    tell "snakemake, first run" "$actions" "$(seconds snake)"
    idle=(); for _ in 1 2 3; do idle+=("$(seconds snake)"); done
    tell "snakemake, nothing changed" "$actions" "$(median "${idle[@]}")"
    echo changed >"$folder/snake/n0/$((snake_items / 2))"
    tell "snakemake, one source changed" "$actions" "$(seconds snake)"
else
    echo "snakemake is not there: skipped"
fi
