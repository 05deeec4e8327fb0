#!/usr/bin/env python3
"""Compares FLIP, HDR-FLIP, MS-SSIM and LPIPS with published implementations, on renders of this project.

    python3 -m venv .venv
    .venv/bin/pip install torch torchvision flip-evaluator==1.7 pytorch-msssim==1.0.0 lpips==0.1.4 safetensors
    .venv/bin/python benches/metrics.py target/release/tauflow [FOLDER]

It renders scenes of 192 x 176 pixels, filters them, and scores noisy and filtered images with the kinds `image_metrics`
and `lpips`. The Python packages score the same images. It prints the largest differences and the time of each metric
per image, of a run with one job. LPIPS has random weights, which are drawn here and saved as the files that the kind
reads. The script fails beyond a difference of 1e-4, which is relative for LPIPS.
"""

import csv
import json
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import flip_evaluator
import lpips
import numpy as np
import torch
from pytorch_msssim import ms_ssim
from safetensors.torch import save_file

LIMIT = 1e-4
METRICS = ["ms_ssim", "flip", "hdr_flip", "lpips"]

PIPELINE = """\
pipeline: metrics
seed: 11
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 16 }
  previews:
    kind: ladder_rendering
    inputs: { scenes: scenes }
    params: { rungs: [32], resolution: [64, 64] }
  gate:
    kind: quality_gate
    inputs: { scenes: scenes, previews: previews }
  ladders:
    kind: ladder_rendering
    inputs: { scenes: gate.accepted }
    params: { rungs: [1, 4, 16, 256], resolution: [192, 176] }
  packed:
    kind: dataset_packing
    inputs: { ladders: ladders, gbuffers: ladders.gbuffer, exposure: gate.exposure }
  filtered:
    kind: guided_filter
    matrix: { from: [1, 4, 16] }
    inputs: { endpoints: packed }
  weights:
    kind: lpips_weights
    params: { trunk: "FOLDER/trunk.safetensors", lin: "FOLDER/lin.safetensors" }
  hold:
    kind: image_metrics
    matrix: { from: [1, 4, 16] }
    inputs: { references: packed }
    params: { also: [ms_ssim, flip, hdr_flip] }
  hold_judged:
    kind: lpips
    matrix: { like: hold }
    inputs: { scores: hold, references: packed, weights: weights }
  filtered_judged:
    kind: lpips
    matrix: { like: filtered }
    inputs: { scores: with_all, images: filtered, references: packed, weights: weights }
"""

# The same scores with no, one and all metrics on request: the differences of their times are those of the metrics.
SCORED = """\
  with_NAME:
    kind: image_metrics
    matrix: { like: filtered }
    inputs: { images: filtered, references: packed }
    params: { also: [ALSO] }
"""
REQUESTS = {"none": "", "ms_ssim": "ms_ssim", "flip": "flip", "hdr_flip": "hdr_flip", "all": "ms_ssim, flip, hdr_flip"}


