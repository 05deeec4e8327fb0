"""Direct light of an exported scene by Mitsuba, found by sampling lights and by sampling BSDFs; see README.md.

python direct.py SCENE [--batches 16] [--lights 256] [--bsdfs 1536] [--side 64]

SCENE is a folder as `tauflow scene mitsuba` writes it. Both ways have the same expectation: if their means differ, an
image that differs from tauflow's is no evidence against tauflow. Prints means of the image and their standard errors.
"""

import argparse
import pathlib
import re

import mitsuba as mi
import numpy as np

parser = argparse.ArgumentParser()
parser.add_argument("scene", type=pathlib.Path)
parser.add_argument("--batches", type=int, default=16)
parser.add_argument("--lights", type=int, default=256, help="samples per pixel and batch")
parser.add_argument("--bsdfs", type=int, default=1536, help="samples per pixel and batch")
parser.add_argument("--side", type=int, default=64)
parser.add_argument("--variant", default="llvm_ad_rgb")
args = parser.parse_args()
mi.set_variant(args.variant)
mi.set_log_level(mi.LogLevel.Error)
mi.file_resolver().prepend(str(args.scene.resolve()))
text = (args.scene / "scene.xml").read_text()
text = re.sub(r'(name="(?:width|height)" value=)"\d+"', rf'\1"{args.side}"', text)
for name, counts, spp in [("lights", (1, 0), args.lights), ("BSDFs", (0, 1), args.bsdfs)]:
    samples = zip(("emitter_samples", "bsdf_samples"), counts)
    params = "".join(f'<integer name="{param}" value="{count}"/>' for param, count in samples)
    direct = f'<integrator type="direct">{params}</integrator>'
    scene = mi.load_string(re.sub(r"<integrator.*?</integrator>", direct, text, flags=re.DOTALL))
    means = [np.array(mi.render(scene, spp=spp, seed=seed))[..., :3].mean() for seed in range(args.batches)]
    print(f"by {name}: {np.mean(means):.5f} +- {np.std(means, ddof=1) / args.batches**0.5:.5f}", flush=True)
