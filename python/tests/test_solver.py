"""A trained solver in PyTorch gives the images of `tauflow refine`."""

import subprocess

import numpy as np
import pytest

import tauflow
from tauflow import TauflowError

torch = pytest.importorskip("torch")

import tauflow.torch  # noqa: E402

PIPELINE = """\
pipeline: learned
seed: 5
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 4, regimes: [L0], contexts: [open] }
  ladders:
    kind: ladder_rendering
    inputs: { scenes: scenes }
    params: { rungs: [1, 4, 16], resolution: [30, 20], gbuffer_samples: 4 }
  gate:
    kind: quality_gate
    inputs: { scenes: scenes, previews: ladders }
  packed:
    kind: dataset_packing
    inputs: { ladders: ladders, gbuffers: ladders.gbuffer, exposure: gate.exposure }
  solvers:
    kind: training
    matrix: { parameterization: [vanilla_rf, local_velocity, mc_velocity, mc_noise], conditioning: [rgb, gbuffer] }
    inputs: { train: packed, test: packed }
    params: { preset: tiny, steps: 2, batch: 2, crop: 16, space: log1p }
  local:
    kind: training
    matrix: { conditioning: [rgb, gbuffer] }
    inputs: { train: packed }
    params: { preset: fast, steps: 2, batch: 2, crop: 16, space: log1p, output: shaded_means, unknown_counts: 0.5 }
  plain:
    kind: training
    matrix:
      parameterization: [vanilla_rf, mc_noise]
      conditioning: [rgb, gbuffer]
      space: [linear, log1p]
      output: [values, means]
    inputs: { train: packed }
    params: { preset: tiny, steps: 2, batch: 2, crop: 16, features: plain }
  older:
    kind: training
    matrix: { parameterization: [vanilla_rf, local_velocity] }
    inputs: { train: packed }
    params: { preset: tiny, steps: 2, batch: 2, crop: 16, conditioning: rgb, law: limits }
  rounded:
    kind: model_rounding
    matrix: { coarse: [half, integers] }
    inputs: { model: "local[conditioning=gbuffer].model" }
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("learned")
    (folder / "learned.yaml").write_text(PIPELINE)

    def command(*words):
        done = subprocess.run([tauflow.program(), *map(str, words)], cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr

    targets = [word for node in ["solvers", "local", "plain", "older", "rounded"] for word in ("--target", node)]
    command("run", "learned.yaml", "--cache", "cache", *targets)
    command("checkpoints", "learned.yaml", "--cache", "cache", "-o", "models")
    command("export", "learned.yaml", "packed", "--cache", "cache", "-o", "packed")
    command("export", "learned.yaml", "rounded", "--cache", "cache", "-o", "rounded")
    return folder, command


@pytest.mark.parametrize("conditioning", ["rgb", "gbuffer"])
@pytest.mark.parametrize("parameterization", ["vanilla_rf", "local_velocity", "mc_velocity", "mc_noise"])
def test_images_are_those_of_refine(place, parameterization, conditioning):
    folder, command = place
    cell = f"parameterization={parameterization}+conditioning={conditioning}"
    model = next(path for path in folder.glob("models/solvers*/**/model.safetensors") if cell in str(path))
    solver = tauflow.torch.load(model)
    assert solver.counts == [1, 4, 16]
    item = next(iter(tauflow.open(folder / "packed").values()))
    layers = item.gbuffer()
    gbuffer = np.concatenate([layers["albedo"], layers["normal"]], axis=-1) if conditioning == "gbuffer" else None
    image = item.rung(1)
    for nfe, to in [(1, None), (3, None), (2, 4)]:
        words = ["--gbuffer", item.path("gbuffer.exr")] if gbuffer is not None else []
        words += ["--to-spp", to] if to else []
        command("refine", model, image.path, "--from-spp", 1, "--nfe", nfe, "-o", "out.exr", *words)
        expected = tauflow.read_layers(str(folder / "out.exr"))[""]
        found = solver.refine(image, 1, gbuffer=gbuffer, nfe=nfe, to_spp=to)
        assert found.shape == expected.shape and expected.max() > 0
        assert np.abs(found - expected).max() <= 1e-4 * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("conditioning", ["rgb", "gbuffer"])
def test_unknown_counts_are_those_of_refine(place, conditioning):
    folder, command = place
    models = folder.glob("models/local*/**/model.safetensors")
    model = next(path for path in models if f"conditioning={conditioning}" in str(path))
    solver, item = tauflow.torch.load(model), next(iter(tauflow.open(folder / "packed").values()))
    layers = item.gbuffer()
    gbuffer = np.concatenate([layers["albedo"], layers["normal"]], axis=-1) if conditioning == "gbuffer" else None
    image = item.rung(1)
    words = ["--gbuffer", item.path("gbuffer.exr")] if gbuffer is not None else []
    for told in [["--from-spp", 4], []]:
        command("refine", model, image.path, "-o", "out.exr", *words, *told)
        expected = tauflow.read_layers(str(folder / "out.exr"))[""]
        found = solver.refine(image, *told[1:], gbuffer=gbuffer)
        assert np.abs(found - expected).max() <= 1e-4 * max(1.0, np.abs(expected).max())
    with pytest.raises(TauflowError, match="needs `from_spp`"):
        solver.refine(image, gbuffer=gbuffer, nfe=2)


def same_as_refine(place, model):
    folder, command = place
    solver, item = tauflow.torch.load(model), next(iter(tauflow.open(folder / "packed").values()))
    layers, image = item.gbuffer(), item.rung(1)
    gbuffer = None
    if solver.info["conditioning"] == "gbuffer":
        gbuffer = np.concatenate([layers["albedo"], layers["normal"]], axis=-1)
    words = ["--gbuffer", item.path("gbuffer.exr")] if gbuffer is not None else []
    for nfe in [1, 3]:
        command("refine", model, image.path, "--from-spp", 1, "--nfe", nfe, "-o", "out.exr", *words)
        expected = tauflow.read_layers(str(folder / "out.exr"))[""]
        found = solver.refine(image, 1, gbuffer=gbuffer, nfe=nfe)
        assert np.abs(found - expected).max() <= 1e-4 * max(1.0, np.abs(expected).max())
    return solver


@pytest.mark.parametrize("coarse", ["half", "integers"])
def test_rounded_models_are_those_of_refine(place, coarse):
    model, = place[0].glob(f"rounded/**/coarse={coarse}*/**/model.safetensors")
    same_as_refine(place, model)


def test_plain_features_and_earlier_laws_are_those_of_refine(place):
    folder, _ = place
    plain = sorted(folder.glob("models/plain*/**/model.safetensors"))
    older = sorted(folder.glob("models/older*/**/model.safetensors"))
    assert (len(plain), len(older)) == (16, 2)
    for model in plain:
        info = same_as_refine(place, model).info
        exact = info["parameterization"] == "vanilla_rf" and info.get("output", "means") == "means"
        assert (info["features"], info.get("law")) == ("plain", "covariances" if exact else None)
    for model in older:
        assert "law" not in same_as_refine(place, model).info


def test_a_model_of_a_later_version_is_told(place, tmp_path):
    folder, _ = place
    content = next(folder.glob("models/plain*/**/model.safetensors")).read_bytes()
    (tmp_path / "later.safetensors").write_bytes(content.replace(b"plain", b"fancy"))
    with pytest.raises(TauflowError, match="later.safetensors: the model has `features: fancy`"):
        tauflow.torch.load(tmp_path / "later.safetensors")


def test_what_does_not_fit_is_told(place, tmp_path):
    folder, _ = place
    models = folder.glob("models/solvers*/**/model.safetensors")
    model = next(path for path in models if "conditioning=gbuffer" in str(path))
    solver, image = tauflow.torch.load(model), np.ones((8, 8, 3), np.float32)
    with pytest.raises(TauflowError, match="pass `gbuffer`"):
        solver.refine(image, 1)
    features = np.ones((8, 8, 6), np.float32)
    for words in [dict(from_spp=16), dict(from_spp=1, to_spp=17), dict(from_spp=1, nfe=0), dict(from_spp=0)]:
        with pytest.raises(TauflowError, match="from 1 to 16 spp"):
            solver.refine(image, gbuffer=features, **words)
    with pytest.raises(TauflowError, match="must be told the sample count"):
        solver.refine(image, gbuffer=features)
    with pytest.raises(TauflowError, match=r"it must be \[height, width, 3\]"):
        solver.refine(image[0], 1, gbuffer=features)
    with pytest.raises(TauflowError, match="not finite"):
        solver.refine(image * np.nan, 1, gbuffer=features)
    content = model.read_bytes()
    for size in [0, 4, 100, len(content) - 1]:
        (tmp_path / "cut.safetensors").write_bytes(content[:size])
        with pytest.raises(TauflowError, match="cut.safetensors"):
            tauflow.torch.load(tmp_path / "cut.safetensors")
    with pytest.raises(TauflowError, match="nothing.safetensors: No such file"):
        tauflow.torch.load(tmp_path / "nothing.safetensors")
