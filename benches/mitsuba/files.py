"""Whether scenes that are read from Mitsuba's and pbrt's files have the images that Mitsuba gives them; see README.md.

python files.py TAUFLOW [--batches 16] [--spp 256] [--side 64] [--variant llvm_ad_rgb] [--only NAME ...]
                [--reference FILE]

TAUFLOW is the program. Each scene of `files/` is rendered by Mitsuba from its XML, and by us from the XML, and from the
pbrt file of the same name where there is one. A scene's seed is made from its file, so a comment makes it another one.
Pixels are means over their squares on both sides. The tests and their limits are those of agree.py, with one for each
channel of the image mean. --reference writes Mitsuba's means and standard errors of the bins; the test
tests/pipelines/scene_files.rs reads them from tests/pipelines/scene_files.json.
"""

import argparse
import contextlib
import json
import pathlib
import re
import subprocess
import tempfile

import mitsuba as mi
import numpy as np

from both import BINS, binned, deviation, limit

HERE = pathlib.Path(__file__).parent / "files"
parser = argparse.ArgumentParser()
parser.add_argument("tauflow", type=pathlib.Path)
parser.add_argument("--batches", type=int, default=16)
parser.add_argument("--spp", type=int, default=256)
parser.add_argument("--side", type=int, default=64)
parser.add_argument("--variant", default="llvm_ad_rgb")
parser.add_argument("--only", nargs="*", metavar="NAME")
parser.add_argument("--reference", type=pathlib.Path, metavar="FILE")
args = parser.parse_args()
mi.set_variant(args.variant)
mi.set_log_level(mi.LogLevel.Error)


@contextlib.contextmanager
def beside(path, text, mark=""):
    """A copy of a file with another text, in the same folder, where the files that it names are found."""
    copy = path.with_name(f".{mark}{path.name}")
    copy.write_text(text)
    try:
        yield copy
    finally:
        copy.unlink()


def ours(path):
    """Batches of our image of a file, each with a seed of its own."""
    comment = "# {}\n" if path.suffix == ".pbrt" else "<!-- {} -->\n"
    images = []
    for batch in range(args.batches):
        with (
            beside(path, path.read_text() + comment.format(batch), f"{batch}-") as copy,
            tempfile.TemporaryDirectory() as folder,
        ):
            out = pathlib.Path(folder) / "image.exr"
            size = ["--width", args.side, "--height", args.side, "--spp", args.spp]
            command = [str(part) for part in (args.tauflow, "render", copy, *size, "-o", out)]
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode:
                raise SystemExit(f"{command}: {done.stderr}")
            images.append(np.array(mi.Bitmap(str(out)))[..., :3])
    return np.stack(images).astype(np.float64)


def theirs(path):
    """Batches of Mitsuba's image of a file, with a box filter whatever it asks for."""
    with beside(path, re.sub(r'<rfilter type="\w+"', '<rfilter type="box"', path.read_text())) as copy:
        scene = mi.load_file(str(copy), resx=args.side, resy=args.side)
    images = [np.array(mi.render(scene, spp=args.spp, seed=1000 + b))[..., :3] for b in range(args.batches)]
    return np.stack(images).astype(np.float64)


names = args.only or sorted(path.stem for path in HERE.glob("*.xml"))
files = [HERE / f"{name}{ending}" for name in names for ending in (".xml", ".pbrt")]
files = [path for path in files if path.exists()]
bins_limit, mean_limit = limit(len(files) * BINS * BINS), limit(3 * len(files))
print(f"{len(files)} files; limits {mean_limit:.2f} for means, {bins_limit:.2f} for bins\n")
print("| file | Mitsuba's red, green, blue | ours beside it | z of each | would have been found | worst bin | |")
print("|---|---|---|---|---:|---:|---|")
references, agree = {}, 0
for path in files:
    if path.stem not in references:
        references[path.stem] = theirs(HERE / f"{path.stem}.xml")
    a, b = ours(path), references[path.stem]
    z, error = deviation(a.mean((1, 2)), b.mean((1, 2)))
    mean = b.mean((0, 1, 2))
    worst = float(np.abs(deviation(binned(a), binned(b))[0]).max())
    fine = np.abs(z).max() < mean_limit and worst < bins_limit
    agree += fine
    means = ", ".join(f"{v:.4f}" for v in mean)
    ratios = ", ".join(f"{100 * v:+.3f}%" for v in a.mean((0, 1, 2)) / mean - 1)
    print(
        f"| {path.name} | {means} | {ratios} | {', '.join(f'{v:+.2f}' for v in z)} | "
        f"{100 * ((mean_limit + 0.84) * error / mean).max():.2f}% | {worst:.2f} | {'agrees' if fine else 'DIFFERS'} |",
        flush=True,
    )
print(f"{agree} of {len(files)} agree")
if args.reference:
    scenes = []
    for name, images in references.items():
        bins = binned(images).reshape(args.batches, -1)
        errors = bins.std(0, ddof=1) / args.batches**0.5
        means = [float(f"{v:.7g}") for v in bins.mean(0)]
        scenes.append({"scene": name, "means": means, "errors": [float(f"{v:.3g}") for v in errors]})
    written = {"mitsuba": mi.__version__, "batches": args.batches, "side": args.side, "scenes": scenes}
    args.reference.write_text(json.dumps(written, indent=1) + "\n")
