"""Damaged files, other versions and missing parts: an error names the file or item, and what to do."""

import json
import shutil

import pytest

import tauflow
from tauflow import TauflowError


@pytest.fixture
def export(tiny, tmp_path):
    return tiny.export("packed", tmp_path / "packed")


def first(folder):
    return next(iter(tauflow.open(folder).values()))


def edited(folder, change):
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))


def test_half_of_a_manifest(export):
    path = export / "manifest.json"
    path.write_text(path.read_text()[:40])
    with pytest.raises(TauflowError, match=r"manifest\.json: .*; export the node again"):
        tauflow.open(export)


@pytest.mark.parametrize(
    "change",
    [
        lambda manifest: manifest.pop("items"),
        lambda manifest: manifest["items"][0].pop("item"),
        lambda manifest: manifest.update(items=[3]),
        lambda manifest: manifest.update(items=None),
    ],
)
def test_a_manifest_of_another_shape(export, change):
    edited(export, change)
    with pytest.raises(TauflowError, match=r"manifest\.json: this is no manifest of an export; export it again"):
        tauflow.open(export)


def test_a_missing_file(export):
    item = first(export)
    name = f"spp-{item.rungs[0]:06}.exr"
    (export / item.key / name).unlink()
    with pytest.raises(TauflowError, match=rf"{name}: the file is missing; export"):
        first(export).rung(item.rungs[0])


@pytest.mark.parametrize("size", [0, 3, 30, 300])
def test_a_file_that_ends_early(export, size):
    item = first(export)
    path = export / item.key / f"spp-{item.rungs[0]:06}.exr"
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(TauflowError, match=path.name):
        first(export).rung(item.rungs[0])


def test_metadata_that_is_no_json(export):
    item = first(export)
    (export / item.key / "meta.json").write_text("{")
    with pytest.raises(TauflowError, match=r"meta\.json: .*; export the node again"):
        first(export).rung(item.rungs[0])


def test_an_unknown_folder(tmp_path):
    with pytest.raises(TauflowError, match="nowhere"):
        tauflow.open(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(TauflowError, match="empty"):
        tauflow.open(tmp_path / "empty")


def test_a_missing_item_and_a_missing_rung(export):
    node = tauflow.open(export)
    item = first(export)
    with pytest.raises(TauflowError, match="did you mean"):
        node[item.key[:-1] + "x"]
    with pytest.raises(TauflowError, match=r"has no rung of 5 samples; its rungs: 1, 4, 16"):
        item.rung(5)


def test_a_program_that_is_missing(export, monkeypatch, tiny):
    monkeypatch.setenv("TAUFLOW", str(export / "no-such-program"))
    with pytest.raises(TauflowError, match="no-such-program"):
        tauflow.open(tiny.file, cache=str(tiny.cache))["packed"]


def test_a_node_that_is_not_up_to_date(tiny, tmp_path):
    file = tmp_path / "tiny.yaml"
    shutil.copy(tiny.file, file)
    file.write_text(file.read_text().replace("seed: 3", "seed: 4"))
    with pytest.raises(TauflowError, match="run"):
        tauflow.open(file, cache=str(tiny.cache))["packed"]
