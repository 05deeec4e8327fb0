"""Images with their meaning."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Optional

import numpy as np
from numpy.typing import DTypeLike

from ._errors import TauflowError

#: Values of `Image.space`.
RAW, EXPOSED = "raw_radiance", "exposed_radiance"


@dataclass(frozen=True, eq=False)
class Image:
    """An image [height, width, channels] of float32. NumPy takes it as an array."""

    data: np.ndarray
    #: `raw_radiance`: linear radiance of the scene. `exposed_radiance`: that times `exposure`. None: no radiance.
    space: Optional[str] = None
    #: Factor between the scene's radiance and `data`; None if it is unknown.
    exposure: Optional[float] = None
    #: The file it comes from.
    path: str = ""

    def __array__(self, dtype: Optional[DTypeLike] = None, copy: Optional[bool] = None) -> np.ndarray:
        return np.array(self.data, dtype=dtype) if copy or dtype not in (None, self.data.dtype) else self.data

    @property
    def shape(self) -> tuple:
        """Height, width and channels."""
        return self.data.shape

    def raw(self) -> "Image":
        """The image as radiance of the scene, without exposure.

        Raises TauflowError if it is no radiance, or its exposure is unknown.
        """
        if self.space == RAW:
            return self
        if self.space != EXPOSED or not self.exposure:
            raise TauflowError(
                f"{self.path}: its exposure is unknown, so its radiance is, too; export it with `--raw`"
            )
        data = (self.data.astype(np.float64) / self.exposure).astype(np.float32)
        return replace(self, data=data, space=RAW, exposure=1.0)

    def preview(self) -> np.ndarray:
        """Display values in [0, 1]: Reinhard's x/(1 + x), then a gamma of 2.2. [height, width, channels]."""
        light = np.clip(self.data.astype(np.float64), 0.0, None)
        return ((light / (1.0 + light)) ** (1.0 / 2.2)).astype(np.float32)

    def __repr__(self) -> str:
        height, width, channels = self.data.shape
        exposure = f", exposure {self.exposure:.4g}" if self.space == EXPOSED and self.exposure else ""
        return f"<Image {width} x {height} x {channels}, {self.space or 'no radiance'}{exposure}>"
