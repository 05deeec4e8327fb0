"""Reads OpenEXR files: one part, scan lines, without compression or with ZIP, half or 32-bit numbers.

These are the files that `tauflow export` and `tauflow render` write. Other compressions need another program or
package, and an error says so. Source: "OpenEXR File Layout", openexr.com.
"""

from __future__ import annotations

import os
import struct
import zlib
from typing import Dict, List, Mapping, Tuple, Union

import numpy as np

from ._errors import TauflowError

_MAGIC = 20000630
_COMPRESSIONS = ["none", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB"]
# Lines of a chunk, by compression.
_LINES = {0: 1, 2: 1, 3: 16}
_TYPES: Dict[int, np.dtype] = {0: np.dtype("<u4"), 1: np.dtype("<f2"), 2: np.dtype("<f4")}
# Most values of an image: 16 GiB of 32-bit numbers.
_MOST = 1 << 32
# How channels of a layer are ordered; others follow by name.
_ORDER = {name: place for place, name in enumerate("RGBAXYZUV")}


class _Reader:
    def __init__(self, path: str, data: bytes):
        self.path, self.data, self.at = path, data, 0

    def fail(self, what: str) -> TauflowError:
        return TauflowError(f"{self.path}: {what}")

    def take(self, size: int) -> bytes:
        end = self.at + size
        if size < 0 or end > len(self.data):
            raise self.fail("the file is cut short; copy or export it again")
        taken = self.data[self.at : end]
        self.at = end
        return taken

    def unpack(self, form: str) -> Tuple:
        return struct.unpack(form, self.take(struct.calcsize(form)))

    def text(self) -> str:
        end = self.data.find(b"\0", self.at, self.at + 256)
        if end < 0:
            raise self.fail("the header is damaged; copy or export the file again")
        text = self.data[self.at : end].decode("utf-8", "replace")
        self.at = end + 1
        return text


def _channels(reader: _Reader, data: bytes) -> List[Tuple[str, np.dtype]]:
    inner = _Reader(reader.path, data)
    found: List[Tuple[str, np.dtype]] = []
    while inner.at < len(data):
        name = inner.text()
        if not name:
            break
        kind, _linear, across, down = inner.unpack("<iB3xii")
        if kind not in _TYPES:
            raise reader.fail(f"channel `{name}` has the unknown type {kind}")
        if (across, down) != (1, 1):
            raise reader.fail(f"channel `{name}` is subsampled, which is unsupported; save it at full resolution")
        found.append((name, _TYPES[kind]))
    return found


def _unzip(reader: _Reader, packed: bytes, size: int) -> bytes:
    if len(packed) == size:
        # A chunk that would not become smaller is stored as it is.
        return packed
    unpacker = zlib.decompressobj()
    try:
        raw = unpacker.decompress(packed, size)
    except zlib.error as error:
        raise reader.fail(f"a chunk is damaged ({error}); copy or export the file again") from None
    if len(raw) != size:
        raise reader.fail("a chunk is damaged; copy or export the file again")
    # Bytes are stored as differences, the even ones before the odd ones.
    numbers = np.frombuffer(raw, np.uint8).astype(np.int64)
    numbers[1:] -= 128
    numbers = np.cumsum(numbers).astype(np.uint8)
    half = (size + 1) // 2
    out = np.empty(size, np.uint8)
    out[0::2], out[1::2] = numbers[:half], numbers[half:]
    return out.tobytes()


def read_channels(path: Union[str, os.PathLike]) -> Dict[str, np.ndarray]:
    """All channels of a file by name, each [height, width] with the type that it is stored in.

    Raises TauflowError if the file is missing, damaged, or uses features that are not supported.
    """
    path = os.fspath(path)
    try:
        with open(path, "rb") as file:
            reader = _Reader(path, file.read())
    except OSError as error:
        raise TauflowError(f"{path}: {error.strerror or error}") from None
    magic, version = reader.unpack("<ii") if len(reader.data) >= 8 else (0, 0)
    if magic != _MAGIC:
        raise reader.fail("this is no OpenEXR file")
    if version & ~0x4FF or version & 0x200:
        raise reader.fail("tiled, deep and multi-part files are unsupported; save it as one part of scan lines")
    header: Dict[str, bytes] = {}
    while True:
        name = reader.text()
        if not name:
            break
        reader.text()
        (size,) = reader.unpack("<i")
        header[name] = reader.take(size)
    for name in ("channels", "compression", "dataWindow"):
        if name not in header:
            raise reader.fail(f"the header has no `{name}`; export the file again")
    channels = _channels(reader, header["channels"])
    compression = header["compression"][0] if header["compression"] else -1
    if compression not in _LINES:
        name = _COMPRESSIONS[compression] if 0 <= compression < len(_COMPRESSIONS) else str(compression)
        raise reader.fail(f"compression {name} is unsupported; save it with ZIP, or read it with the package OpenEXR")
    if len(header["dataWindow"]) != 16:
        raise reader.fail("the header is damaged; copy or export the file again")
    left, top, right, bottom = struct.unpack("<4i", header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    if width < 1 or height < 1 or width * height * max(1, len(channels)) > _MOST:
        raise reader.fail(f"its size is {width} x {height} pixels; export the file again")
    lines = _LINES[compression]
    chunks = -(-height // lines)
    reader.take(8 * chunks)
    line_size = width * sum(kind.itemsize for _, kind in channels)
    if line_size * height > 1032 * len(reader.data):
        # zlib packs at most 1032 bytes in one.
        raise reader.fail("the file is cut short; copy or export it again")
    out = {name: np.empty((height, width), kind) for name, kind in channels}
    seen = set()
    for _ in range(chunks):
        y, size = reader.unpack("<ii")
        first = y - top
        if first < 0 or first >= height or first % lines or first in seen:
            raise reader.fail("a chunk is damaged; copy or export the file again")
        seen.add(first)
        count = min(lines, height - first)
        packed = reader.take(size)
        wanted = line_size * count
        data = packed if compression == 0 else _unzip(reader, packed, wanted)
        if len(data) != wanted:
            raise reader.fail("a chunk is damaged; copy or export the file again")
        at = 0
        for line in range(first, first + count):
            for name, kind in channels:
                size = width * kind.itemsize
                out[name][line] = np.frombuffer(data, kind, width, at)
                at += size
    return out


def read_layers(path: Union[str, os.PathLike]) -> Dict[str, np.ndarray]:
    """All layers of a file by name, each [height, width, channels] of float32.

    The layer without a name is `""`. Channels are ordered R, G, B, A or X, Y, Z; others follow by name.
    Raises TauflowError as `read_channels` does.
    """
    layers: Dict[str, List[Tuple[str, np.ndarray]]] = {}
    for name, values in read_channels(path).items():
        layer, _, channel = name.rpartition(".")
        layers.setdefault(layer, []).append((channel, values))
    order = lambda entry: (_ORDER.get(entry[0].upper(), len(_ORDER)), entry[0])
    return {
        layer: np.stack([values.astype(np.float32) for _, values in sorted(channels, key=order)], axis=-1)
        for layer, channels in layers.items()
    }


def write_layers(path: Union[str, os.PathLike], layers: Mapping[str, np.ndarray]) -> None:
    """Writes layers by name, each [height, width, channels] with 1 or 3 channels, as float32 without compression.

    `{"": image}` is a plain image. Raises TauflowError if shapes differ or the file cannot be written.
    """
    path, channels = os.fspath(path), {}
    for layer, values in layers.items():
        data = np.asarray(values, dtype="<f4")
        data = data[:, :, None] if data.ndim == 2 else data
        if data.ndim != 3 or data.shape[2] not in (1, 3) or data.size == 0:
            raise TauflowError(f"{path}: layer `{layer}` has the shape {data.shape}; it is [height, width, 1 or 3]")
        for letter, plane in zip("RGB" if data.shape[2] == 3 else "Y", np.moveaxis(data, 2, 0)):
            channels[f"{layer}.{letter}" if layer else letter] = plane
    shapes = {plane.shape for plane in channels.values()}
    if len(shapes) != 1:
        raise TauflowError(f"{path}: layers must have one size, and there must be one; they have {sorted(shapes)}")
    (height, width), names = shapes.pop(), sorted(channels)
    text = lambda value: value.encode() + b"\0"
    listed = b"".join(text(name) + struct.pack("<4i", 2, 0, 1, 1) for name in names) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    header = struct.pack("<2i", _MAGIC, 2)
    for name, kind, value in [
        ("channels", "chlist", listed),
        ("compression", "compression", b"\0"),
        ("dataWindow", "box2i", window),
        ("displayWindow", "box2i", window),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1)),
    ]:
        header += text(name) + text(kind) + struct.pack("<i", len(value)) + value
    header += b"\0"
    size = 4 * width * len(names)
    start = len(header) + 8 * height
    offsets = start + (8 + size) * np.arange(height, dtype="<u8")
    lines = np.stack([channels[name] for name in names], axis=1).reshape(height, -1)
    try:
        with open(path, "wb") as file:
            file.write(header + offsets.tobytes())
            for y, line in enumerate(lines):
                file.write(struct.pack("<2i", y, size) + line.tobytes())
    except OSError as error:
        raise TauflowError(f"{path}: {error.strerror or error}") from None
