"""Exports, folders of results and pipelines of a real run."""

import json
import shutil

import numpy as np
import pytest

import tauflow
from conftest import Tiny


def test_a_pipeline_is_read_node_by_node(tiny):
    results = tauflow.open(tiny.file, cache=tiny.cache)
    ladders = results["ladders"]
    assert 6 <= len(ladders) <= 12, "most scenes pass the gate"
    assert ladders.port == "ladder"
    key = next(iter(ladders))
    item = ladders[key]
    assert item.rungs == [1, 4, 16] and item.axes == {} and item.scene == key
    image = item.rung(16)
    assert image.shape == (16, 24, 3) and image.space == tauflow.RAW and image.raw() is image
    assert np.asarray(image).dtype == np.float32 and np.asarray(image, dtype=np.float64).dtype == np.float64
    assert item.variance().shape == (16, 24, 3)
    preview = image.preview()
    assert preview.min() >= 0.0 and preview.max() < 1.0
    packed = results["packed"][key]
    gbuffer = packed.gbuffer()
    assert {name: layer.shape for name, layer in gbuffer.items()} == {"albedo": (16, 24, 3), "normal": (16, 24, 3)}
    with pytest.raises(tauflow.TauflowError, match="no rung of 2 samples; its rungs: 1, 4, 16"):
        packed.rung(2)
    with pytest.raises(tauflow.TauflowError, match="there is no node `laders`"):
        results["laders"]
    with pytest.raises(tauflow.TauflowError, match=f"no item `x{key}`; did you mean `{key}`"):
        ladders["x" + key]


def test_cells_are_axes(tiny):
    held = tauflow.open(tiny.file, cache=tiny.cache)["held"]
    scene = next(iter(held)).rsplit("/", 1)[-1]
    assert len(held) == 2 * len(tauflow.open(tiny.file, cache=tiny.cache)["ladders"])
    with pytest.raises(tauflow.TauflowError, match="in 2 cells; name one, such as `from="):
        held[scene]
    assert held[f"from=4/{scene}"].axes == {"from": "4"}
    (name, image), = held[f"from=4/{scene}"].images.items()
    assert image.shape == (16, 24, 3), name


def test_scores_are_rows_and_frames(tiny):
    pandas = pytest.importorskip("pandas")
    scores = tauflow.open(tiny.file, cache=tiny.cache)["scores"]
    rows = scores.rows()
    assert len(rows) == len(scores) and {row["from"] for row in rows} == {"1", "4"}
    frame = scores.frame()
    assert isinstance(frame, pandas.DataFrame) and len(frame) == len(rows)
    assert frame["from"].dtype.kind == "i" and frame["hdr_psnr"].dtype.kind == "f"
    means = frame.groupby("from")["hdr_psnr"].mean()
    assert means[4] > means[1], "four samples are nearer to the reference"
    # The table of the run says the same.
    results = tauflow.open(tiny.out / "tiny", cache=tiny.cache)
    table = results.frame("items")
    found = table.groupby("spp")["hdr_psnr"].mean()
    assert abs(found[4] - means[4]) < 1e-9 and abs(found[1] - means[1]) < 1e-9


def test_a_folder_of_results_leads_to_its_nodes(tiny):
    results = tauflow.open(tiny.out / "tiny", cache=tiny.cache)
    assert results.name == "tiny" and "table.csv" in results.files and "ladders" in list(results)
    assert set(results["ladders"]) == set(tauflow.open(tiny.file, cache=tiny.cache)["ladders"])
    with pytest.raises(tauflow.TauflowError, match="no file `tables`|no file `tables.csv`"):
        results.rows("tables")


def test_results_in_folders_are_found(tiny, tmp_path):
    # Each node that publishes has a folder of its own as soon as there are two.
    folder = tmp_path / "tiny"
    shutil.copytree(tiny.out / "tiny", folder)
    for node in ("page", "sheet"):
        (folder / node).mkdir()
        (folder / node / "seen.html").write_text(node)
    (folder / "page" / "own.csv").write_text("a\n1\n")
    results = tauflow.open(folder, cache=tiny.cache)
    assert {"table.csv", "page/own.csv", "sheet/seen.html"} <= set(results.files)
    assert results.rows("own") == results.rows("page/own") == [{"a": 1}]
    with pytest.raises(tauflow.TauflowError, match="in several folders; name one of page/seen.html, sheet/seen.html"):
        results.path("seen.html")


