#!/usr/bin/env python3
"""Measures the bundled denoiser and Open Image Denoise on the largest films of `pipelines/denoiser_test.yaml`, and
prints the median time of one call in milliseconds, loading excluded. `--film N` renders them with N x N pixels.

    TAUFLOW_OIDN=path/to/libOpenImageDenoise.so python3 benches/denoiser_times.py             # all cores
    TAUFLOW_OIDN=... taskset -c 0 python3 benches/denoiser_times.py                 # one core

The machine must be idle. What is not in the cache is rendered first. It needs `tauflow` in target/release. Times of one
core and of several have keys of their own, as the processor set is part of the machine.
"""

import argparse
import glob
import json
import os
import statistics
import subprocess
import tempfile

REPOSITORY = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
PIPELINE = "pipelines/denoiser_test.yaml"
NODES = ["timed_best", "timed_fast", "timed_oidn", "timed_prefiltered"]


def tauflow(*words):
    program = os.environ.get("TAUFLOW", "target/release/tauflow")
    subprocess.run([program, *words], cwd=REPOSITORY, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def times(cache, nodes, film, scenes):
    """Medians over scenes of the medians of the repeats in seconds, by cell."""
    found, film = {}, ["--set", f"values.huge_film=[{film}, {film}]", "--set", f"huge.test={scenes}"]
    with tempfile.TemporaryDirectory() as folder:
        targets = [word for node in nodes for word in ("--target", f"{node}.timing")]
        tauflow("run", PIPELINE, *targets, *film, "--cache", cache, "--out", os.path.join(folder, "out"))
        for node in nodes:
            out = os.path.join(folder, node)
            tauflow("export", PIPELINE, f"{node}.timing", *film, "--cache", cache, "-o", out)
            for path in glob.glob(os.path.join(out, "*", "*", "*.json")):
                with open(path, encoding="utf-8") as file:
                    entries = json.load(file)["entries"]
                cell = os.path.basename(os.path.dirname(os.path.dirname(path)))
                found.setdefault(cell, []).extend(statistics.median(entry["took"]["wall_s"]) for entry in entries)
    return {cell: statistics.median(seconds) for cell, seconds in found.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", default="cache")
    parser.add_argument("--film", type=int, default=512, help="pixels along a side")
    parser.add_argument("--scenes", type=int, default=6)
    parser.add_argument("--nodes", nargs="*", default=NODES)
    options = parser.parse_args()
    print("| method | ms |\n|---|---:|")
    found = times(os.path.abspath(options.cache), options.nodes, options.film, options.scenes)
    for cell, seconds in sorted(found.items()):
        print(f"| {cell.replace('+', ', ')} | {1000 * seconds:.0f} |")


if __name__ == "__main__":
    main()
