"""Ladders as a dataset for PyTorch.

    pairs = tauflow.torch.Pairs(tauflow.open("out/quickstart")["train_set"], noisy=1, clean=256)
    loader = torch.utils.data.DataLoader(pairs, batch_size=8, shuffle=True)
"""

from __future__ import annotations

from typing import Optional

import numpy as np
import torch
from torch.utils.data import Dataset

from ._errors import TauflowError
from ._items import Node


class Pairs(Dataset):
    """Noisy and clean images of the same scenes.

    An example is a dictionary: `noisy` and `clean` [3, height, width] of float32, with `gbuffer` also `gbuffer`
    [6, height, width] (albedo, then normal), and `item`, its key. `clean` is the last rung by default.
    Raises TauflowError if a scene has no such rung.
    """

    def __init__(self, node: Node, noisy: int = 1, clean: Optional[int] = None, gbuffer: bool = False):
        self.items = [node[key] for key in node]
        self.noisy, self.clean, self.gbuffer = noisy, clean, gbuffer
        for item in self.items:
            if not item.rungs:
                raise TauflowError(f"`{item.key}` of node `{node.name}` is no ladder; open a node of ladders")

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, index: int) -> dict:
        item = self.items[index]
        first = lambda data: torch.from_numpy(np.ascontiguousarray(np.moveaxis(data, -1, 0)))
        clean = item.rungs[-1] if self.clean is None else self.clean
        example = {"noisy": first(item.rung(self.noisy).data), "clean": first(item.rung(clean).data), "item": item.key}
        if self.gbuffer:
            layers = item.gbuffer()
            example["gbuffer"] = first(np.concatenate([layers["albedo"], layers["normal"]], axis=-1))
        return example
