"""A trained solver on Mitsuba's images: `tauflow refine` of renders that our renderer never saw.

python refine.py MODEL SCENE [SCENE ...] [--from-spp 4] [--nfe 1] [--tauflow target/release/tauflow]

MODEL is a model file of training (`tauflow export PIPELINE solvers.model -o DIR`), SCENE a `scene.xml` of `tauflow scene mitsuba`.
Each scene is rendered with so few samples, and with 32 for albedo and shading normals in the camera's frame, which go along as
layers of one EXR; a model without G-buffers leaves them aside. Prints PSNR of exposed linear radiance, before and after, against 4,096
samples of another seed.
"""

import argparse
import pathlib
import subprocess
import tempfile

import mitsuba as mi
import numpy as np

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("model")
parser.add_argument("scenes", nargs="+")
parser.add_argument("--from-spp", type=int, default=4)
parser.add_argument("--nfe", type=int, default=1)
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


gains = []
print("| scene | before | after |\n|---|---:|---:|")
for file in args.scenes:
    scene = mi.load_file(file)
    noisy = colours(mi.render(scene, spp=args.from_spp, seed=1))
    reference = colours(mi.render(scene, spp=4096, seed=2))
    luminance = reference @ np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
    factor = 0.18 / np.exp(np.mean(np.log(np.maximum(luminance, 1e-6))))
    names = ["R", "G", "B"] + [f"albedo.{c}" for c in "RGB"] + [f"normal.{c}" for c in "XYZ"]
    layers = np.concatenate([noisy, features(scene)], axis=-1)
    with tempfile.TemporaryDirectory() as folder:
        before, after = pathlib.Path(folder, "before.exr"), pathlib.Path(folder, "after.exr")
        mi.Bitmap(layers, mi.Bitmap.PixelFormat.MultiChannel, names).write(str(before))
        command = [args.tauflow, "refine", args.model, before, "--from-spp", args.from_spp, "--nfe", args.nfe, "-o", after]
        subprocess.run([str(word) for word in command], check=True, capture_output=True)
        refined = colours(mi.Bitmap(str(after)))
    found = [psnr(image, reference, factor) for image in (noisy, refined)]
    gains.append(found[1] - found[0])
    print(f"| {pathlib.Path(file).parent.name} | {found[0]:.2f} | {found[1]:.2f} |", flush=True)
print(f"\n{len(gains)} scenes, gain {np.mean(gains):.2f} dB on average, least {min(gains):.2f}")
