"""The bundled denoiser: `tauflow denoise` on arrays."""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
import warnings
from typing import Optional, Union

import numpy as np
from numpy.typing import ArrayLike

from ._errors import TauflowError, TauflowWarning
from ._open import program
from .exr import read_layers, write_layers


def denoise(
    radiance: ArrayLike,
    albedo: Optional[ArrayLike] = None,
    normal: Optional[ArrayLike] = None,
    *,
    variance: Optional[ArrayLike] = None,
    spp: Optional[int] = None,
    weights: str = "best",
    model: Optional[Union[str, "os.PathLike[str]"]] = None,
    strength: float = 1.0,
    exposure: Optional[float] = None,
    normals: str = "auto",
) -> np.ndarray:
    """Denoises linear radiance [height, width, 3] at any exposure, and returns it as float32.

    `albedo` and `normal` [height, width, 3] belong together; `normals` is `auto`, `camera` or `world`. World-space
    normals are turned so that most face the camera. `variance` is that of each value of the radiance: with it, the
    noisy image is mixed in where its estimated error is smaller. `spp` is the sample count, if it is known and the same
    in all pixels. `weights` is `best` or `fast`; `model` is a model file to use in their place. `strength` is the share
    of the denoised image. Raises TauflowError if shapes differ, or the command refuses the image. Warns
    (TauflowWarning) of pixels that are not finite, which it replaces, and of values that look wrong.
    """
    given = {"": radiance, "albedo": albedo, "normal": normal, "variance": variance}
    layers = {name: np.asarray(image, np.float32) for name, image in given.items() if image is not None}
    if (albedo is None) != (normal is None):
        raise TauflowError("`albedo` and `normal` belong together; pass both or none")
    shape = layers[""].shape
    for name, image in layers.items():
        if image.ndim != 3 or image.shape[2] != 3 or image.size == 0 or image.shape != shape:
            raise TauflowError(f"`{name or 'radiance'}` has the shape {image.shape}; all must be [height, width, 3]")
    with tempfile.TemporaryDirectory() as folder:
        noisy, clean = os.path.join(folder, "noisy.exr"), os.path.join(folder, "clean.exr")
        write_layers(noisy, layers)
        words = [program(), "denoise", noisy, "-o", clean, "--strength", str(strength)]
        words += ["--weights", weights] if model is None else ["--model", os.fspath(model)]
        words += ["--normals", normals]
        words += ["--spp", str(spp)] if spp is not None else []
        words += ["--exposure", str(exposure)] if exposure is not None else []
        words += ["--variance", "variance"] if variance is not None else []
        try:
            done = subprocess.run(words, capture_output=True, text=True, check=False)
        except OSError as error:
            raise TauflowError(f"{words[0]}: {error}") from None
        if done.returncode:
            raise TauflowError(done.stderr.replace(noisy, "the image").strip())
        start = f"{noisy}: "
        for line in done.stderr.splitlines():
            note = line[len(start) :] if line.startswith(start) else ""
            if "no camera matrix" in note:
                # Arrays have none; whether normals are in world space was guessed.
                guess = (
                    "normals look as if they were in world space, and were turned so that most face the camera; pass "
                    'normals="camera" if they are in camera space'
                )
                note = guess if normals == "auto" else ""
            # The other line says what was done.
            if note and not re.match(r"\d+ x \d+, ", note):
                warnings.warn(note, TauflowWarning, stacklevel=2)
        return read_layers(clean)[""]
