#!/usr/bin/env python3
"""Draws the first picture of the README: test scenes as a path tracer leaves them, denoised, and the reference.

    cargo run --release -- run pipelines/denoiser_test.yaml --target huge_table
    python3 benches/showcase.py docs/showcase.jpg

It exports the films of 512 x 512 pixels of `pipelines/denoiser_test.yaml` and measures the time of both denoisers,
which must run on an idle machine. It shows all scenes of regimes L0 and L1: the reference of 256 samples per pixel is
clean there. Captions are preview PSNR, and the times of `denoiser_times.py` on all cores. OIDN denoises its G-buffers
first, as its manual recommends. It needs Pillow, and `tauflow` in target/release.
"""

import argparse
import csv
import glob
import os
import subprocess
import tempfile

from PIL import Image, ImageDraw, ImageFont

from denoiser_times import times

REPOSITORY = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
PIPELINE = "pipelines/denoiser_test.yaml"
SCENES = ["L0-enclosed-000000", "L1-enclosed-000001", "L1-environment-000000"]
CELL = "[from=4,conditioning=gbuffer]"
OURS, OIDN = "method=tauflow_best+conditioning=gbuffer", "method=oidn_prefiltered"
CAPTION, GAP = 38, 6


def tauflow(*words, cache):
    subprocess.run(
        [os.environ.get("TAUFLOW", "target/release/tauflow"), *words, "--cache", cache],
        cwd=REPOSITORY, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def picture(folder, node, scene, name):
    found = sorted(glob.glob(os.path.join(folder, node, "**", scene, name), recursive=True))
    return Image.open(found[-1]).convert("RGB")


def scores(folder):
    """Preview PSNR by method and scene."""
    with open(os.path.join(folder, "huge_table", "items.csv"), newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["from"] == "4" and row["conditioning"] == "gbuffer"]
    return {(row["method"], row["item"].rsplit("/", 1)[-1]): float(row["preview_psnr"]) for row in rows}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out")
    parser.add_argument("--cache", default="cache")
    parser.add_argument("--results", default="out/denoiser_test", help="where the run wrote huge_table/items.csv")
    options = parser.parse_args()
    cache = os.path.abspath(options.cache)
    with tempfile.TemporaryDirectory() as folder:
        for node in ["huge_best", "huge_oidn"]:
            tauflow("export", PIPELINE, node + CELL, "-o", os.path.join(folder, node), cache=cache)
        for node in ["huge_set", "huge_references"]:
            tauflow("export", PIPELINE, node, "-o", os.path.join(folder, node), cache=cache)
        psnr, seconds = scores(options.results), times(cache)
        columns = [
            ("4 spp", "huge_set", "spp-000004.png", None),
            (f"tauflow, {seconds[OURS]:.1f} s", "huge_best", "*.png", "tauflow_best"),
            (f"OIDN 2.5, {seconds[OIDN]:.1f} s", "huge_oidn", "*.png", "oidn"),
            ("256 spp", "huge_references", "spp-*.png", None),
        ]
        pictures = [[picture(folder, node, scene, name) for _, node, name, _ in columns] for scene in SCENES]
    side = pictures[0][0].width
    font = ImageFont.load_default(26)
    sheet = Image.new("RGB", (len(columns) * (side + GAP) - GAP, CAPTION + len(SCENES) * (side + GAP) - GAP), "white")
    draw = ImageDraw.Draw(sheet)
    for x, (label, *_) in enumerate(columns):
        draw.text((x * (side + GAP) + side // 2, CAPTION // 2), label, "black", font=font, anchor="mm")
    for y, (scene, row) in enumerate(zip(SCENES, pictures)):
        for x, (image, (_, _, _, method)) in enumerate(zip(row, columns)):
            left, top = x * (side + GAP), CAPTION + y * (side + GAP)
            sheet.paste(image, (left, top))
            if method:
                text = f"{psnr[method, scene]:.1f} dB"
                box = draw.textbbox((left + 10, top + side - 10), text, font=font, anchor="ls")
                draw.rectangle((box[0] - 6, box[1] - 6, box[2] + 6, box[3] + 6), fill="black")
                draw.text((left + 10, top + side - 10), text, "white", font=font, anchor="ls")
    sheet.save(options.out, quality=88)
    print(options.out, sheet.size, os.path.getsize(options.out))


if __name__ == "__main__":
    main()