def test_what_is_not_there_is_none(tiny):
    ladders = tauflow.open(tiny.file, cache=tiny.cache)["ladders"]
    assert ladders.get("nothing") is None and ladders.get("nothing", 3) == 3 and ladders.get(0) is None
    cache = tauflow.open(tiny.cache)
    assert cache.get("other") is None and cache.get("tiny") is not None


def test_results_are_those_of_the_run_that_wrote_them(tmp_path):
    first = Tiny(tmp_path)
    old = tmp_path / "old"
    first.out.rename(old)
    # A later run of the same pipeline writes elsewhere; its folder is newer, and its images are smaller.
    first.run("--set", "ladders.resolution=[16, 12]")

    def sizes(out):
        ladders = tauflow.open(out / "tiny", cache=first.cache)["ladders"]
        return {item.rung(4).shape for item in ladders.values()}

    assert (sizes(old), sizes(first.out)) == ({(16, 24, 3)}, {(12, 16, 3)})
    # A run that finds everything done writes the same folder again, and is then the one that counts.
    first.run()
    assert sizes(first.out) == {(16, 24, 3)}


def test_a_table_is_a_frame_and_cells_that_are_empty_are_no_numbers(tiny):
    pytest.importorskip("pandas")
    table = tauflow.open(tiny.file, cache=tiny.cache)["table"]
    frame = table.frame()
    assert len(frame) == len(table.rows()) > 0 and frame["mean"].dtype.kind == "f"
    typed = tauflow._tables.typed([{"gain": "1.5", "name": ""}, {"gain": "", "name": "x"}])
    assert typed["gain"].mean() == 1.5 and list(typed["name"]) == ["", "x"]
    with pytest.raises(TypeError, match="not iterable"):
        list(tauflow.open(tiny.file, cache=tiny.cache))


def test_results_have_the_profile_and_the_overrides_of_their_run(tmp_path):
    # The size is an override: with the defaults of the file, no ladder would be up to date.
    run = Tiny(tmp_path, "--profile", "short", "--set", "ladders.resolution=[16, 16]", "--target", "ladders")
    ladders = tauflow.open(run.out / "tiny", cache=run.cache)["ladders"]
    item = ladders[next(iter(ladders))]
    assert item.rungs == [1, 4, 8] and item.rung(8).shape == (16, 16, 3)


def test_raw_radiance_is_the_ladder(tiny):
    ladders = tauflow.open(tiny.file, cache=tiny.cache)["ladders"]
    packed = tauflow.open(tiny.file, cache=tiny.cache, raw=True)["packed"]
    for key in ladders:
        assert np.allclose(packed[key].rung(4).raw().data, ladders[key].rung(4).data, rtol=1e-5)


def test_an_export_is_read_and_its_damage_told(tiny, tmp_path):
    folder = tiny.export("packed", tmp_path / "packed")
    node = tauflow.open(folder)
    key = next(iter(node))
    assert node[key].rung(1).shape == (16, 24, 3) and key in node and "nothing" not in node
    file = folder / key / "spp-000001.exr"
    whole = file.read_bytes()
    file.write_bytes(whole[:200])
    with pytest.raises(tauflow.TauflowError, match="spp-000001.exr"):
        node[key].rung(1)
    file.unlink()
    with pytest.raises(tauflow.TauflowError, match="spp-000001.exr: the file is missing; export it again"):
        node[key].rung(1)
    (folder / key / "meta.json").write_text("{")
    with pytest.raises(tauflow.TauflowError, match="meta.json"):
        node[key].rung(4)
    for text in ["", "[]", "{}", json.dumps({"items": [{}]})]:
        (folder / "manifest.json").write_text(text)
        with pytest.raises(tauflow.TauflowError, match="manifest.json"):
            tauflow.open(folder)
    shutil.rmtree(folder)
    with pytest.raises(tauflow.TauflowError, match="no such file or folder"):
        tauflow.open(folder)
    folder.mkdir()
    with pytest.raises(tauflow.TauflowError, match="neither an export"):
        tauflow.open(folder)


