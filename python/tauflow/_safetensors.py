"""Reads safetensors files: a length, a header in JSON, and the numbers."""

from __future__ import annotations

import json
import os
from typing import Dict, Tuple

import numpy as np

from ._errors import TauflowError

_TYPES = {"F16": "<f2", "F32": "<f4", "F64": "<f8", "I64": "<i8", "I32": "<i4", "U8": "u1", "I8": "i1"}


def read(path: str) -> Tuple[Dict[str, np.ndarray], Dict[str, str]]:
    """The tensors of a file by name, and its notes; integers of 8 bits are multiplied by their `NAME.scale`.

    Raises TauflowError if the file is missing or damaged.
    """
    try:
        with open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            length = int.from_bytes(file.read(8), "little")
            if size < 8 or length > size - 8:
                raise TauflowError(f"{path}: this is no safetensors file, or it is cut short; export it again")
            header, data = json.loads(file.read(length)), file.read()
    except OSError as error:
        raise TauflowError(f"{path}: {error.strerror or error}") from None
    except ValueError as error:
        raise TauflowError(f"{path}: the header is damaged ({error}); export the file again") from None
    try:
        notes = header.pop("__metadata__", {})
        tensors = {name: _tensor(path, name, entry, data) for name, entry in header.items()}
        for name in [name for name, tensor in tensors.items() if tensor.dtype == np.int8]:
            scale = tensors.pop(f"{name}.scale")
            if tensors[name].ndim != 2 or scale.shape != (1, tensors[name].shape[1]):
                raise ValueError(f"`{name}.scale` does not fit")
            tensors[name] = tensors[name].astype(np.float32) * scale
    except (TypeError, KeyError, AttributeError, ValueError):
        raise TauflowError(f"{path}: the header is damaged; export the file again") from None
    return tensors, notes


def _tensor(path: str, name: str, entry: dict, data: bytes) -> np.ndarray:
    start, end = entry["data_offsets"]
    if entry["dtype"] not in _TYPES:
        raise TauflowError(f"{path}: `{name}` has the unsupported type {entry['dtype']}")
    kind, shape = np.dtype(_TYPES[entry["dtype"]]), tuple(entry["shape"])
    count = int(np.prod(shape, dtype=np.int64))
    if not 0 <= start <= end <= len(data) or end - start != count * kind.itemsize:
        raise TauflowError(f"{path}: the data of `{name}` is cut short or damaged; export the file again")
    return np.frombuffer(data, kind, count, start).reshape(shape)