def tauflow(program, *words):
    done = subprocess.run([program, *map(str, words)], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(done.stderr)


def network(folder):
    """LPIPS with random weights, which are also saved under their published names."""
    torch.manual_seed(5)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        net = lpips.LPIPS(net="alex", version="0.1", pretrained=False, pnet_rand=True, verbose=False).eval()
    lins = [getattr(net, f"lin{layer}").model[1].weight for layer in range(5)]
    for weights in lins:
        weights.data.uniform_(0.0, 0.5)
    # The package names the layers of torchvision's `features` by slices.
    trunk = {"features." + name.split(".", 1)[1]: value.contiguous() for name, value in net.net.state_dict().items()}
    save_file(trunk, folder / "trunk.safetensors")
    lin = {f"lin{layer}.model.1.weight": weights.data.contiguous() for layer, weights in enumerate(lins)}
    save_file(lin, folder / "lin.safetensors")
    return net


def preview(radiance):
    positive = np.maximum(radiance, 0.0).astype(np.float64)
    return np.clip((positive / (1.0 + positive)) ** (1 / 2.2), 0.0, 1.0).astype(np.float32)


def theirs(net, image, reference):
    """The metrics of the packages, and the seconds that each took."""
    shown = [preview(image), preview(reference)]
    planes = [torch.from_numpy(picture).permute(2, 0, 1)[None] for picture in shown]

    def of_ms_ssim():
        return ms_ssim(planes[0].double(), planes[1].double(), data_range=1.0).item()

    def of_flip():
        return flip_evaluator.evaluate(shown[1], shown[0], "LDR", inputsRGB=True, applyMagma=False)[1]

    def of_hdr_flip():
        pair = [np.maximum(picture, 0.0) for picture in (reference, image)]
        return flip_evaluator.evaluate(*pair, "HDR", applyMagma=False)[1]

    def of_lpips():
        with torch.no_grad():
            return net(2 * planes[0] - 1, 2 * planes[1] - 1).item()

    found = {}
    for name, of in zip(METRICS, [of_ms_ssim, of_flip, of_hdr_flip, of_lpips]):
        start = time.perf_counter()
        found[name] = of(), time.perf_counter() - start
    return found


def scores(file):
    """Rows of an export by scene and samples per pixel."""
    with open(file, newline="") as text:
        return {(row["item"], int(row["from_spp"])): row for row in csv.DictReader(text)}


def only(arrays):
    names = [name for name in arrays.files if not name.startswith("meta")]
    assert len(names) == 1, names
    return arrays[names[0]]


def main():
    torch.set_num_threads(1)
    program = sys.argv[1]
    holder = tempfile.TemporaryDirectory()
    folder = Path(sys.argv[2] if len(sys.argv) > 2 else holder.name).absolute()
    folder.mkdir(parents=True, exist_ok=True)
    net = network(folder)
    text = PIPELINE.replace("FOLDER", str(folder))
    text += "".join(SCORED.replace("NAME", name).replace("ALSO", also) for name, also in REQUESTS.items())
    file, cache = folder / "metrics.yaml", ["--cache", folder / "cache"]
    file.write_text(text)
    tauflow(program, "run", file, *cache, "--out", folder / "out", "--jobs", 1)
    for node, form in [("packed", "npz"), ("filtered", "npz"), ("hold_judged", "csv"), ("filtered_judged", "csv")]:
        tauflow(program, "export", file, node, "-o", folder / node, *cache, "--format", form)

    off = {name: 0.0 for name in METRICS}
    values = {name: [] for name in METRICS}
    taken = {name: 0.0 for name in METRICS}
    for node in ("hold", "filtered"):
        for (scene, spp), row in sorted(scores(folder / f"{node}_judged" / f"{node}_judged.csv").items()):
            packed = np.load(folder / "packed" / f"{scene}.npz")
            reference, image = packed["spp-000256"], packed[f"spp-{spp:06}"]
            if node == "filtered":
                image = only(np.load(folder / "filtered" / f"from={spp}" / f"{scene}.npz"))
            for name, (value, seconds) in theirs(net, image, reference).items():
                difference = abs(float(row[name]) - value)
                off[name] = max(off[name], difference / value if name == "lpips" else difference)
                values[name].append(value)
                taken[name] += seconds

    run = json.loads((folder / "out" / "metrics" / "run.json").read_text())
    wall = {node["node"]: node["wall_s"] for node in run["nodes"]}
    count, filtered = len(values["flip"]), len(values["flip"]) // 2
    ours = {name: (wall[f"with_{name}"] - wall["with_none"]) / filtered for name in METRICS[:3]}
    ours["lpips"] = wall["filtered_judged"] / filtered
    print(f"{count} images; the basic metrics take {1e3 * wall['with_none'] / filtered:.1f} ms an image")
    print("| metric | range | largest difference | ms per image | ms of the package |\n|---|---|---|---|---|")
    for name in METRICS:
        low, high = min(values[name]), max(values[name])
        print(
            f"| `{name}` | {low:.3f} to {high:.3f} | {off[name]:.1e} | {1e3 * ours[name]:.1f} | "
            f"{1e3 * taken[name] / count:.1f} |"
        )
    if max(off.values()) > LIMIT:
        sys.exit(f"a difference is above {LIMIT}")


main()
