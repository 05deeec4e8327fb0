"""Images as xarray datasets. Needs xarray, the extra `tauflow[xarray]`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Dict, Iterable, List, Optional, Tuple

import numpy as np

from ._errors import TauflowError

if TYPE_CHECKING:
    from ._items import Item

#: Names of the colour channels.
RGB = ["r", "g", "b"]


def xarray() -> Any:
    """The package. Raises TauflowError if it is not installed."""
    try:
        import xarray as found
    except ImportError:
        raise TauflowError("this needs xarray: pip install 'tauflow[xarray]'") from None
    return found


def _variables(item: "Item", xr: Any) -> Dict[str, Any]:
    """The images of an item by the name of their variable."""
    found: Dict[str, Any] = {}
    space: Dict[str, Any] = {}
    if item.rungs:
        rungs = [item.rung(spp) for spp in item.rungs]
        space = {"space": rungs[0].space or "", "exposure": rungs[0].exposure or np.nan}
        stack = np.stack([image.data for image in rungs])
        found["radiance"] = xr.DataArray(stack, dims=("spp", "y", "x", "channel"), attrs=space)
        found["radiance"] = found["radiance"].assign_coords(spp=item.rungs)
    else:
        for name, image in item.images.items():
            if image.data.ndim == 3 and image.data.shape[2] == len(RGB):
                attrs = {"space": image.space or "", "exposure": image.exposure or np.nan}
                found[name] = xr.DataArray(image.data, dims=("y", "x", "channel"), attrs=attrs)
        if len(found) == 1:
            found = {"radiance": next(iter(found.values()))}
    if "gbuffer.exr" in item.files:
        for name, layer in item.gbuffer().items():
            found[name] = xr.DataArray(layer, dims=("y", "x", "channel"))
    if "variance.exr" in item.files:
        found["variance"] = xr.DataArray(item.variance().data, dims=("y", "x", "channel"))
    return found


def of_item(item: "Item") -> Any:
    """The images of an item as a Dataset (see `Item.to_xarray`)."""
    xr = xarray()
    found = _variables(item, xr)
    if not found:
        raise TauflowError(f"`{item.key}` has no images; its files: {', '.join(item.files) or 'none'}")
    some = next(iter(found.values()))
    coords = {
        # Centres of pixels, from the upper left corner.
        "y": np.arange(some.sizes["y"]) + 0.5,
        "x": np.arange(some.sizes["x"]) + 0.5,
        "channel": RGB,
    }
    attrs = {"item": item.key, "media": item.media, **item.axes}
    return xr.Dataset(found, coords=coords, attrs=attrs)


def of_items(items: Iterable["Item"], name: str) -> Any:
    """The images of items of one size as a Dataset with the dimension `item` (see `Node.to_xarray`)."""
    xr = xarray()
    parts: List[Any] = []
    first: Optional[Tuple[str, Any]] = None
    for item in items:
        own = of_item(item)
        shape = ({name: variable.shape for name, variable in own.data_vars.items()}, list(own.coords.get("spp", ())))
        first = first or (item.key, shape)
        if shape != first[1]:
            raise TauflowError(
                f"node `{name}`: `{item.key}` has other images or sizes than `{first[0]}`; use `to_xarray` of each item"
            )
        coords: Dict[str, Any] = {"scene": ("item", [item.scene])}
        coords.update({axis: ("item", [value]) for axis, value in item.axes.items() if axis not in own.variables})
        exposures = [v.attrs.pop("exposure") for v in own.data_vars.values() if "exposure" in v.attrs]
        if exposures:
            coords["exposure"] = ("item", exposures[:1])
        own.attrs = {"media": item.media}
        parts.append(own.expand_dims(item=[item.key]).assign_coords(coords))
    if not parts:
        raise TauflowError(f"node `{name}` has no items")
    return xr.concat(parts, dim="item")
