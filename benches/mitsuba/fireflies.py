"""Counts fireflies of both renderers in exported scenes; see README.md.

python fireflies.py FOLDER [--scenes 3] [--side 128] [--spp 64] [--batches 4]

Each batch is an image of its own. The clean image is the median over the batches of both renderers. A firefly is a
pixel that is more than 4 times as bright as all pixels of the clean image within one pixel of it, and by more than a
tenth of the image's mean. Prints fireflies in 10,000 pixels by stratum, for tauflow and for Mitsuba.
"""

import argparse
import pathlib
from collections import defaultdict

import numpy as np

import both

parser = argparse.ArgumentParser()
parser.add_argument("folder", type=pathlib.Path)
parser.add_argument("--scenes", type=int, default=3)
parser.add_argument("--side", type=int, default=128)
parser.add_argument("--spp", type=int, default=64)
parser.add_argument("--batches", type=int, default=4)
args = parser.parse_args()


def fireflies(images, clean):
    """In 10,000 pixels of the images [batch, y, x, colour], by the clean luminance [y, x]."""
    height, width = clean.shape
    edge = np.pad(clean, 1, mode="edge")
    around = np.max([edge[y : y + height, x : x + width] for y in range(3) for x in range(3)], axis=0)
    luminance = images @ [0.2126, 0.7152, 0.0722]
    found = (luminance > 4 * around) & (luminance - around > 0.1 * clean.mean())
    return 1e4 * found.mean()


counts = defaultdict(list)
for name in both.scenes(args.folder, args.scenes):
    _, ours = both.ours(args.folder, name, args.side, args.spp, args.batches)
    _, theirs = both.mitsuba(args.folder, name, args.side, args.spp, args.batches)
    clean = np.median(np.concatenate([ours, theirs]), axis=0) @ [0.2126, 0.7152, 0.0722]
    counts[both.stratum(name)].append((fireflies(ours, clean), fireflies(theirs, clean)))
print("| stratum | tauflow | Mitsuba |\n|---|---:|---:|")
for stratum, rows in counts.items():
    print(f"| {stratum} | " + " | ".join(f"{value:.1f}" for value in np.mean(rows, axis=0)) + " |")
