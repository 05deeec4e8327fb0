"""Items of an export, and the nodes that they belong to."""

from __future__ import annotations

import json
import os
import re
from typing import TYPE_CHECKING, Any, Dict, Iterator, List, Mapping, Optional

import numpy as np

from ._errors import Missing, TauflowError
from ._images import RAW, Image
from ._tables import read_rows
from .exr import read_layers

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

#: Files of several layers, or of no radiance.
_FEATURES = ("gbuffer.exr", "variance.exr")
_RUNG = re.compile(r"spp-(\d+)\.exr$")


def read_json(path: str) -> Any:
    """The content of a JSON file. Raises TauflowError if it is missing or damaged."""
    try:
        with open(path, encoding="utf-8") as file:
            return json.load(file)
    except FileNotFoundError:
        raise TauflowError(f"{path}: there is no such file; export the node again") from None
    except (OSError, ValueError) as error:
        raise TauflowError(f"{path}: {error}; export the node again") from None


def axes(key: str) -> Dict[str, str]:
    """The axes in a key: `from=1+method=hold/L0-open-000003` has `from` and `method`."""
    found: Dict[str, str] = {}
    for part in key.split("/")[:-1]:
        for pair in part.split("+"):
            name, equal, value = pair.partition("=")
            if equal:
                found[name] = value
    return found


class Item:
    """One item: a ladder, a packed scene, refined images, scores or anything else that a node makes."""

    def __init__(self, folder: str, entry: Mapping[str, Any], again: str, keep: object = None):
        self.key: str = entry["item"]
        #: Name of its type, such as `tauflow/packed-scene`.
        self.media: str = entry.get("media", "")
        #: Digest of its content; the same on every machine for outputs that are reproducible.
        self.digest: Optional[str] = entry.get("digest")
        self._folder = os.path.join(folder, *self.key.split("/"))
        self._files: Optional[List[str]] = entry.get("files")
        self._again = again
        # A temporary folder stays as long as something reads it.
        self._keep = keep

    @property
    def axes(self) -> Dict[str, str]:
        """The axes of the cell that it comes from, such as `{"from": "1"}`."""
        return axes(self.key)

    @property
    def scene(self) -> str:
        """The last part of its key: the scene, for everything that is made by scene."""
        return self.key.rsplit("/", 1)[-1]

    @property
    def files(self) -> List[str]:
        """Names of its files."""
        if self._files is not None:
            return list(self._files)
        return sorted(os.listdir(self._folder)) if os.path.isdir(self._folder) else []

    def path(self, name: str) -> str:
        """Path of one of its files. Raises TauflowError if it has no such file, or the file is missing."""
        if name not in self.files:
            raise TauflowError(f"`{self.key}` has no file `{name}`; it has {', '.join(self.files) or 'none'}")
        path = os.path.join(self._folder, *name.split("/"))
        if not os.path.isfile(path):
            raise TauflowError(f"{path}: the file is missing; {self._again}")
        return path

    @property
    def meta(self) -> Dict[str, Any]:
        """What is said of it: the content of its JSON file, `{}` without one."""
        for name in ("meta.json", "value.json", "bridge.json"):
            if name in self.files:
                return read_json(self.path(name))
        return {}

    def image(self, name: str) -> Image:
        """The image of an EXR file, its first layer if there are several."""
        path = self.path(name)
        layers = read_layers(path)
        if not layers:
            raise TauflowError(f"{path}: it has no channel; export the node again")
        meta = self.meta
        data = layers.get("", next(iter(layers.values())))
        return Image(data, meta.get("space"), meta.get("exposure"), path)

    @property
    def rungs(self) -> List[int]:
        """Samples per pixel of its images, increasing; empty for what is no ladder."""
        return sorted(int(found.group(1)) for found in map(_RUNG.match, self.files) if found)

    def rung(self, spp: int) -> Image:
        """The image of `spp` samples per pixel. Raises TauflowError if there is none."""
        for name in self.files:
            found = _RUNG.match(name)
            if found and int(found.group(1)) == spp:
                return self.image(name)
        have = ", ".join(map(str, self.rungs)) or "none: it is no ladder"
        raise TauflowError(f"`{self.key}` has no rung of {spp} samples; its rungs: {have}")

    @property
    def images(self) -> Dict[str, Image]:
        """All images in EXR files, by name without `.exr`; see `gbuffer` and `variance` for these."""
        return {name[:-4]: self.image(name) for name in self.files if name.endswith(".exr") and name not in _FEATURES}

    def gbuffer(self) -> Dict[str, np.ndarray]:
        """`albedo` and `normal`, each [height, width, 3]; normals point right, up and towards the camera.

        Raises TauflowError if it has none.
        """
        if "gbuffer.exr" not in self.files:
            raise TauflowError(
                f"`{self.key}` has no G-buffer; that of a ladder is the item of `NODE.gbuffer`, and that of a packed "
                "scene needs `gbuffers` of its `dataset_packing`"
            )
        return read_layers(self.path("gbuffer.exr"))

    def variance(self) -> Image:
        """Variance per sample of each pixel [height, width, 3], of raw radiance. Raises TauflowError without one."""
        if "variance.exr" not in self.files:
            raise TauflowError(f"`{self.key}` has no variance; export the ladder that it was packed from")
        return Image(self.image("variance.exr").data, None, None, self.path("variance.exr"))

    def rows(self) -> List[Dict[str, Any]]:
        """Its scores as rows with the axes as columns; one row of numbers and texts for other JSON.

        Of a `table`, the rows of the table.
        """
        if "table.csv" in self.files:
            return read_rows(self.path("table.csv"))
        meta = self.meta
        base: Dict[str, Any] = {"item": self.scene, **self.axes}
        scores = meta.get("scores")
        if isinstance(scores, list):
            flat = lambda row: {**{k: v for k, v in row.items() if k != "metrics"}, **row.get("metrics", {})}
            return [{**base, **flat(row)} for row in scores]
        plain = {key: value for key, value in meta.items() if isinstance(value, (int, float, str, bool))}
        return [{**base, **plain}] if plain else []

    def to_xarray(self) -> xr.Dataset:
        """Its images as an xarray.Dataset. Needs xarray.

        A ladder or packed scene has `radiance` (spp, y, x, channel), and `albedo`, `normal` and `variance` where it has
        them. A single image is `radiance` (y, x, channel), too; of several images, each is a variable by its name. `x`
        and `y` are centres of pixels. The attributes of radiance are `space` and `exposure`. Raises TauflowError if it
        has no images.
        """
        from ._xarray import of_item

        return of_item(self)

    def __repr__(self) -> str:
        return f"<Item {self.key}: {self.media}, {len(self.files)} files>"


