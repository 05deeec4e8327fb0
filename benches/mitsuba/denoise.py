#!/usr/bin/env python3
"""The bundled denoiser and Open Image Denoise on Mitsuba's own renders of Mitsuba's Cornell box, or of other scenes.

    PYTHONPATH=python python3 benches/mitsuba/denoise.py [SCENE.xml ...] [--seeds 8] [--size 256]

Without scenes it renders the Cornell box. Films of scene files should have a box filter. Each scene is rendered with 1,
4, 16 and 64 samples per pixel and each seed; albedo and shading normals have 16 samples. The reference is the mean of
renders with other seeds. OIDN has its high quality, and prefiltered albedo and normals that it then takes as
noise-free. `tauflow denoise` is told neither the sample count nor the exposure.

Prints the mean PSNR of exposed linear radiance, of previews, and of previews more than three pixels from lamps, and
paired differences with 95% intervals over scenes and seeds.

Needs NumPy, Mitsuba 3, pyoidn 2.5, and `tauflow` in target/release.
"""

import argparse
import os
import pathlib
import sys

REPOSITORY = pathlib.Path(__file__).resolve().parents[2]
os.environ.setdefault("TAUFLOW", str(REPOSITORY / "target" / "release" / "tauflow"))

import mitsuba as mi
import numpy as np
import pyoidn

import tauflow

COUNTS = [1, 4, 16, 64]
# Exposed radiance of lamps that are seen; mid grey is 0.18.
LAMP = 20.0
METHODS = ["noisy", "best, G-buffer", "OIDN, G-buffer", "best, RGB", "OIDN, RGB"]


def colours(image):
    return np.ascontiguousarray(np.array(image, dtype=np.float32)[..., :3])


def features(scene, seed):
    """Albedo, and shading normals in world space, each [H, W, 3]."""
    aov = mi.load_dict({"type": "aov", "aovs": "albedo:albedo,normal:sh_normal"})
    values = np.array(mi.render(scene, integrator=aov, spp=16, seed=seed), dtype=np.float32)[..., -6:]
    return np.ascontiguousarray(values[..., :3]), np.ascontiguousarray(values[..., 3:])


def prefiltered(device, name, image):
    """A feature that OIDN has denoised on its own."""
    out = np.empty_like(image)
    work = pyoidn.Filter(device, "RT")
    work.set_image(name, image, pyoidn.OIDN_FORMAT_FLOAT3)
    work.set_image(pyoidn.OIDN_IMAGE_OUTPUT, out, pyoidn.OIDN_FORMAT_FLOAT3)
    work.set_quality(pyoidn.OIDN_QUALITY_HIGH)
    work.commit()
    work.execute()
    error = device.get_error()
    if error:
        sys.exit(f"OIDN: {error}")
    work.release()
    return out


def preview(values):
    mapped = np.maximum(values, 0.0)
    return (mapped / (1.0 + mapped)) ** (1.0 / 2.2)


def psnrs(image, reference, factor):
    """In dB: HDR PSNR with a peak of 1, preview PSNR, and preview PSNR more than three pixels from lamps."""
    image, reference = factor * np.maximum(image, 0.0).astype(np.float64), factor * reference.astype(np.float64)
    lamps = np.pad(reference.max(axis=-1) > LAMP, 3)
    far = ~np.lib.stride_tricks.sliding_window_view(lamps, (7, 7)).any(axis=(-1, -2))
    shown, expected = preview(image), preview(reference)
    pairs = [(image, reference), (shown, expected), (shown[far], expected[far])]
    return [-10.0 * np.log10(np.mean((a - b) ** 2)) for a, b in pairs]


def interval(values):
    draws = np.random.default_rng(1).integers(len(values), size=(4000, len(values)))
    low, high = np.quantile(values[draws].mean(axis=1), [0.025, 0.975])
    return f"{values.mean():+.2f} [{low:.2f}, {high:.2f}]"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*")
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--reference", type=int, default=8192)
    parser.add_argument("--weights", default="best")
    parser.add_argument("--variant", default="llvm_ad_rgb")
    args = parser.parse_args()
    mi.set_variant(args.variant)
    mi.set_log_level(mi.LogLevel.Error)
    device = pyoidn.Device()
    device.commit()

    def cornell_box():
        box = mi.cornell_box()
        film = box["sensor"]["film"]
        film["width"] = film["height"] = args.size
        # Wider filters share samples between pixels. Both denoisers expect pixels of independent noise.
        film["rfilter"] = {"type": "box"}
        return mi.load_dict(box)

    scenes = [mi.load_file(file) for file in args.scenes] or [cornell_box()]
    found = {count: [] for count in COUNTS}
    for scene in scenes:
        # More samples at once take too much memory.
        parts = max(1, args.reference // 512)
        renders = (colours(mi.render(scene, spp=args.reference // parts, seed=10_000 + i)) for i in range(parts))
        reference = sum(render.astype(np.float64) for render in renders) / parts
        luminance = reference @ np.array([0.2126, 0.7152, 0.0722])
        factor = 0.18 / np.exp(np.mean(np.log(np.maximum(luminance, 1e-6))))
        camera = np.array(scene.sensors()[0].world_transform().matrix, dtype=np.float32).reshape(4, 4)[:3, :3]
        # Mitsuba's cameras look along +z, with x to the left.
        axes = camera / np.linalg.norm(camera, axis=0) * np.array([-1.0, 1.0, -1.0], dtype=np.float32)
        for seed in range(args.seeds):
            albedo, normal = features(scene, 1000 + seed)
            clean = [prefiltered(device, name, image) for name, image in (("albedo", albedo), ("normal", normal))]
            in_camera = np.ascontiguousarray(normal @ axes)
            for count in COUNTS:
                noisy = colours(mi.render(scene, spp=count, seed=seed))
                images = [
                    noisy,
                    tauflow.denoise(noisy, albedo, in_camera, normals="camera", weights=args.weights),
                    pyoidn.denoise(noisy, *clean, hdr=True, clean_aux=True),
                    tauflow.denoise(noisy, weights=args.weights),
                    pyoidn.denoise(noisy, hdr=True),
                ]
                found[count].append([psnrs(image, reference, factor) for image in images])
    for which, name in enumerate(["HDR PSNR", "preview PSNR", "preview PSNR apart from lamps"]):
        heads = METHODS + ["difference, G-buffer", "difference, RGB"]
        print(f"\n| {name}: spp | {' | '.join(heads)} |\n|---:|{'---:|' * len(heads)}")
        for count in COUNTS:
            values = np.array(found[count])[..., which]
            means = [f"{mean:.2f}" for mean in values.mean(axis=0)]
            differences = [interval(values[:, 1] - values[:, 2]), interval(values[:, 3] - values[:, 4])]
            print(f"| {count} | {' | '.join(means + differences)} |")


main()
