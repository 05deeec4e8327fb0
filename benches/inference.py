#!/usr/bin/env python3
"""Times of the solver of pipelines/inference.yaml and of Open Image Denoise, beside their quality, as a table.

    TAUFLOW_OIDN=path/to/libOpenImageDenoise.so python3 benches/inference.py \\
        [--profile cpu] [--cache FOLDER] [--results out/inference]

Run it after the pipeline, with the same profile, library and as many cores. Under `taskset -c 0` the times are those of
one core. Times are of inference alone, without rendering or reading: of each image the median of its repeats, of images
median and quartiles. Quality is that of the pipeline's reports. No package is needed.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[1]
PIPELINE = ROOT / "pipelines" / "inference.yaml"
TAUFLOW = ROOT / "target" / "release" / "tauflow"


def times(port, options):
    """Milliseconds of each image, by views, samples and number of calls."""
    found = {}
    with tempfile.TemporaryDirectory() as out:
        command = [TAUFLOW, "export", PIPELINE, port, *options, "-o", out]
        done = subprocess.run([str(word) for word in command], capture_output=True, text=True, cwd=ROOT)
        if done.returncode:
            sys.exit(done.stderr)
        for path in pathlib.Path(out).rglob("value.json"):
            cell = dict(pair.split("=") for pair in path.parent.parent.name.split("+"))
            for entry in json.loads(path.read_text())["entries"]:
                key = (cell.get("mirrors", ""), entry["from_spp"], entry["nfe"])
                found.setdefault(key, []).append(1e3 * statistics.median(entry["took"]["wall_s"]))
    return found


def quality(folder):
    """HDR PSNR, preview PSNR and SSIM by method, views, samples and number of calls."""
    found = {}
    for spp in (1, 4):
        path = pathlib.Path(folder) / f"wide_{spp}" / "results.json"
        if not path.exists():
            sys.exit(f"{path} is missing: run pipelines/inference.yaml first, or name its results with --results")
        for table in (of := json.loads(path.read_text())["evaluation"])["methods"] + of.get("baselines", []):
            for at in table["at"]:
                means = [at["metrics"][name]["mean"] for name in ("hdr_psnr", "preview_psnr", "ssim")]
                found[(table["method"], table["cell"].get("mirrors", ""), spp, at["nfe"])] = means
    return found


def main():
    parse = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parse.add_argument("--profile", default="cpu")
    parse.add_argument("--cache")
    parse.add_argument("--results", default=ROOT / "out" / "inference")
    args = parse.parse_args()
    options = ["--profile", args.profile] + (["--cache", args.cache] if args.cache else [])
    good = quality(args.results)
    cores = len(os.sched_getaffinity(0))
    print(f"| method | spp | inference, {cores} core{'s' * (cores > 1)} | HDR PSNR | preview PSNR | SSIM |")
    print("|---|---:|---:|---:|---:|---:|")
    rows = []
    for method, port in (("mc_noise", "wide_timed.timing"), ("oidn", "wide_oidn.timing")):
        for (views, spp, nfe), of in times(port, options).items():
            rows.append((spp, method, int(views or 0), nfe, views, of))
    for spp, method, _, nfe, views, of in sorted(rows):
        low, middle, high = statistics.quantiles(of, n=4)
        hdr, preview, ssim = good[(method, views, spp, nfe)]
        name = f"{method}, NFE {nfe}, {views} view{'s' * (views != '1')}" if views else method
        taken = f"{middle:.0f} ms ({low:.0f} to {high:.0f})"
        print(f"| {name} | {spp} | {taken} | {hdr:.2f} | {preview:.2f} | {ssim:.3f} |")


main()