class Node(Mapping[str, Item]):
    """The items of a node's output, by key."""

    def __init__(self, folder: str, again: str, keep: object = None):
        manifest = read_json(os.path.join(folder, "manifest.json"))
        try:
            #: Names of pipeline, node and output.
            self.pipeline, self.name, self.port = (manifest.get(k, "") for k in ("pipeline", "node", "port"))
            items = [Item(folder, entry, again, keep) for entry in manifest["items"]]
        except (TypeError, KeyError, AttributeError):
            raise TauflowError(f"{folder}/manifest.json: this is no manifest of an export; export it again") from None
        self.folder = folder
        self._items = {item.key: item for item in items}

    def __getitem__(self, key: str) -> Item:
        if key in self._items:
            return self._items[key]
        # The scene alone will do where it names one item.
        found = [item for item in self._items.values() if item.scene == key]
        if len(found) == 1:
            return found[0]
        if found:
            raise TauflowError(f"`{key}` is in {len(found)} cells; name one, such as `{found[0].key}`")
        import difflib

        near = difflib.get_close_matches(key, self._items, 1, 0.5) if isinstance(key, str) else []
        hint = f"; did you mean `{near[0]}`?" if near else ""
        raise Missing(f"node `{self.name}` has no item `{key}`{hint}")

    def __iter__(self) -> Iterator[str]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)

    def __contains__(self, key: object) -> bool:
        return key in self._items

    def rows(self) -> List[Dict[str, Any]]:
        """The rows of all items (see `Item.rows`)."""
        return [row for item in self._items.values() for row in item.rows()]

    def frame(self) -> pd.DataFrame:
        """The rows as a pandas DataFrame, axes as columns. Needs pandas."""
        from ._tables import typed

        return typed(self.rows())

    def to_xarray(self) -> xr.Dataset:
        """The images of all items as an xarray.Dataset (see `Item.to_xarray`). Needs xarray.

        The first dimension is `item`, with the coordinates `scene`, `exposure` and the axes of the cells. Raises
        TauflowError if the items differ in size or images.
        """
        from ._xarray import of_items

        return of_items(self._items.values(), self.name)

    def __repr__(self) -> str:
        return f"<Node {self.pipeline}/{self.name}.{self.port}: {len(self)} items>"
