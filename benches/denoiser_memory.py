#!/usr/bin/env python3
"""Peak memory and time of `tauflow denoise` on an 8K image (7680 x 4320), with G-buffers and on RGB alone.

    tauflow render SCENE --width 480 --height 270 --spp 4 --gbuffer -o noisy.exr
    PYTHONPATH=python taskset -c 0 python3 benches/denoiser_memory.py noisy.exr [WIDTH HEIGHT]

The image is repeated until it has this size. Each repetition is brighter by 1% than the one before, so that a file
that repeats itself does not compress better than a render. Prints what the system counts as the largest resident set
of the process. Needs NumPy, and `tauflow` in target/release.
"""

import os
import sys
import tempfile
import time

REPOSITORY = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
os.environ.setdefault("TAUFLOW", os.path.join(REPOSITORY, "target", "release", "tauflow"))

import numpy

import tauflow


def repeated(image, width, height, brighter):
    """The image side by side and one below the other, cropped to this size."""
    rows, columns = -(-height // image.shape[0]), -(-width // image.shape[1])
    out = numpy.tile(image, (rows, columns, 1))
    if brighter:
        factors = 1 + 0.01 * numpy.arange(rows * columns, dtype=numpy.float32).reshape(rows, columns)
        out *= numpy.kron(factors, numpy.ones(image.shape[:2], numpy.float32))[..., None]
    return numpy.ascontiguousarray(out[:height, :width])


def measured(words):
    """Wall time in seconds and peak memory in MB of a command."""
    start = time.monotonic()
    process = os.spawnvp(os.P_NOWAIT, words[0], words)
    _, status, usage = os.wait4(process, 0)
    if status:
        sys.exit(f"{' '.join(words)}: failed")
    return time.monotonic() - start, usage.ru_maxrss * 1024 / 1e6


def main():
    if len(sys.argv) not in (2, 4):
        sys.exit(__doc__)
    width, height = (int(word) for word in sys.argv[2:]) if len(sys.argv) == 4 else (7680, 4320)
    layers = tauflow.read_layers(sys.argv[1])
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as folder:
        noisy, clean = os.path.join(folder, "noisy.exr"), os.path.join(folder, "clean.exr")
        names = [name for name in ("", "albedo", "normal") if name in layers]
        tauflow.write_layers(noisy, {name: repeated(layers[name], width, height, name == "") for name in names})
        print(f"| {width} x {height} | wall time | peak memory |\n|---|---:|---:|")
        for weights in ["best", "fast"]:
            for name, more in [("G-buffer", []), ("RGB", ["--rgb"])]:
                words = [os.environ["TAUFLOW"], "denoise", noisy, "-o", clean, "--weights", weights, *more]
                seconds, size = measured(words)
                print(f"| `{weights}`, {name} | {seconds:.0f} s | {size:.0f} MB |", flush=True)


if __name__ == "__main__":
    main()
