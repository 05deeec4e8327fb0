"""What adapted choices of lobes and lights bring on the scenes of FOLDER; see README.md.

python choices.py FOLDER [--scenes N] [--side 96] [--spp 64] [--cores 1|2]

Relative variance of single pixels: over the squared mean of all images, with a hundredth of the squared mean of the
film. Both ways are timed twice, in turn; learning is part of the time to prepare a scene, and shown apart.
"""

import argparse
import math
import pathlib
import statistics

import both
import numpy as np

parser = argparse.ArgumentParser()
parser.add_argument("folder", type=pathlib.Path)
parser.add_argument("--scenes", type=int, default=3)
parser.add_argument("--side", type=int, default=96)
parser.add_argument("--spp", type=int, default=64)
parser.add_argument("--batches", type=int, default=16)
parser.add_argument("--cores", type=int, default=2)
args = parser.parse_args()


def render(name, *how):
    return both.ours(args.folder, name, args.side, args.spp, args.batches, args.cores, *how)


def mean(values):
    """The geometric mean."""
    return math.exp(statistics.mean(math.log(value) for value in values))


rows = {}
for name in both.scenes(args.folder, args.scenes):
    (before, old), (now, new) = render(name, "fixed"), render(name)
    (before_again, _), (now_again, _) = render(name, "fixed"), render(name)
    level = np.concatenate([old, new]).mean((0, -1))
    scale = level**2 + 0.01 * level.mean() ** 2
    relative = [images.var(0, ddof=1).mean(-1) / scale for images in (old, new)]
    seconds = [
        statistics.median(a["seconds"] + b["seconds"]) for a, b in [(before, before_again), (now, now_again)]
    ]
    prepared = [min(a["prepared_s"], b["prepared_s"]) for a, b in [(before, before_again), (now, now_again)]]
    # Batches of both ways share random numbers: differences tell more than means.
    change = (new - old).mean((1, 2, 3))
    error = change.std(ddof=1) / math.sqrt(len(change))
    z = change.mean() / error if error > 0 else 0.0
    row = {
        "variance": relative[0].mean() / relative[1].mean(),
        "median": np.median(relative[0]) / np.median(relative[1]),
        "time": seconds[0] / seconds[1],
    }
    rows.setdefault(both.stratum(name), []).append(row)
    print(
        f"{name:24s} variance {row['variance']:.2f}, of the median pixel {row['median']:.2f}, "
        f"samples per second {row['time']:.2f}, learning {1000 * (prepared[1] - prepared[0]):.0f} ms, "
        f"change of the mean {z:+.1f} standard errors",
        flush=True,
    )
for key in ["variance", "median", "time"]:
    strata = {stratum: mean(row[key] for row in own) for stratum, own in rows.items()}
    print(key, ", ".join(f"{stratum} {value:.2f}" for stratum, value in strata.items()))
    print(key, f"geometric mean {mean(row[key] for own in rows.values() for row in own):.3f}")
