#!/usr/bin/env bash
# Makes scenes and exports three a stratum for both renderers: FOLDER/ours/SCENE and FOLDER/mitsuba/SCENE. The scenes
# are those of scenes.yaml, or a port of another pipeline, run with further arguments.
set -euo pipefail
usage='usage: scenes.sh FOLDER [PIPELINE PORT [ARGUMENTS OF RUN...]]'
folder=${1:?$usage}
pipeline=$(realpath "${2:-$(dirname "$0")/scenes.yaml}")
port=${3:-gate.accepted}
shift $(($# < 3 ? $# : 3))
cd "$(dirname "$0")/../.."
cargo build --quiet --release --bin tauflow
cargo build --quiet --release -p tauflow-render --example batches --target-dir target/examples
mkdir -p "$folder/all" "$folder/ours" "$folder/mitsuba"
cp target/examples/release/examples/batches "$folder/batches"
target/release/tauflow run "$pipeline" --target "${port%%.*}" --out "$folder/out" "$@"
target/release/tauflow export "$pipeline" "$port" -o "$folder/all" "$@"
for stratum in L{0,1,2,3}-{environment,open,enclosed}; do
    for scene in $(cd "$folder/all" && ls -d "$stratum"-* | head -3); do
        cp -r "$folder/all/$scene" "$folder/ours/"
        target/release/tauflow scene mitsuba "$folder/all/$scene" --width 64 --height 64 -o "$folder/mitsuba/$scene"
    done
done
