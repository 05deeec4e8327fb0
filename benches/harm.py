#!/usr/bin/env python3
"""Does denoising hurt? Reads out/denoiser_test/harm_table/items.csv and prints, for each number of samples, the ratio
of each image's mean squared error, without the noise of its reference, to the smaller one of the noisy and the
denoised image: geometric mean, 95th percentile and the worst scene.

python3 benches/harm.py [out/denoiser_test/harm_table/items.csv]
"""

import csv
import math
import sys


def main():
    path = sys.argv[1] if len(sys.argv) > 1 else "out/denoiser_test/harm_table/items.csv"
    scores = {}
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            scores.setdefault((int(row["from"]), row["item"]), {})[row["method"]] = float(row["hdr_psnr"])
    methods = sorted({method for found in scores.values() for method in found})
    print("| samples | " + " | ".join(methods) + " |")
    print("|---" * (len(methods) + 1) + "|")
    for count in sorted({count for count, _ in scores}):
        cells = []
        for method in methods:
            ratios = []
            for (of, item), found in scores.items():
                if of == count:
                    # PSNR is -10 log10 of the mean squared error.
                    better = max(found["input"], found["denoised"])
                    ratios.append((10 ** ((better - found[method]) / 10), item))
            ratios.sort()
            mean = math.exp(sum(math.log(ratio) for ratio, _ in ratios) / len(ratios))
            # The nearest rank.
            high = ratios[math.ceil(0.95 * len(ratios)) - 1][0]
            cells.append(f"{mean:.3f}, {high:.3f}, {ratios[-1][0]:.2f} ({ratios[-1][1]})")
        print(f"| {count} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
