"""Whether both renderers have the same expectation on every scene of FOLDER; see README.md.

python agree.py FOLDER [--scenes N] [--side 64] [--batches 16] [--most 8192] [--only SCENE ...]

Two-sample tests on means of independent batches: of the image mean, and of 8 x 8 bins. The limits are Sidak's over all
scenes, and over all bins, at 1% each, with 2e-5 of the value allowed for rounding. So if the renderers agree, two runs
in a hundred name a scene. Samples a batch are quadrupled until the smallest bias of the image mean that would be found
(80% power) is below 0.3%, or there are as many as allowed. Where only some scenes are asked for, the limits stay those
of all, and agree.json keeps what it says of the others.
"""

import argparse
import json
import math
import pathlib

import numpy as np

import both
from both import BINS, binned, deviation, limit

parser = argparse.ArgumentParser()
parser.add_argument("folder", type=pathlib.Path)
parser.add_argument("--scenes", type=int, default=3)
parser.add_argument("--side", type=int, default=64)
parser.add_argument("--batches", type=int, default=16)
parser.add_argument("--reference", type=pathlib.Path, help="writes Mitsuba's means of bins, for the project's tests")
parser.add_argument("--most", type=int, default=8192, help="samples per pixel and batch at most")
parser.add_argument("--only", nargs="*", metavar="SCENE", help="these of the scenes, at the limits of all")
args = parser.parse_args()
if args.only and args.reference:
    parser.error("--reference is of all scenes")
names = both.scenes(args.folder, args.scenes)
for name in set(args.only or []) - set(names):
    parser.error(f"{name} is none of the scenes: {', '.join(names)}")

digests = {}
if args.reference:
    manifest = json.loads((args.folder / "all" / "manifest.json").read_text())
    digests = {item["item"]: item["digest"] for item in manifest["items"]}
references = []
rows, bins_limit, mean_limit = [], limit(len(names) * BINS * BINS), limit(len(names))
print(f"{len(names)} scenes; limits {mean_limit:.2f} for means, {bins_limit:.2f} for bins")
for name in args.only or names:
    spp = 256
    while True:
        report, a = both.ours(args.folder, name, args.side, spp, args.batches)
        _, b = both.mitsuba(args.folder, name, args.side, spp, args.batches)
        z, error = deviation(a.mean((1, 2, 3)), b.mean((1, 2, 3)))
        mean = b.mean()
        smallest = (mean_limit + 0.84) * error / mean
        if smallest < 0.003 or 4 * spp > args.most:
            break
        spp *= 4
    worst = float(np.abs(deviation(binned(a), binned(b))[0]).max())
    row = {
        "scene": name, "spp": spp * args.batches, "mean": mean, "bias": float(a.mean() / mean - 1), "z": float(z),
        "smallest": float(smallest), "worst_bin": worst, "rejected": report["rejected"],
        "agrees": bool(abs(z) < mean_limit and worst < bins_limit and report["rejected"] == 0),
    }
    rows.append(row)
    cells = binned(b)
    references.append({
        "scene": name, "digest": digests.get(name), "spp": row["spp"],
        "means": [float(f"{v:.6g}") for v in cells.mean(0).ravel()],
        "errors": [float(f"{v:.3g}") for v in (cells.std(0, ddof=1) / math.sqrt(len(cells))).ravel()],
    })
    print(
        f"{name:24s} {row['spp']:7d} spp  bias {100 * row['bias']:+.3f}%  z {row['z']:+.2f}  "
        f"finds {100 * smallest:.2f}%  worst bin {worst:.2f}  {'agrees' if row['agrees'] else 'DIFFERS'}",
        flush=True,
    )
table = args.folder / "agree.json"
if args.only and table.exists():
    found = {row["scene"]: row for row in json.loads(table.read_text()) + rows}
    rows = [found[name] for name in names if name in found]
table.write_text(json.dumps(rows, indent=1))
if args.reference:
    head = f'{{"mitsuba": "3.9.1", "batches": {args.batches}, "side": {args.side}, "scenes": [\n'
    lines = ",\n".join(json.dumps(reference, separators=(",", ":")) for reference in references)
    args.reference.write_text(head + lines + "\n]}\n")
squares = sum(row["z"] ** 2 for row in rows)
spread = math.sqrt(2.0 / (9.0 * len(rows)))
print(f"{sum(row['agrees'] for row in rows)} of {len(rows)} agree; "
      f"mean square of z {squares / len(rows):.2f} (1 expected, "
      f"{((squares / len(rows)) ** (1 / 3) - 1 + spread**2) / spread:+.1f} deviations)")
