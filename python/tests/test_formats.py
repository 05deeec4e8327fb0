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
    found = {name: image.data for name, image in item.images.items()}
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


def decoded(color, exposure):
    """Radiance of RGBE bytes, as noisebase decodes them."""
    exponent = np.exp((color[3].astype(np.float64) + 1) / 256 * (exposure[1] - exposure[0]) + exposure[0])
    return color[:3] / 255 * exponent


def test_noisebase(tiny, tmp_path):
    zarr = pytest.importorskip("zarr")
    store = getattr(zarr, "ZipStore", None) or zarr.storage.ZipStore
    export(tiny, tmp_path, "ladders", "--format", "noisebase", "--samples", 4)
    ladders = tauflow.open(tiny.export("ladders", tmp_path / "folder"))
    rows = (tmp_path / "scenes.csv").read_text().split()[1:]
    assert len(rows) == len(ladders) > 0 and "samples: 4" in (tmp_path / "noisebase.yaml").read_text()
    for row in rows:
        name, key = row.split(",")
        data = zarr.open_group(store=store(str(tmp_path / name), mode="r"), mode="r")
        color = decoded(np.asarray(data["color"][0]), np.asarray(data["exposure"][0]))
        height, width = color.shape[1:3]
        # The mean of the samples is the rung; bytes have an error of a few steps.
        rung = ladders[key].rung(4).data.transpose(2, 0, 1)
        top = np.maximum(color.max(axis=(0, 3)), 1e-6)
        assert np.abs(color.mean(axis=3) - rung).max() <= (top / 255 * 1.5).max()
        reference = np.asarray(data["reference"][0])
        assert np.array_equal(reference, ladders[key].rung(16).data.transpose(2, 0, 1))
        # A position is seen in its own pixel.
        position = np.asarray(data["position"][0]).astype(np.float64)
        matrix = np.asarray(data["view_proj_mat"][0]).astype(np.float64)
        seen = np.einsum("ij,ihws->jhws", matrix, np.concatenate([position, np.ones_like(position[:1])]))
        x = (seen[0] / seen[3] + 1) * width / 2
        y = (1 - seen[1] / seen[3]) * height / 2
        assert np.all((x - np.arange(width)[None, :, None] > -0.1) & (x - np.arange(width)[None, :, None] < 1.1))
        assert np.all((y - np.arange(height)[:, None, None] > -0.1) & (y - np.arange(height)[:, None, None] < 1.1))
        length = np.linalg.norm(np.asarray(data["normal"][0]).astype(np.float64), axis=0)
        assert np.all((length < 1e-3) | (np.abs(length - 1) < 2e-3))
        assert np.asarray(data["crop_offset"]).shape == (1, 2) and not np.asarray(data["motion"]).any()


def test_noisebase_needs_ladders(tiny, tmp_path):
    with pytest.raises(AssertionError, match="renders the samples of ladders, and `packed` renders none"):
        export(tiny, tmp_path, "packed", "--format", "noisebase")


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
