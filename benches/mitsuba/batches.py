"""Renders independent batches of an exported scene with Mitsuba 3 and times them; see README.md.

python batches.py VARIANT SCENE SIDE SPP BATCHES THREADS [OUT] [--compensate] [--roulette DEPTH]

SCENE is a folder as `tauflow scene mitsuba` writes it. OUT gets the batch means, f32 RGB, one after another; standard
output one line of JSON. Compiling kernels is timed apart: a batch with another seed runs before the timed ones.
"""

import argparse
import json
import pathlib
import re
import time

import drjit as dr
import mitsuba as mi
import numpy as np

parser = argparse.ArgumentParser()
parser.add_argument("variant")
parser.add_argument("scene", type=pathlib.Path)
parser.add_argument("side", type=int)
parser.add_argument("spp", type=int)
parser.add_argument("batches", type=int)
parser.add_argument("threads", type=int)
parser.add_argument("out", nargs="?")
parser.add_argument("--compensate", action="store_true")
parser.add_argument("--roulette", type=int)
args = parser.parse_args()

mi.set_variant(args.variant)
if args.variant.startswith("llvm"):
    dr.set_thread_count(args.threads)
mi.set_log_level(mi.LogLevel.Error)

text = (args.scene / "scene.xml").read_text()
text = re.sub(r'(name="(?:width|height)" value=)"\d+"', rf'\1"{args.side}"', text)
text = re.sub(r'(name="sample_count" value=)"\d+"', rf'\1"{args.spp}"', text)
if args.compensate:
    compensated = '<emitter type="envmap"><boolean name="mis_compensation" value="true"/>'
    text = text.replace('<emitter type="envmap">', compensated)
if args.roulette is not None:
    later = rf'\g<0><integer name="rr_depth" value="{args.roulette}"/>'
    text = re.sub(r'<integrator type="\w+">', later, text)
path = args.scene / f"scene-{args.side}-{args.spp}-{args.variant}-{args.compensate}-{args.roulette}.xml"
path.write_text(text)
begun = time.perf_counter()
scene = mi.load_file(str(path), parallel=False)
loaded = time.perf_counter() - begun
path.unlink()


def render(seed):
    image = mi.render(scene, spp=args.spp, seed=seed)
    dr.eval(image)
    dr.sync_thread()
    return image


begun = time.perf_counter()
render(7)
first = time.perf_counter() - begun
seconds, images = [], []
for batch in range(args.batches):
    begun = time.perf_counter()
    image = render(1000 + batch)
    seconds.append(time.perf_counter() - begun)
    if args.out:
        images.append(np.array(image, dtype="<f4")[..., :3])
if args.out:
    pathlib.Path(args.out).write_bytes(np.stack(images).tobytes())
median = sorted(seconds)[len(seconds) // 2]
print(json.dumps({"prepared_s": loaded, "compile_s": max(first - median, 0.0), "seconds": seconds}))
