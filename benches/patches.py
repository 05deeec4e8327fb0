#!/usr/bin/env python3
"""How well are images with a black background and a lamp denoised on RGB alone? Compares the bundled denoiser with Open
Image Denoise (OIDN) at high quality on the scenes of `pipelines/denoiser_test.yaml` of 256 x 256 pixels.

    PYTHONPATH=python python3 benches/patches.py [--cache CACHE] [--model FILE ...]

Each scene gets a black frame and a rectangular lamp, without noise. Pixels at their edges show them in a random share
of their samples. Prints means over scenes of preview PSNR in dB, of all pixels and of those that are near an edge or in
the frame, and paired differences with 95% intervals over scenes. `--model` adds model files that see RGB alone, and
`--pipeline`, `--images` and `--references` choose other scenes. Needs NumPy, pyoidn 2.5, and `tauflow` in
target/release. Run the pipeline first.
"""

import argparse
import os

REPOSITORY = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
os.environ.setdefault("TAUFLOW", os.path.join(REPOSITORY, "target", "release", "tauflow"))

import numpy
import pyoidn

import tauflow

COUNTS = [1, 4, 16, 64]
# Exposed radiance of the lamp; mid grey is 0.18.
LAMP = numpy.array([100.0, 80.0, 60.0])
# Pixels within this distance of a patch are near it.
NEAR = 4


def covered(shape, middle, halves, angle):
    """The share of each pixel inside a rectangle: middle and half sides in shares of the image."""
    points = (numpy.arange(4 * shape[0]) + 0.5) / (4 * shape[0])
    y, x = numpy.meshgrid(points - middle[1], points - middle[0], indexing="ij")
    along = numpy.abs(x * numpy.cos(angle) + y * numpy.sin(angle)) < halves[0]
    across = numpy.abs(y * numpy.cos(angle) - x * numpy.sin(angle)) < halves[1]
    return (along & across).reshape(shape[0], 4, shape[1], 4).mean(axis=(1, 3))


def patches(shape, random):
    """Black frame and lamp: their coverage and radiance."""
    frame = 1.0 - covered(shape, random.uniform(0.45, 0.55, 2), random.uniform(0.3, 0.45, 2), random.uniform(-0.2, 0.2))
    lamp = covered(shape, random.uniform(0.3, 0.7, 2), random.uniform(0.03, 0.1, 2), random.uniform(-0.5, 0.5))
    return [(lamp, LAMP), (frame, numpy.zeros(3))]


def over(image, parts, count, random):
    """The image behind the patches, with so many samples per pixel; none for the limit of many."""
    for coverage, radiance in parts:
        hits = coverage if count is None else random.binomial(count, coverage) / count
        image = image + hits[..., None] * (radiance - image)
    return numpy.ascontiguousarray(image, dtype=numpy.float32)


def near(parts):
    """Pixels of the frame and pixels near an edge."""
    edges = numpy.zeros(parts[0][0].shape, bool)
    for coverage, _ in parts:
        padded = numpy.pad(coverage, NEAR, mode="edge")
        windows = numpy.lib.stride_tricks.sliding_window_view(padded, (2 * NEAR + 1, 2 * NEAR + 1))
        edges |= windows.min(axis=(-1, -2)) < windows.max(axis=(-1, -2))
    return edges | (parts[1][0] == 1.0)


def gaussian(image):
    """A Gaussian filter of logarithms, with the params of `pipelines/baselines.yaml`."""
    weights = numpy.exp(-0.5 * (numpy.arange(-8, 9) / 1.5) ** 2)
    values = numpy.log1p(numpy.maximum(image, 0.0))
    for axis in (0, 1):
        padded = numpy.pad(values, [(8, 8) if i == axis else (0, 0) for i in range(3)], mode="edge")
        parts = [numpy.take(padded, range(i, i + values.shape[axis]), axis=axis) for i in range(17)]
        values = sum(weight * part for weight, part in zip(weights, parts)) / weights.sum()
    return numpy.expm1(values)


def preview(values):
    mapped = numpy.maximum(values, 0.0).astype(numpy.float64)
    return (mapped / (1.0 + mapped)) ** (1.0 / 2.2)


def interval(values):
    draws = numpy.random.default_rng(1).integers(len(values), size=(4000, len(values)))
    low, high = numpy.quantile(values[draws].mean(axis=1), [0.025, 0.975])
    return f"{values.mean():+.2f} [{low:.2f}, {high:.2f}]"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache")
    parser.add_argument("--model", nargs="*", default=[])
    parser.add_argument("--pipeline", default=os.path.join(REPOSITORY, "pipelines", "denoiser_test.yaml"))
    parser.add_argument("--images", default="large_set")
    parser.add_argument("--references", default="large_references")
    args = parser.parse_args()
    scenes = tauflow.open(args.pipeline, **({"cache": args.cache} if args.cache else {}))
    images, references = scenes[args.images], scenes[args.references]
    methods = {
        "noisy": lambda noisy: noisy,
        "Gaussian filter": gaussian,
        "OIDN": lambda noisy: pyoidn.denoise(noisy, hdr=True),
        "`fast`": lambda noisy: tauflow.denoise(noisy, weights="fast"),
        "`best`": lambda noisy: tauflow.denoise(noisy),
    }
    for file in args.model:
        methods[file] = lambda noisy, file=file: tauflow.denoise(noisy, model=file)
    found = {(name, count): [] for name in methods for count in COUNTS}
    for at, key in enumerate(images):
        item = images[key]
        random = numpy.random.default_rng(at)
        reference = numpy.asarray(references[item.scene].rung(references[item.scene].rungs[-1]))
        parts = patches(reference.shape[:2], random)
        shown, edges = preview(over(reference, parts, None, random)), near(parts)
        for count in COUNTS:
            noisy = over(numpy.asarray(item.rung(count)), parts, count, random)
            for name, method in methods.items():
                squares = (preview(method(noisy)) - shown) ** 2
                found[name, count].append([squares.mean(), squares[edges].mean()])
    for which, what in enumerate(["all pixels", "near patches"]):
        print(f"\n| {what} | {' | '.join(f'{count} spp' for count in COUNTS)} |\n|---|{'---:|' * len(COUNTS)}")
        psnrs = {cell: -10.0 * numpy.log10(numpy.array(errors)[:, which]) for cell, errors in found.items()}
        for name in methods:
            print(f"| {name} | {' | '.join(f'{psnrs[name, count].mean():.2f}' for count in COUNTS)} |")
        for name in list(methods)[3:]:
            gaps = [interval(psnrs[name, count] - psnrs["OIDN", count]) for count in COUNTS]
            print(f"| {name} minus OIDN | {' | '.join(gaps)} |")


if __name__ == "__main__":
    main()
