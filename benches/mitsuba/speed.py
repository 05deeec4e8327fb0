"""Time to equal error of both renderers on the scenes of FOLDER; see README.md.

python speed.py FOLDER [--scenes N] [--side 128] [--cores 1|2] [--late] [--compensate] [--variant llvm_ad_rgb]

The error is the root of the mean square error over pixels and channels against a held-out reference: the mean of all of
the other renderer's batches, whose own variance is subtracted. Time to the error that Mitsuba has at 64 and at 512
samples per pixel: its own render, and ours with as many samples as that error takes. Errors are measured at the first
number of samples and follow 1/sqrt(n). Ours is timed before and after Mitsuba's.
--late gives ours the Russian roulette of Mitsuba; --compensate gives Mitsuba's environment maps MIS compensation.
"""

import argparse
import json
import math
import pathlib
import statistics

import both

parser = argparse.ArgumentParser()
parser.add_argument("folder", type=pathlib.Path)
parser.add_argument("--scenes", type=int, default=1)
parser.add_argument("--side", type=int, default=128)
parser.add_argument("--cores", type=int, default=2)
parser.add_argument("--batches", type=int, default=12)
parser.add_argument("--spp", type=int, nargs="+", default=[64, 512])
parser.add_argument("--variant", default="llvm_ad_rgb")
parser.add_argument("--late", action="store_true")
parser.add_argument("--compensate", action="store_true")
args = parser.parse_args()


def errors(a, b):
    """Mean square errors of single batches of a and of b, each against the mean of the other."""
    square = ((a.mean(0) - b.mean(0)) ** 2).mean()
    own = [x.var(0, ddof=1).mean() for x in (a, b)]
    n = len(a)
    # E |a_i - mean b|^2 = var a + var b / n + bias^2, and the square of the difference of the means is known too.
    bias = max(square - (own[0] + own[1]) / n, 0.0)
    return own[0] + bias, own[1] + bias


rows = []
how, options = (["late"] if args.late else []), (["--compensate"] if args.compensate else [])
for name in both.scenes(args.folder, args.scenes):
    for spp in args.spp:
        batches = max(args.batches * 64 // spp, 2) if spp > 64 else args.batches
        ours_report, a = both.ours(args.folder, name, args.side, spp, batches, args.cores, *how)
        report, b = both.mitsuba(args.folder, name, args.side, spp, batches, args.cores, args.variant, *options)
        again, _ = both.ours(args.folder, name, args.side, spp, batches, args.cores, *how)
        own, other = statistics.median(ours_report["seconds"] + again["seconds"]), statistics.median(report["seconds"])
        if spp == args.spp[0]:
            mine, theirs = errors(a, b)
        # The law of large numbers: as many samples as make our error theirs.
        ratio = mine / theirs
        row = {
            "scene": name, "spp": spp, "ours_s": own, "theirs_s": other, "compile_s": report["compile_s"],
            "ours_mb": ours_report["peak_mb"], "theirs_mb": report["peak_mb"],
            "variance": 1 / ratio, "rays": other / own, "speedup": other / (own * ratio),
        }
        rows.append(row)
        print(
            f"{name:24s} {spp:4d} spp: ours {own:7.3f} s, theirs {other:7.3f} s "
            f"(compiling {report['compile_s']:.2f} s), "
            f"same samples {row['rays']:.2f}x, variance {row['variance']:.2f}x, same error {row['speedup']:.2f}x, "
            f"memory {row['ours_mb']:.0f} and {row['theirs_mb']:.0f} MB",
            flush=True,
        )
strata = {}
for row in rows:
    strata.setdefault(both.stratum(row["scene"]), []).append(math.log(row["speedup"]))
means = {stratum: math.exp(statistics.mean(values)) for stratum, values in strata.items()}
for stratum, value in means.items():
    print(f"{stratum:16s} {value:.2f}x")
mean = math.exp(statistics.mean(math.log(v) for v in means.values()))
print(f"geometric mean {mean:.2f}x, least {min(means.values()):.2f}x")
(args.folder / "speed.json").write_text(json.dumps({"rows": rows, "strata": means}, indent=1))
