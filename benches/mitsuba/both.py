"""Runs both renderers on an exported scene; what agree.py and speed.py share."""

import json
import os
import pathlib
import subprocess
import sys
import tempfile

import numpy as np

HERE = pathlib.Path(__file__).parent


def scenes(folder, most=3):
    """Names of the scenes, at most so many a stratum."""
    found = {}
    for path in sorted((folder / "ours").iterdir()):
        found.setdefault(stratum(path.name), []).append(path.name)
    return [name for names in found.values() for name in names[:most]]


def stratum(name):
    """L1-open of L1-open-000001."""
    return name.rsplit("-", 1)[0]


def run(command, cores):
    """Standard output, read as JSON, of a command on so many cores."""
    pinned = ["taskset", "-c", ",".join(str(core) for core in range(cores))]
    done = subprocess.run(pinned + [str(part) for part in command], capture_output=True, text=True, timeout=1800)
    if done.returncode:
        sys.exit(f"{command}: {done.stderr[-2000:]}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def ours(folder, scene, side, spp, batches, cores=2, *how):
    """Our report and batch means, shape (batches, side, side, 3)."""
    with tempfile.NamedTemporaryFile() as out:
        command = [folder / "batches", folder / "ours" / scene, side, spp, batches, cores, out.name, *how]
        return run(command, cores), read(out.name, batches, side)


def mitsuba(folder, scene, side, spp, batches, cores=2, variant="llvm_ad_rgb", *how):
    """Mitsuba's report and batch means. On one core it gets two threads: with one its scheduler waits for ever."""
    with tempfile.NamedTemporaryFile() as out:
        script = [sys.executable, HERE / "batches.py", variant, folder / "mitsuba" / scene, side, spp, batches, 2]
        return run([*script, out.name, *how], cores), read(out.name, batches, side)


def read(name, batches, side):
    return np.fromfile(name, "<f4").reshape(batches, side, side, 3).astype(np.float64)
