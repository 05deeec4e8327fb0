"""The EXR reader, on files that these tests write byte by byte, and on damaged ones."""

import struct
import zlib

import numpy as np
import pytest

import tauflow


def header(channels, size, compression, version=2):
    width, height = size
    listed = b"".join(n.encode() + b"\0" + struct.pack("<iB3xii", kind, 0, 1, 1) for n, kind in channels) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    fields = [("channels", "chlist", listed), ("compression", "compression", bytes([compression]))]
    fields += [("dataWindow", "box2i", window)]
    named = lambda *texts: b"".join(text.encode() + b"\0" for text in texts)
    packed = b"".join(named(name, kind) + struct.pack("<i", len(data)) + data for name, kind, data in fields)
    return struct.pack("<ii", 20000630, version) + packed + b"\0"


def zipped(raw):
    """As OpenEXR packs: even bytes before odd ones, then differences, then zlib."""
    data = np.frombuffer(raw, np.uint8)
    data = np.concatenate([data[0::2], data[1::2]]).astype(np.int64)
    data[1:] = data[1:] - data[:-1] + 128
    packed = zlib.compress(data.astype(np.uint8).tobytes())
    return packed if len(packed) < len(raw) else raw


def save(path, channels, compression=3):
    """`channels`: name to [height, width] of float16, float32 or uint32, in the order of names."""
    kinds = {np.dtype("<u4"): 0, np.dtype("<f2"): 1, np.dtype("<f4"): 2}
    names = sorted(channels)
    height, width = channels[names[0]].shape
    lines = {0: 1, 2: 1, 3: 16}[compression]
    start = header([(n, kinds[channels[n].dtype]) for n in names], (width, height), compression)
    chunks = []
    for first in range(0, height, lines):
        rows = range(first, min(height, first + lines))
        raw = b"".join(channels[n][row].tobytes() for row in rows for n in names)
        chunks.append((first, raw if compression == 0 else zipped(raw)))
    at, offsets, body = len(start) + 8 * len(chunks), b"", b""
    for first, data in chunks:
        offsets += struct.pack("<Q", at + len(body))
        body += struct.pack("<ii", first, len(data)) + data
    path.write_bytes(start + offsets + body)


def picture(seed, shape=(21, 13), kind="<f4"):
    return np.random.default_rng(seed).random(shape).astype(kind)


@pytest.mark.parametrize("compression", [0, 2, 3])
@pytest.mark.parametrize("kind", ["<f2", "<f4"])
def test_values_are_those_that_were_written(tmp_path, compression, kind):
    channels = {name: picture(i, kind=kind) for i, name in enumerate("RGB")}
    # A smooth one, which packs well.
    channels["albedo.R"] = np.linspace(0, 1, 21 * 13, dtype=kind).reshape(21, 13)
    save(tmp_path / "a.exr", channels, compression)
    found = tauflow.read_channels(tmp_path / "a.exr")
    assert set(found) == set(channels)
    for name in channels:
        assert found[name].dtype == np.dtype(kind) and np.array_equal(found[name], channels[name])
    layers = tauflow.read_layers(tmp_path / "a.exr")
    assert layers[""].shape == (21, 13, 3) and layers[""].dtype == np.float32
    assert np.array_equal(layers[""][..., 0], channels["R"].astype(np.float32))
    assert layers["albedo"].shape == (21, 13, 1)


def test_damage_is_told_with_the_file(tmp_path):
    whole = tmp_path / "a.exr"
    save(whole, {name: picture(i) for i, name in enumerate("RGB")})
    data, bad = whole.read_bytes(), tmp_path / "bad.exr"
    told = lambda: pytest.raises(tauflow.TauflowError, match="bad.exr")
    for cut in [0, 3, 9, 60, 200, len(data) // 2, len(data) - 1]:
        bad.write_bytes(data[:cut])
        with told():
            tauflow.read_channels(bad)
    # Any damaged byte is either told or harmless, never another exception.
    generator = np.random.default_rng(1)
    for _ in range(2000):
        changed = bytearray(data)
        changed[generator.integers(len(data))] = generator.integers(256)
        bad.write_bytes(changed)
        try:
            tauflow.read_channels(bad)
        except tauflow.TauflowError as error:
            assert "bad.exr" in str(error)
    with pytest.raises(tauflow.TauflowError, match="nothing.exr"):
        tauflow.read_channels(tmp_path / "nothing.exr")


def test_what_is_unsupported_is_named(tmp_path):
    file = tmp_path / "a.exr"
    cases = [(4, 2, "PIZ"), (9, 2, "DWAB"), (3, 2 | 0x200, "tiled"), (3, 2 | 0x1000, "multi")]
    for compression, version, part in cases:
        file.write_bytes(header([("R", 2)], (4, 4), compression, version) + b"\0" * 100)
        with pytest.raises(tauflow.TauflowError, match=part):
            tauflow.read_channels(file)


def test_written_layers_come_back(tmp_path):
    path = tmp_path / "x.exr"
    draw = np.random.default_rng(1)
    layers = {"": draw.normal(size=(5, 7, 3)), "depth": draw.normal(size=(5, 7, 1))}
    layers = {name: layer.astype(np.float32) for name, layer in layers.items()}
    layers[""][0, 0] = [np.nan, np.inf, 1e30]
    tauflow.write_layers(path, layers)
    found = tauflow.read_layers(path)
    assert {name: layer.tobytes() for name, layer in found.items()} == {n: a.tobytes() for n, a in layers.items()}
    with pytest.raises(tauflow.TauflowError, match="must have one size"):
        tauflow.write_layers(path, {"": layers[""], "depth": np.zeros((5, 6))})
    with pytest.raises(tauflow.TauflowError, match=r"it is \[height, width, 1 or 3\]"):
        tauflow.write_layers(path, {"": np.zeros((5, 6, 2))})
    with pytest.raises(tauflow.TauflowError, match="nowhere"):
        tauflow.write_layers(tmp_path / "nowhere" / "x.exr", layers)


def test_written_layers_are_read_by_openexr(tmp_path):
    package = pytest.importorskip("OpenEXR")
    image = np.random.default_rng(2).normal(size=(6, 4, 3)).astype(np.float32)
    tauflow.write_layers(tmp_path / "x.exr", {"": image})
    with package.File(str(tmp_path / "x.exr")) as file:
        assert np.array_equal(file.channels()["RGB"].pixels, image)
