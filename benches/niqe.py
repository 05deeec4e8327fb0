"""Reference numbers for our NIQE, by the implementation of pyiqa.

    python -m venv .venv
    .venv/bin/pip install torch==2.9.1 numpy scipy && .venv/bin/pip install --no-deps pyiqa==0.1.16
    .venv/bin/python benches/niqe.py

pyiqa is a tool for checking alone: its licence does not allow us to ship any of it. Its package is not imported as a
whole, because its other metrics ask for many more packages. The pictures are made of whole numbers, as in
nodes/eval/src/image_quality/niqe/tests.rs, which holds the printed numbers.
"""

import importlib.util
import sys
import types
from pathlib import Path

import torch


def package():
    """Lets single modules of pyiqa be imported, without what its __init__ files import."""
    root = Path(importlib.util.find_spec("pyiqa").origin).parent
    for name in ("pyiqa", "pyiqa.archs", "pyiqa.utils"):
        module = types.ModuleType(name)
        module.__path__ = [str(root.joinpath(*name.split(".")[1:]))]
        sys.modules[name] = module
    # What NIQE itself does not use.
    stub = {
        "pyiqa.utils.download_util": {"load_file_from_url": None},
        "pyiqa.utils.registry": {"ARCH_REGISTRY": types.SimpleNamespace(register=lambda: lambda of: of)},
        "pyiqa.archs.fsim_arch": {"_construct_filters": None},
        "pyiqa.archs.arch_util": {"get_url_from_name": lambda name: name},
    }
    for name, of in stub.items():
        module = types.ModuleType(name)
        module.__dict__.update(of)
        sys.modules[name] = module
    from pyiqa.archs import niqe_arch

    return niqe_arch


def mixed(a, b):
    """A hash of two whole numbers, of 32 bits."""
    h = (a * 0x9E3779B1 + b * 0x85EBCA77 + 0xC2B2AE3D) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 0x2C1B3C6D) & 0xFFFFFFFF
    return h ^ (h >> 13)


def picture(width, height, seed):
    """Fine and coarse noise over a slope; how much of each differs from place to place."""

    def value(x, y):
        strength = 1 + mixed(x // 96 + seed, y // 96) % 4
        fine = mixed(x + seed, y) % 64 * strength // 4
        coarse = mixed(x // 5 + seed, y // 5) % 128 * (5 - strength) // 4
        return min(255, fine + coarse + (x + y) // 4 % 64)

    rows = [[value(x, y) for x in range(width)] for y in range(height)]
    return torch.tensor(rows, dtype=torch.float64)[None, None]


def main():
    niqe_arch = package()
    for side in (96, 32):
        clean = picture(960, 768, 1000)
        seen = {}

        def nancov(x):
            seen["features"] = x
            return real(x)

        real = niqe_arch.nancov
        niqe_arch.nancov = nancov
        zero, unit = torch.zeros(1, 36).double(), torch.eye(36)[None].double()
        niqe_arch.niqe(clean, zero, unit, side, side)
        niqe_arch.nancov = real
        features = seen["features"]
        mean, covariance = niqe_arch.nanmean(features, dim=1), real(features)
        for seed in (7, 1000):
            value = niqe_arch.niqe(picture(290, 200, seed), mean, covariance, side, side).item()
            print(f"side {side}, seed {seed}: {value:.12g}; first features {features[0, 0, :3].tolist()}")


if __name__ == "__main__":
    main()
