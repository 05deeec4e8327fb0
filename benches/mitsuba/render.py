"""Renders an exported scene with Mitsuba 3 for the node kind `external_renderer`; see README.md.

python render.py SCENE COUNTS REPEATS SEED FOLDER [--variant llvm_ad_rgb]

SCENE is `scene.xml`. FOLDER gets `<count>.exr` for each of the COUNTS, linear radiance. With REPEATS above 0 it also
gets `times.json`: the seconds of so many renders of each, from the scene's files to the image. The path tracer's are
taken alike. Each is after one that has compiled the kernels: in LLVM mode that takes seconds, which are not counted.
Environment maps have MIS compensation, with which Mitsuba is faster.
"""

import argparse
import json
import pathlib
import resource
import time

import drjit as dr
import mitsuba as mi

parser = argparse.ArgumentParser()
parser.add_argument("scene")
parser.add_argument("counts")
parser.add_argument("repeats", type=int)
parser.add_argument("seed", type=int)
parser.add_argument("folder", type=pathlib.Path)
parser.add_argument("--variant", default="llvm_ad_rgb")
args = parser.parse_args()

mi.set_variant(args.variant)
mi.set_log_level(mi.LogLevel.Error)
# Files that the scene names lie beside it.
mi.file_resolver().prepend(str(pathlib.Path(args.scene).resolve().parent))


def cpu():
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def load():
    text = pathlib.Path(args.scene).read_text()
    compensated = '<emitter type="envmap"><boolean name="mis_compensation" value="true"/>'
    changed = text.replace('<emitter type="envmap">', compensated)
    assert compensated in changed or "envmap" not in text, "no compensation: the exporter writes environment maps anew"
    return mi.load_string(changed)


def render(count, seed):
    image = mi.render(load(), spp=count, seed=seed % 2**31)
    dr.eval(image)
    dr.sync_thread()
    return image


counts = [int(count) for count in args.counts.split(",")]
times = {count: {"wall_s": [], "cpu_s": []} for count in counts}
for number, count in enumerate(counts):
    image = render(count, args.seed + 1009 * number)
    # Without the alpha and depth of richer films.
    mi.Bitmap(image[..., :3]).write(str(args.folder / f"{count}.exr"))
# In turns, so that what slows the machine down slows all.
for round_ in range(args.repeats):
    for count in counts:
        wall, processor = time.perf_counter(), cpu()
        render(count, args.seed + round_)
        times[count]["wall_s"].append(time.perf_counter() - wall)
        times[count]["cpu_s"].append(cpu() - processor)
if args.repeats:
    (args.folder / "times.json").write_text(json.dumps(times))
