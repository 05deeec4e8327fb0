#!/usr/bin/env bash
# Makes the scenes of scenes.yaml and exports three a stratum: FOLDER/ours/SCENE and FOLDER/mitsuba/SCENE.
set -euo pipefail
folder=${1:?usage: scenes.sh FOLDER}
cd "$(dirname "$0")/../.."
cargo build --quiet --release --bin tauflow
cargo build --quiet --release -p tauflow-render --example batches --target-dir target/examples
mkdir -p "$folder/all" "$folder/ours" "$folder/mitsuba"
cp target/examples/release/examples/batches "$folder/batches"
target/release/tauflow run benches/mitsuba/scenes.yaml --out "$folder/out"
target/release/tauflow export benches/mitsuba/scenes.yaml gate.accepted -o "$folder/all"
for stratum in L{0,1,2,3}-{environment,open,enclosed}; do
    for scene in $(cd "$folder/all" && ls -d "$stratum"-* | head -3); do
        cp -r "$folder/all/$scene" "$folder/ours/"
        target/release/tauflow scene mitsuba "$folder/all/$scene" --width 64 --height 64 -o "$folder/mitsuba/$scene"
    done
done
