"""The bundled denoiser through its C library, in this process."""

from __future__ import annotations

import ctypes
import math
import operator
import os
import warnings
from typing import Any, Dict, Optional, Union

import numpy as np
from numpy.typing import ArrayLike

from ._errors import TauflowError, TauflowWarning

_IMAGE = ctypes.POINTER(ctypes.c_float)
# The process that denoised first: its threads do not exist in processes that are forked from it.
_process: Optional[int] = None


class _Frame(ctypes.Structure):
    """`TauflowFrame` of tauflow_denoise.h."""

    _fields_ = [
        ("width", ctypes.c_size_t),
        ("height", ctypes.c_size_t),
        ("radiance", _IMAGE),
        ("albedo", _IMAGE),
        ("normal", _IMAGE),
        ("variance", _IMAGE),
        ("output", _IMAGE),
        ("spp", ctypes.c_uint64),
        ("exposure", ctypes.c_double),
        ("keep", ctypes.c_double),
    ]


class Denoiser:
    """The bundled denoiser, loaded once for many images. It writes no files and starts no process.

    `weights` is `best` or `fast`. `library` is the C library, which `cargo build --release -p tauflow-denoiser-c`
    makes; without it, the variable TAUFLOW_DENOISE_LIBRARY names it. Threads may share a denoiser; a process that was
    forked after the first image cannot denoise. Raises TauflowError if there is no such library, or no such weights.
    """

    _new: Optional[int] = None

    def __init__(self, weights: str = "best", library: Optional[Union[str, "os.PathLike[str]"]] = None):
        path = os.fspath(library) if library is not None else os.environ.get("TAUFLOW_DENOISE_LIBRARY")
        if not path:
            raise TauflowError(
                "no library of the denoiser; pass `library`, or name it in the variable TAUFLOW_DENOISE_LIBRARY "
                "(`cargo build --release -p tauflow-denoiser-c` makes target/release/libtauflow_denoiser_c.so)"
            )
        try:
            self._library = ctypes.CDLL(path)
            new, run = self._library.tauflow_denoiser_new, self._library.tauflow_denoise
            free, size = self._library.tauflow_denoiser_free, self._library.tauflow_denoiser_frame_size
        except (OSError, AttributeError) as error:
            raise TauflowError(f"{path}: this is no library of the denoiser: {error}") from None
        new.argtypes, new.restype = [ctypes.c_char_p, ctypes.c_char_p, ctypes.c_size_t], ctypes.c_void_p
        frame = ctypes.POINTER(_Frame)
        run.argtypes, run.restype = [ctypes.c_void_p, frame, ctypes.c_char_p, ctypes.c_size_t], ctypes.c_int
        free.argtypes, free.restype = [ctypes.c_void_p], None
        size.argtypes, size.restype = [], ctypes.c_size_t
        if size() != ctypes.sizeof(_Frame):
            raise TauflowError(f"{path}: the library is of another version than this package; build both together")
        told = ctypes.create_string_buffer(512)
        self._new = new(weights.encode(), told, len(told))
        if not self._new:
            raise TauflowError(told.value.decode(errors="replace"))

    def __del__(self) -> None:
        if self._new:
            self._library.tauflow_denoiser_free(self._new)
            self._new = None

    def __reduce__(self) -> Any:
        raise TypeError("a Denoiser cannot be copied or pickled; make one in each process")

    def __call__(
        self,
        radiance: ArrayLike,
        albedo: Optional[ArrayLike] = None,
        normal: Optional[ArrayLike] = None,
        *,
        variance: Optional[ArrayLike] = None,
        spp: Optional[int] = None,
        strength: float = 1.0,
        exposure: Optional[float] = None,
    ) -> np.ndarray:
        """As `tauflow.denoise`, with the same bits, for normals in camera space (right, up, towards the camera).

        Normals are used as they are: those that are too long, stored from 0 to 1 or in world space are not changed. It
        warns only of those that are too long.
        """
        given: Dict[str, Any] = {"radiance": radiance, "albedo": albedo, "normal": normal, "variance": variance}
        images = {
            name: np.ascontiguousarray(image, np.float32) for name, image in given.items() if image is not None
        }
        shape = images["radiance"].shape
        for name, image in images.items():
            if image.ndim != 3 or image.shape[2] != 3 or image.size == 0 or image.shape != shape:
                raise TauflowError(f"`{name}` has the shape {image.shape}; all must be [height, width, 3]")
        count = 0 if spp is None else operator.index(spp)
        if spp is not None and not 1 <= count < 2**64:
            raise TauflowError(f"`spp` is {spp}; it is at least 1")
        if not 0.0 <= strength <= 1.0:
            raise TauflowError(f"`strength` is {strength}; it goes from 0 to 1")
        if exposure is not None and not (math.isfinite(exposure) and exposure > 0.0):
            raise TauflowError(f"`exposure` is {exposure}; it is a finite number above 0")
        global _process
        _process = _process or os.getpid()
        if _process != os.getpid():
            raise TauflowError("this process was forked after the first image; start it with the method `spawn`")
        output = np.empty(shape, np.float32)
        frame = _Frame(shape[1], shape[0], spp=count, exposure=exposure or 0.0, keep=1.0 - strength)
        for name, image in [*images.items(), ("output", output)]:
            setattr(frame, name, image.ctypes.data_as(_IMAGE))
        told = ctypes.create_string_buffer(4096)
        if self._library.tauflow_denoise(self._new, ctypes.byref(frame), told, len(told)):
            raise TauflowError(told.value.decode(errors="replace"))
        for note in told.value.decode(errors="replace").splitlines():
            warnings.warn(note, TauflowWarning, stacklevel=2)
        return output
