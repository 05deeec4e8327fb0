"""A trained solver on Mitsuba's images: `tauflow refine` of renders that our renderer never saw.

python refine.py MODEL SCENE [SCENE ...] [--from-spp 4] [--to-spp N] [--nfe 1] [--mirrors 1]
    [--tauflow target/release/tauflow]

MODEL is a model file of training (`tauflow export PIPELINE solvers.model -o DIR`). SCENE is a `scene.xml` of `tauflow
scene mitsuba`. Each scene is rendered with so few samples, and with 32 for albedo and shading normals in the camera's
frame. These go along as layers of one EXR; a model without G-buffers leaves them aside.

Prints PSNR of exposed linear radiance, before and after, against `--reference` samples of another seed, with a 95%
interval of the mean gain over scenes. With `--to-spp`, where the refinement ends, a render of so many samples stands
beside it.
"""

import argparse
import pathlib
import subprocess
import sys
import tempfile

import mitsuba as mi
import numpy as np

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("model")
parser.add_argument("scenes", nargs="+")
parser.add_argument("--from-spp", type=int, default=4)
parser.add_argument("--to-spp", type=int)
parser.add_argument("--nfe", type=int, default=1)
parser.add_argument("--mirrors", type=int, default=1)
parser.add_argument("--reference", type=int, default=4096)
parser.add_argument("--tauflow", default="target/release/tauflow")
parser.add_argument("--variant", default="llvm_ad_rgb")
args = parser.parse_args()
mi.set_variant(args.variant)
mi.set_log_level(mi.LogLevel.Error)


def colours(image):
    return np.array(image, dtype=np.float32)[..., :3]


def features(scene):
    """Albedo, and normals to the right, up and towards the camera [H, W, 6]."""
    aov = mi.load_dict({"type": "aov", "aovs": "albedo:albedo,normal:sh_normal"})
    values = np.array(mi.render(scene, integrator=aov, spp=32, seed=7), dtype=np.float32)[..., -6:]
    axes = np.array(scene.sensors()[0].world_transform().matrix, dtype=np.float32).reshape(4, 4)[:3, :3]
    # Mitsuba's cameras look along +z, with x to the left.
    frame = axes / np.linalg.norm(axes, axis=0) * np.array([-1.0, 1.0, -1.0], dtype=np.float32)
    return np.concatenate([values[..., :3], values[..., 3:] @ frame], axis=-1)


def psnr(image, reference, factor):
    square = np.mean((factor * (np.maximum(image, 0.0) - reference)) ** 2)
    return -10.0 * np.log10(square)


rows = []
rendered = f" a render of {args.to_spp} spp |" if args.to_spp else ""
print(f"| scene | before | after |{rendered}\n|---|---:|---:|{'---:|' if rendered else ''}")
for file in args.scenes:
    scene = mi.load_file(file)
    noisy = colours(mi.render(scene, spp=args.from_spp, seed=1))
    # More at once take too much memory.
    parts = max(1, args.reference // 4096)
    renders = [colours(mi.render(scene, spp=args.reference // parts, seed=2 + i)) for i in range(parts)]
    reference = np.mean(renders, axis=0)
    luminance = reference @ np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
    factor = 0.18 / np.exp(np.mean(np.log(np.maximum(luminance, 1e-6))))
    names = ["R", "G", "B"] + [f"albedo.{c}" for c in "RGB"] + [f"normal.{c}" for c in "XYZ"]
    layers = np.concatenate([noisy, features(scene)], axis=-1)
    with tempfile.TemporaryDirectory() as folder:
        before, after = pathlib.Path(folder, "before.exr"), pathlib.Path(folder, "after.exr")
        mi.Bitmap(layers, mi.Bitmap.PixelFormat.MultiChannel, names).write(str(before))
        command = [args.tauflow, "refine", args.model, before, "-o", after]
        command += ["--from-spp", args.from_spp, "--nfe", args.nfe, "--mirrors", args.mirrors]
        command += ["--to-spp", args.to_spp] if args.to_spp else []
        done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
        if done.returncode:
            sys.exit(done.stderr)
        refined = colours(mi.Bitmap(str(after)))
    found = [psnr(image, reference, factor) for image in (noisy, refined)]
    if args.to_spp:
        found.append(psnr(colours(mi.render(scene, spp=args.to_spp, seed=100)), reference, factor))
    rows.append(found)
    print(f"| {pathlib.Path(file).parent.name} | {' | '.join(f'{value:.2f}' for value in found)} |", flush=True)
rows = np.array(rows)
gains = rows[:, 1] - rows[:, 0]
draws = np.random.default_rng(1).integers(len(gains), size=(2000, len(gains)))
low, high = np.quantile(gains[draws].mean(axis=1), [0.025, 0.975])
print(f"\n{len(gains)} scenes, means {', '.join(f'{mean:.2f}' for mean in rows.mean(axis=0))} dB; "
      f"gain {gains.mean():.2f} dB "
      f"[{low:.2f}, {high:.2f}], least {gains.min():.2f}")
