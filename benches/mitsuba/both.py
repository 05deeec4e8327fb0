"""Runs both renderers on an exported scene; what agree.py, files.py and speed.py share."""

import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import threading

import numpy as np

HERE = pathlib.Path(__file__).parent
BINS = 8
ROUNDING = 2e-5
normal = statistics.NormalDist()


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
    """Standard output, read as JSON, of a command on so many cores, with the memory at its peak in MB."""
    pinned = ["taskset", "-c", ",".join(str(core) for core in range(cores))]
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        child = subprocess.Popen(pinned + [str(part) for part in command], stdout=out, stderr=err)
        limit = threading.Timer(1800, child.kill)
        limit.start()
        _, status, usage = os.wait4(child.pid, 0)
        limit.cancel()
        child.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        if child.returncode:
            sys.exit(f"{command}: {err.read()[-2000:]}")
        return {**json.loads(out.read().strip().splitlines()[-1]), "peak_mb": usage.ru_maxrss / 1024}


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


def limit(count):
    """Deviation that one of so many tests exceeds by chance with 1%."""
    return -normal.inv_cdf(0.5 * (1.0 - 0.99 ** (1.0 / count)))


def deviation(a, b):
    """Welch's statistic over batches, as the deviation of a normal distribution, and the standard error."""
    n = len(a)
    va, vb = a.var(0, ddof=1) / n, b.var(0, ddof=1) / n
    # Both work in single precision: what differs by less than that leaves over thousands of operations is no bias.
    error = np.sqrt(va + vb + (ROUNDING * (np.abs(a.mean(0)) + np.abs(b.mean(0))) / 2) ** 2)
    difference = a.mean(0) - b.mean(0)
    t = np.where(error > 0, difference / np.where(error > 0, error, 1), np.where(difference == 0, 0, np.inf))
    # Where neither varies, what differs beyond rounding is certain.
    freedom = np.where(va + vb > 0, (va + vb) ** 2 / np.maximum((va**2 + vb**2) / (n - 1), 1e-300), 1e9)
    # Cornish and Fisher: from t to a normal deviate.
    return np.sign(t) * np.sqrt(freedom * np.log1p(t * t / freedom)) * (1 - 3 / (4 * freedom)), error


def binned(images):
    """Means over 8 x 8 bins of each batch."""
    batches, side = images.shape[:2]
    cell = side // BINS
    return images.mean(-1).reshape(batches, BINS, cell, BINS, cell).mean((2, 4))
