#!/usr/bin/env python3
"""Draws the first picture of the README: test scenes as a path tracer leaves them, denoised, and the reference.

    PYTHONPATH=python python3 benches/showcase.py docs/showcase.jpg

It reads the largest films of `pipelines/denoiser_test.yaml`, which must have run with the targets `huge_table`,
`huge_best.timing` and `huge_oidn.timing`. Scenes are the first by key of each of the strata below. Captions are the
HDR PSNR against the reference, and the median time of the denoiser, G-buffers and loading excluded. It needs NumPy and
Pillow, and `tauflow` in target/release.
"""

import argparse
import os
import statistics
import sys

REPOSITORY = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
os.environ.setdefault("TAUFLOW", os.path.join(REPOSITORY, "target", "release", "tauflow"))

import numpy
from PIL import Image, ImageDraw, ImageFont

import tauflow

STRATA = ["L0-enclosed", "L1-open", "L2-environment", "L3-enclosed"]
FONT = os.path.join(REPOSITORY, "nodes", "report", "viewer", "src", "web", "DejaVuSans.ttf")
CAPTION, GAP = 34, 6


def psnr(image, reference):
    """Of exposed radiance with peak 1, as `image_metrics` computes it."""
    error = numpy.maximum(image, 0.0) - numpy.maximum(reference, 0.0)
    return -10.0 * numpy.log10(numpy.mean(numpy.square(error, dtype=numpy.float64)))


def named(node, key, **axes):
    """The item of a scene in the cell with these axes."""
    for item in node:
        own = node[item] if isinstance(item, str) else item
        if own.key.rsplit("/", 1)[-1] == key and all(str(own.axes.get(name)) == value for name, value in axes.items()):
            return own
    sys.exit(f"no item of {key} with {axes}")
