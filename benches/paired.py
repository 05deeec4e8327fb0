#!/usr/bin/env python3
"""Two cells of a report against each other, scene by scene, with 95% bootstrap intervals over scenes.

    python3 benches/paired.py out/ablations/per_scene.csv "output means" "output values" --metric hdr_psnr

The cells are words of the column `cell` (for instance `rung_exponent 1.0`). Rows that agree in method, conditioning and
the rest of their cell are taken for a pair, for each number of calls. No package is needed.
"""

import argparse
import collections
import csv
import random
import sys


def interval(gains, resamples, seed):
    """Mean, and the middle 95% of the means of as many scenes drawn with replacement."""
    draw = random.Random(seed)
    means = sorted(sum(draw.choices(gains, k=len(gains))) / len(gains) for _ in range(resamples))
    return sum(gains) / len(gains), means[int(0.025 * resamples)], means[int(0.975 * resamples) - 1]


def main():
    parse = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parse.add_argument("table", help="per_scene.csv of a report")
    parse.add_argument("one", help="words of a cell")
    parse.add_argument("other", help="words of the cell that is taken from it")
    parse.add_argument("--metric", default="hdr_psnr")
    parse.add_argument("--resamples", type=int, default=2000)
    args = parse.parse_args()
    if args.resamples < 100:
        sys.exit("--resamples takes 100 and more: fewer have no 95% interval")

    sides = [collections.defaultdict(dict), collections.defaultdict(dict)]
    with open(args.table, newline="") as table:
        rows = csv.DictReader(table)
        if args.metric not in (rows.fieldnames or []):
            sys.exit(f"{args.table} has no column {args.metric}; it has {', '.join(rows.fieldnames or [])}")
        for row in rows:
            words = row["cell"].split(", ")
            for side, word in zip(sides, (args.one, args.other)):
                if word in words:
                    rest = ", ".join(w for w in words if w != word)
                    key = (row["method"], row["conditioning"], rest, row["from_spp"], int(row["nfe"]))
                    if row[args.metric]:
                        side[key][row["scene"]] = float(row[args.metric])
    pairs = [key for key in sides[0] if key in sides[1]]
    if not pairs:
        sys.exit(f"no rows of `{args.one}` and `{args.other}` make pairs in {args.table}")
    print(f"{args.metric}: {args.one} over {args.other}")
    for key in pairs:
        one, other = sides[0][key], sides[1][key]
        gains = [one[scene] - other[scene] for scene in sorted(one.keys() & other.keys())]
        mean, low, high = interval(gains, args.resamples, 1)
        method, conditioning, rest, start, calls = key
        name = " ".join(filter(None, [method, conditioning, rest]))
        print(f"{name}, from {start} spp, NFE {calls}: {mean:+.4g} [{low:.4g}, {high:.4g}], {len(gains)} scenes")


if __name__ == "__main__":
    main()
