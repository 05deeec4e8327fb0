"""Reads what tauflow makes: exports, folders of results, and pipelines with their cache.

    import tauflow
    results = tauflow.open("out/quickstart")
    results["test_ladders"]["L0-open-000001"].rung(16)
"""

from ._denoise import denoise
from ._errors import TauflowError, TauflowWarning
from ._images import EXPOSED, RAW, Image
from ._items import Item, Node
from ._library import Denoiser
from ._open import Cache, Pipeline, Results, open, program
from .exr import read_channels, read_layers, write_layers

__all__ = [
    "Cache",
    "Denoiser",
    "EXPOSED",
    "Image",
    "Item",
    "Node",
    "Pipeline",
    "RAW",
    "Results",
    "TauflowError",
    "TauflowWarning",
    "denoise",
    "open",
    "program",
    "read_channels",
    "read_layers",
    "write_layers",
]
