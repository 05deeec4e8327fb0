#!/usr/bin/env python3
"""Draws docs/denoise.png: scenes of the comparison at 4 samples per pixel, denoised by the bundled models and by Open
Image Denoise, with preview PSNR and the median time of one call, and their references.

    tauflow run pipelines/denoiser_test.yaml
    tauflow run pipelines/denoiser_test.yaml --target large_best.timing --target large_oidn.timing
    PYTHONPATH=python TAUFLOW=target/release/tauflow python3 benches/showcase.py [scene ...]

Needs matplotlib. Without scenes, it takes the first of the strata that are named below.
"""

import argparse
import json
import pathlib
import statistics
import sys
import tempfile

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

import tauflow  # noqa: E402

STRATA = ["L0-enclosed", "L1-open", "L2-environment"]
FROM = 4


def psnr(image, reference):
    return -10 * np.log10(((image - reference) ** 2).mean())


def milliseconds(pipeline, node):
    """The median wall time of a call over all scenes and repetitions."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        words = ["export", pipeline.file, f"{node}[conditioning=gbuffer, from={FROM}].timing", "-o", f"{folder}/out"]
        tauflow._open._run([*words, *pipeline._cache])
        for path in pathlib.Path(folder).rglob("*.json"):
            said = json.loads(path.read_text())
            for entry in said.get("entries", []) if isinstance(said, dict) else []:
                found.extend(entry["took"]["wall_s"])
    return 1000 * statistics.median(found)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*")
    parser.add_argument("--cache")
    parser.add_argument("-o", "--out", default="docs/denoise.png")
    args = parser.parse_args()
    pipeline = tauflow.open("pipelines/denoiser_test.yaml", cache=args.cache)
    references, noisy = pipeline["large_references"], pipeline["large_set"]
    scenes = args.scenes or [next(key for key in references if key.startswith(stratum)) for stratum in STRATA]
    cell = f"[conditioning=gbuffer, from={FROM}]"
    methods = [(name, pipeline[node + cell], node) for name, node in [("tauflow", "large_best"), ("OIDN", "large_oidn")]]
    titles = [f"{FROM} samples per pixel"]
    titles += [f"{name}, {milliseconds(pipeline, node):.0f} ms" for name, _, node in methods] + ["reference"]
    figure, axes = plt.subplots(len(scenes), 4, figsize=(10.4, 2.72 * len(scenes)), dpi=100)
    for row, scene in zip(axes, scenes):
        last = references[scene].rungs[-1]
        clean = references[scene].rung(last).preview()
        shown = [noisy[scene].rung(FROM).preview()]
        for _, images, _ in methods:
            shown.append(next(iter(images[scene].images.values())).preview())
        for place, title, image in zip(row, titles, [*shown, clean]):
            place.imshow(np.clip(image, 0, 1), interpolation="nearest")
            place.set_xticks([])
            place.set_yticks([])
            if row is axes[0]:
                place.set_title(title, fontsize=10)
            if image is not clean:
                place.set_xlabel(f"{psnr(image, clean):.1f} dB", fontsize=9, labelpad=2)
        row[3].set_xlabel(f"{last} samples per pixel", fontsize=9, labelpad=2)
        row[0].set_ylabel(scene.rsplit("-", 1)[0], fontsize=9)
    figure.tight_layout(pad=0.4)
    figure.savefig(args.out)
    print(args.out)


if __name__ == "__main__":
    sys.exit(main())
