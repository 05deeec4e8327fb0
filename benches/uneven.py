#!/usr/bin/env python3
"""How much does an unknown or uneven sample count cost the bundled denoiser? Reads the scenes of
`pipelines/denoiser_test.yaml` of 96 x 96 pixels, and prints gains over the noisy image in dB of HDR PSNR.

    PYTHONPATH=python python3 benches/uneven.py [CACHE]

Uneven images have tiles of 16 x 16 pixels with 1 and with 16 samples per pixel, as a chessboard. They are compared with
the same tiles, cut out of the two images that were denoised with their counts told. In the last row, the network is
told the right count in each tile of the uneven image. Needs NumPy, and `tauflow` in target/release.
"""

import os
import sys

REPOSITORY = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
os.environ.setdefault("TAUFLOW", os.path.join(REPOSITORY, "target", "release", "tauflow"))

import numpy

import tauflow

COUNTS = [1, 2, 4, 8, 16, 32, 64]
# The images of the set have been exposed already.
PLAIN = {"exposure": 1.0, "normals": "camera"}


def error(image, reference):
    return numpy.mean(numpy.square(numpy.maximum(image, 0) - numpy.maximum(reference, 0), dtype=numpy.float64))


def main():
    cache = {"cache": sys.argv[1]} if len(sys.argv) > 1 else {}
    scenes = tauflow.open(os.path.join(REPOSITORY, "pipelines", "denoiser_test.yaml"), **cache)
    states, references = scenes["small_set"], scenes["small_references"]
    rows = {}
    for key in states:
        item = states[key]
        reference = numpy.asarray(references[item.scene].rung(references[item.scene].rungs[-1]))
        albedo, normal = (numpy.asarray(item.gbuffer()[name]) for name in ("albedo", "normal"))
        told = {}
        for count in COUNTS:
            noisy = numpy.asarray(item.rung(count))
            told[count] = tauflow.denoise(noisy, albedo, normal, spp=count, **PLAIN)
            untold = tauflow.denoise(noisy, albedo, normal, **PLAIN)
            rows.setdefault(str(count), []).append([error(image, reference) for image in (noisy, told[count], untold)])
        height, width = reference.shape[:2]
        board = numpy.add.outer(numpy.arange(height) // 16, numpy.arange(width) // 16) % 2 == 0
        mixed = [numpy.where(board[..., None], a, b) for a, b in
                 [(numpy.asarray(item.rung(1)), numpy.asarray(item.rung(16))), (told[1], told[16])]]
        found = [mixed[0], mixed[1], tauflow.denoise(mixed[0], albedo, normal, **PLAIN)]
        rows.setdefault("1 and 16", []).append([error(image, reference) for image in found])
        # As if the network knew the count of each pixel: the uneven image with either count told, tile by tile.
        either = [tauflow.denoise(mixed[0], albedo, normal, spp=count, **PLAIN) for count in (1, 16)]
        found[2] = numpy.where(board[..., None], *either)
        rows.setdefault("1 and 16, told by tile", []).append([error(image, reference) for image in found])
    print("| samples per pixel | count told | not told | difference |\n|---|---:|---:|---:|")
    for name, errors in rows.items():
        noisy, told, untold = (-10 * numpy.log10(numpy.array(errors))).mean(axis=0)
        print(f"| {name} | {told - noisy:+.2f} | {untold - noisy:+.2f} | {untold - told:+.2f} |")


if __name__ == "__main__":
    sys.exit(main())
