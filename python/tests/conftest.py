"""A tiny run of the real command, made once."""

import subprocess

import pytest

import tauflow

PIPELINE = """\
pipeline: tiny
seed: 3
values: { rungs: [1, 4, 16] }
profiles: { short: { values.rungs: [1, 4, 8] } }
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 12, regimes: [L0], contexts: [open, enclosed] }
  previews:
    kind: ladder_rendering
    inputs: { scenes: scenes }
    params: { rungs: [16], resolution: [64, 64] }
  gate:
    kind: quality_gate
    inputs: { scenes: scenes, previews: previews }
  ladders:
    kind: ladder_rendering
    inputs: { scenes: gate.accepted }
    params: { rungs: $rungs, resolution: [24, 16], gbuffer_samples: 4 }
  packed:
    kind: dataset_packing
    inputs: { ladders: ladders, gbuffers: ladders.gbuffer, exposure: gate.exposure }
  held:
    kind: guided_filter
    matrix: { from: [1, 4] }
    inputs: { endpoints: packed }
  scores:
    kind: image_metrics
    matrix: { like: held }
    inputs: { images: held, references: packed }
  table:
    kind: table
    inputs: { scores: scores }
    params: { metrics: [hdr_psnr, ssim], columns: [spp] }
"""


class Tiny:
    def __init__(self, folder, *words):
        self.folder, self.file = folder, folder / "tiny.yaml"
        self.cache, self.out = folder / "cache", folder / "out"
        self.file.write_text(PIPELINE)
        self.run(*words)

    def run(self, *words):
        words = ["run", self.file, "--cache", self.cache, "--out", self.out, *words]
        done = subprocess.run([tauflow.program(), *map(str, words)], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr

    def export(self, node, folder):
        words = ["export", self.file, node, "-o", folder, "--cache", self.cache]
        done = subprocess.run([tauflow.program(), *map(str, words)], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return folder


@pytest.fixture(scope="session")
def tiny(tmp_path_factory):
    return Tiny(tmp_path_factory.mktemp("tiny"))