def test_what_is_stale_names_the_command(tiny, tmp_path):
    other = tmp_path / "tiny.yaml"
    other.write_text(tiny.file.read_text().replace("rungs: [1, 4, 16]", "rungs: [1, 4, 9]"))
    command = "Command: tauflow run .*tiny.yaml --cache .* --target ladders"
    with pytest.raises(tauflow.TauflowError, match=f"run the pipeline.*{command}"):
        tauflow.open(other, cache=tiny.cache)["ladders"]


def test_a_cache_has_the_pipelines_that_ran_in_it(tiny, tmp_path):
    cache = tauflow.open(tiny.cache)
    assert isinstance(cache, tauflow.Cache) and list(cache) == ["tiny"] and "tiny" in cache and "other" not in cache
    assert cache.runs["tiny"]["outcome"] == "done"
    ladders = cache["tiny"]["ladders"]
    assert set(ladders) == set(tauflow.open(tiny.file, cache=tiny.cache)["ladders"])
    assert ladders[next(iter(ladders))].rung(4).shape == (16, 24, 3)
    with pytest.raises(tauflow.TauflowError, match="no run of `other` is recorded in this cache; it has tiny"):
        cache["other"]
    # What is lost is made again; what is stale names the command.
    copy = tmp_path / "cache"
    shutil.copytree(tiny.cache, copy)
    shutil.rmtree(copy / "blobs")
    again = tauflow.open(copy)["tiny"]["ladders"]
    assert [again[key].digest for key in again] == [ladders[key].digest for key in ladders]


def test_images_are_datasets_of_xarray(tiny):
    xarray = pytest.importorskip("xarray")
    packed = tauflow.open(tiny.file, cache=tiny.cache)["packed"]
    key = next(iter(packed))
    item = packed[key].to_xarray()
    assert isinstance(item, xarray.Dataset) and item.radiance.dims == ("spp", "y", "x", "channel")
    assert item.spp.values.tolist() == [1, 4, 16] and item.channel.values.tolist() == ["r", "g", "b"]
    assert item.x.values[0] == 0.5 and item.y.values[-1] == 15.5
    assert np.array_equal(item.radiance.sel(spp=4).values, packed[key].rung(4).data)
    assert np.array_equal(item.albedo.values, packed[key].gbuffer()["albedo"])
    assert item.radiance.attrs["space"] == tauflow.EXPOSED and item.radiance.attrs["exposure"] > 0.0
    whole = packed.to_xarray()
    assert whole.radiance.dims == ("item", "spp", "y", "x", "channel") and list(whole.item.values) == list(packed)
    assert np.array_equal(whole.radiance.sel(item=key, spp=16), packed[key].rung(16).data)
    assert float(whole.exposure.sel(item=key)) == item.radiance.attrs["exposure"]
    features = tauflow.open(tiny.file, cache=tiny.cache)["ladders.gbuffer"]
    features = features[next(iter(features))]
    assert set(features.to_xarray()) == {"albedo", "normal"} and features.images == {}
    held = tauflow.open(tiny.file, cache=tiny.cache)["held"].to_xarray()
    assert set(held["from"].values) == {"1", "4"} and held.sizes["item"] == 2 * len(packed)
    with pytest.raises(tauflow.TauflowError, match="has no images; its files: value.json|has no images"):
        tauflow.open(tiny.file, cache=tiny.cache)["scores"].to_xarray()


def test_pairs_are_a_dataset_for_pytorch(tiny):
    torch = pytest.importorskip("torch")
    from tauflow.torch import Pairs

    node = tauflow.open(tiny.file, cache=tiny.cache)["packed"]
    pairs = Pairs(node, noisy=1, gbuffer=True)
    batch = next(iter(torch.utils.data.DataLoader(pairs, batch_size=3)))
    assert batch["noisy"].shape == batch["clean"].shape == (3, 3, 16, 24) and batch["gbuffer"].shape == (3, 6, 16, 24)
    key = batch["item"][1]
    assert torch.equal(batch["clean"][1], torch.from_numpy(np.moveaxis(node[key].rung(16).data, -1, 0).copy()))


def test_a_result_folder_without_its_cache_says_what_to_give(tiny, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TAUFLOW_CACHE", str(tmp_path / "none"))
    with pytest.raises(tauflow.TauflowError, match="cache") as told:
        tauflow.open(tiny.out / "tiny")["ladders"]
    assert "give the cache of the run" in str(told.value) and not str(told.value).startswith("error:")
