#!/usr/bin/env python3
"""How smooth the frozen samples of `pipelines/adapter.yaml` are, compared with held-out renders.

    PYTHONPATH=python TAUFLOW=target/release/tauflow python benches/smoothness.py [--profile quick] [--cache DIR]

For each set it prints the number of images, the mean difference of horizontal neighbours, and the mean standard
deviation per image and channel, all in display values.
"""

import argparse

import numpy as np

import tauflow


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--profile", default="quick")
    parser.add_argument("--cache")
    options = parser.parse_args()
    pipeline = tauflow.open("pipelines/adapter.yaml", profile=options.profile, cache=options.cache)
    sets = {}
    for node, steps in [("samples", "few steps"), ("frozen_samples", "many steps")]:
        for item in pipeline[node].values():
            name = f"{item.key.rsplit('-', 1)[0]}, {steps}"
            sets.setdefault(name, []).append(item.image("frozen.exr").data)
    sets["held_out"] = [item.rung(item.rungs[-1]).preview() for item in pipeline["held_out"].values()]
    for name, images in sets.items():
        images = np.stack(images).astype(np.float64)
        neighbours, contrast = np.abs(np.diff(images, axis=2)).mean(), images.std((1, 2)).mean()
        print(f"{name:26} {len(images):5} images  neighbours {neighbours:.3f}  contrast {contrast:.3f}")


main()
