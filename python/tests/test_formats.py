"""Exports for other programs have the bits of the folder export, also as the real packages read them."""

import io
import json
import subprocess
import tarfile

import numpy as np
import pytest

import tauflow


def export(tiny, folder, node, *words):
    done = subprocess.run(
        [tauflow.program(), *map(str, ["export", tiny.file, node, "-o", folder, "--cache", tiny.cache, *words])],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def packed(tiny, tmp_path_factory):
    return tauflow.open(tiny.export("packed", tmp_path_factory.mktemp("folder")))


def arrays(item):
    """The images of an item as other formats name them."""
    found = {name: image.data for name, image in item.images.items() if name != "gbuffer"}
    return {**found, **{f"gbuffer.{name}": layer for name, layer in item.gbuffer().items()}}


def same(found, wanted):
    assert found.dtype == np.float32 and found.tobytes() == np.ascontiguousarray(wanted).tobytes()


def test_npz(tiny, packed, tmp_path):
    export(tiny, tmp_path, "packed", "--format", "npz")
    for key, item in packed.items():
        with np.load(tmp_path / f"{key}.npz") as file:
            wanted = arrays(item)
            assert set(file.files) == {*wanted, "meta.json"}
            for name, array in wanted.items():
                same(file[name], array)
            assert json.loads(file["meta.json"]) == {**item.meta, "item": key}


def test_safetensors(tiny, packed, tmp_path):
    export(tiny, tmp_path, "packed", "--format", "safetensors")
    from tauflow._safetensors import read

    for key, item in packed.items():
        tensors, notes = read(tmp_path / f"{key}.safetensors")
        wanted = arrays(item)
        assert set(tensors) == set(wanted)
        for name, array in wanted.items():
            same(tensors[name], array)
        assert key in json.dumps(notes)


def test_safetensors_by_its_own_package(tiny, packed, tmp_path):
    package = pytest.importorskip("safetensors.numpy")
    export(tiny, tmp_path, "packed", "--format", "safetensors")
    key, item = next(iter(packed.items()))
    tensors = package.load_file(tmp_path / f"{key}.safetensors")
    for name, array in arrays(item).items():
        same(tensors[name], array)


def test_webdataset_as_tar(tiny, packed, tmp_path):
    export(tiny, tmp_path, "packed", "--format", "webdataset")
    assert [path.name for path in tmp_path.iterdir()] == ["packed-000000.tar"]
    with tarfile.open(tmp_path / "packed-000000.tar") as archive:
        files = {file.name: archive.extractfile(file).read() for file in archive}
    assert len(files) == sum(len(arrays(item)) + 1 for item in packed.values())
    for key, item in packed.items():
        for name, array in arrays(item).items():
            same(np.load(io.BytesIO(files[f"{key}.{name}.npy"])), array)


def test_webdataset_by_its_own_package(tiny, packed, tmp_path):
    package = pytest.importorskip("webdataset")
    export(tiny, tmp_path, "packed", "--format", "webdataset")
    samples = list(package.WebDataset(str(tmp_path / "packed-000000.tar"), shardshuffle=False).decode())
    assert [sample["__key__"] for sample in samples] == list(packed)
    for sample, item in zip(samples, packed.values()):
        for name, array in arrays(item).items():
            same(sample[f"{name}.npy"], array)
        assert sample["meta.json"]["item"] == item.key


def test_oidn(tiny, packed, tmp_path):
    export(tiny, tmp_path, "packed", "--format", "oidn")
    read = lambda name: tauflow.read_layers(str(tmp_path / name))[""]
    for key, item in packed.items():
        layers = item.gbuffer()
        names = {1: f"{key}_0001spp", 4: f"{key}_0004spp", 16: f"{key}_ref"}
        for spp, name in names.items():
            same(read(f"{name}.hdr.exr"), item.rung(spp).data)
            same(read(f"{name}.alb.exr"), layers["albedo"])
            same(read(f"{name}.nrm.exr"), layers["normal"])
        # The toolkit takes the last name of a group as the target.
        assert sorted(names.values())[-1] == names[16]


def test_csv(tiny, tmp_path):
    from tauflow._tables import read_rows

    export(tiny, tmp_path, "scores", "--format", "csv")
    rows = read_rows(str(tmp_path / "scores.csv"))
    wanted = tauflow.open(tiny.export("scores", tmp_path / "folder")).rows()
    assert len(rows) == len(wanted) > 0
    for row, expected in zip(rows, wanted):
        assert row["item"] == expected["item"] and row["from"] == int(expected["from"])
        assert row["hdr_psnr"] == pytest.approx(expected["hdr_psnr"])


def test_parquet(tiny, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    export(tiny, tmp_path, "scores", "--format", "parquet")
    rows = parquet.read_table(str(tmp_path / "scores.parquet")).to_pylist()
    wanted = tauflow.open(tiny.export("scores", tmp_path / "folder")).rows()
    assert len(rows) == len(wanted) > 0
    for row, expected in zip(rows, wanted):
        assert row["item"] == expected["item"] and row["from"] == str(expected["from"])
        assert row["hdr_psnr"] == expected["hdr_psnr"] and isinstance(row["nfe"], int)


def test_one_item(tiny, packed, tmp_path):
    key = list(packed)[1]
    export(tiny, tmp_path / "one", "packed", "--item", key)
    assert list(tauflow.open(tmp_path / "one")) == [key]
    export(tiny, tmp_path / "cells", "held", "--item", key)
    assert sorted(tauflow.open(tmp_path / "cells")) == [f"from=1/{key}", f"from=4/{key}"]
    with pytest.raises(AssertionError, match="has no item .*; did you mean"):
        export(tiny, tmp_path / "none", "packed", "--item", key[:-1] + "x")


@pytest.mark.parametrize("words", [["scores", "--format", "npz"], ["gate.verdicts", "--format", "oidn"]])
def test_a_format_that_does_not_fit(tiny, tmp_path, words):
    with pytest.raises(AssertionError, match="it has no (images|rungs)"):
        export(tiny, tmp_path, *words)
