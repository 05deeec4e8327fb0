"""Ladders as a dataset for PyTorch, and trained solvers as its modules.

    pairs = tauflow.torch.Pairs(tauflow.open("out/quickstart")["train_set"], noisy=1, clean=256)
    loader = torch.utils.data.DataLoader(pairs, batch_size=8, shuffle=True)

    solver = tauflow.torch.load("model.safetensors")
    clean = solver.refine(noisy, from_spp=4, gbuffer=features)
"""

from __future__ import annotations

import json
import os
from typing import Optional, Union

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch.utils.data import Dataset

from . import _network, _safetensors
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


class Solver:
    """A trained solver. `info` says what it was trained for, `net` is its network, in f64."""

    def __init__(self, info: dict, net: torch.nn.Module):
        self.info, self.net = info, net

    @property
    def counts(self) -> list:
        """Samples per pixel of the ladder that it was trained on, increasing."""
        return list(self.info["counts"])

    def predict(
        self, state: torch.Tensor, gbuffer: Optional[torch.Tensor], tau: Optional[float]
    ) -> torch.Tensor:
        """The network's prediction [height, width, 3] for a state at variance time `tau`, both in the model's space.

        `tau` is None for unknown sample counts, which a solver that was trained with `unknown_counts` accepts.
        """
        if tau is None and not self.info.get("unknown_counts"):
            raise TauflowError("the solver must be told the sample count; train it with `unknown_counts` above 0")
        return _network.predict(self.info, self.net, state, gbuffer, tau)

    def refine(
        self,
        image: ArrayLike,
        from_spp: Optional[int] = None,
        *,
        gbuffer: Optional[ArrayLike] = None,
        nfe: int = 1,
        to_spp: Optional[int] = None,
        exposure: Optional[float] = None,
    ) -> np.ndarray:
        """Denoises linear radiance [height, width, 3] of `from_spp` samples per pixel, as `tauflow refine` does.

        Without `from_spp`, the sample count is unknown, and may differ from pixel to pixel: the result is the clean
        estimate of one call. `gbuffer` [height, width, 6] is albedo, then normal; a solver that was trained with
        G-buffers needs it. `nfe`
        is the number of network calls, `to_spp` the noise level of the result (default: that of the last rung).
        `exposure` is the factor for the network (default: 0.18 divided by the geometric mean luminance); the result
        has the original exposure. Raises TauflowError if these do not fit the solver.
        """
        data = _checked("the image", image, 3)
        guide: Optional[torch.Tensor] = None
        if _network.has_gbuffer(self.info):
            if gbuffer is None:
                raise TauflowError("the solver was trained with G-buffers; pass `gbuffer`, albedo and normal")
            guide = torch.from_numpy(_checked("the G-buffer", gbuffer, 6).astype(np.float64))
            if guide.shape[:2] != data.shape[:2]:
                raise TauflowError(f"the image has the shape {data.shape}, the G-buffer {tuple(guide.shape)}")
        first, last = self.counts[0], self.counts[-1]
        end = last if to_spp is None else to_spp
        if from_spp is None and (nfe != 1 or to_spp is not None):
            raise TauflowError("more than one call, or an end other than the last rung, needs `from_spp`")
        if from_spp is not None and (not (first <= from_spp < end <= last) or nfe < 1):
            raise TauflowError(
                f"a rollout from {from_spp} to {end} spp with {nfe} calls is impossible: the training ladder goes from "
                f"{first} to {last} spp, and `nfe` counts from 1"
            )
        factor = 0.18 / _geometric_mean(data) if exposure is None else exposure
        if not (np.isfinite(factor) and factor > 0):
            raise TauflowError(f"invalid exposure {factor}; pass a factor above 0")
        exposed = torch.from_numpy((data.astype(np.float64) * factor).astype(np.float32).astype(np.float64))
        log = self.info["space"] == "log1p"
        state = _network.signed_log1p(exposed) if log else exposed
        if from_spp is None:
            state = _step(self.info["parameterization"], state, self.predict(state, guide, None), 0.0, 1.0)
            refined = _network.signed_expm1(state) if log else state
            return (refined.numpy() / factor).astype(np.float32)
        times = [_tau(self.info, from_spp * (end / from_spp) ** (i / nfe)) for i in range(nfe)]
        times.append(1.0 if end == last else _tau(self.info, end))
        for tau, then in zip(times, times[1:]):
            state = _step(self.info["parameterization"], state, self.predict(state, guide, tau), tau, then)
        refined = _network.signed_expm1(state) if log else state
        return (refined.numpy() / factor).astype(np.float32)


def load(path: Union[str, os.PathLike[str]]) -> Solver:
    """A trained solver from a `model.safetensors`, or from a checkpoint, whose averaged weights are taken.

    `tauflow checkpoints PIPELINE -o DIR` and `tauflow export PIPELINE solvers.model` write such files. Raises
    TauflowError if the file is damaged or no model.
    """
    path = os.fspath(path)
    weights, notes = _safetensors.read(path)
    try:
        info = json.loads(json.loads(notes["tauflow"])["model"])
        known = {
            "features": ("contrast", "covered", "plain"),
            "law": ("limits", "covariances"),
            "output": ("means", *_network.SHADED, "values"),
        }
        unknown = [f"`{field}: {info[field]}`" for field, of in known.items() if info.get(field, of[0]) not in of]
        if unknown:
            told = f"{path}: the model has {unknown[0]}, which this version does not know; update `tauflow`"
            raise TauflowError(told)
        if info.get("output") in _network.GUIDED and not _network.has_gbuffer(info):
            raise ValueError("guides without G-buffers")
        if not 0.05 <= _network.exponent(info) <= 2:
            raise ValueError("an exponent beyond those of ladders")
        plan, output = (info["preset"], _network.channels(info)), info.get("output", "means")
        expected = _network.shapes(*plan, output)
        net = _network.network(*plan, output, info["space"] == "log1p")
    except (KeyError, OverflowError, TypeError, ValueError):
        raise TauflowError(f"{path}: this is no model of a solver, or of another version") from None
    if "average.stem.kernel" in weights:
        weights = {name[len("average.") :]: w for name, w in weights.items() if name.startswith("average.")}
    if {name: w.shape for name, w in weights.items()} != expected:
        shape = lambda name: weights[name].shape if name in weights else None
        wrong = min(name for name in {*weights, *expected} if shape(name) != expected.get(name))
        raise TauflowError(
            f"{path}: its weights are not those of the preset `{info['preset']}`: `{wrong}` has the shape "
            f"{shape(wrong)} in place of {expected.get(wrong)}"
        )
    tensors = {name: torch.from_numpy(w.astype(np.float64)) for name, w in weights.items()}
    net.double().load_state_dict(_network.state_dict(tensors, info["preset"]))
    return Solver(info, net.eval())


def _checked(what: str, image: ArrayLike, channels: int) -> np.ndarray:
    data = np.asarray(image, dtype=np.float32)
    if data.ndim != 3 or data.shape[2] != channels or data.size == 0:
        raise TauflowError(f"{what} has the shape {data.shape}; it must be [height, width, {channels}]")
    if not np.isfinite(data).all():
        raise TauflowError(f"{what} has values that are not finite; mend it first")
    return data


def _geometric_mean(image: np.ndarray) -> float:
    """Of the luminance of blocks of 4 x 4 pixels; those below 1/10,000 of the mean count as that much."""
    light = (image @ np.array([0.2126, 0.7152, 0.0722], np.float32)).astype(np.float64)
    height, width = light.shape
    blocks = [light[y : y + 4, x : x + 4].mean() for y in range(0, height, 4) for x in range(0, width, 4)]
    floor = max(1e-4 * np.clip(light, 0, None).mean(), 1e-30)
    return float(np.exp(np.log(np.maximum(blocks, floor)).mean()))


def _tau(info: dict, count: float) -> float:
    first, last, error = (n ** -_network.exponent(info) for n in (info["counts"][0], info["counts"][-1], count))
    return (first - error) / (first - last)


def _step(
    parameterization: str, state: torch.Tensor, prediction: torch.Tensor, tau: float, then: float
) -> torch.Tensor:
    """The state at `then`, from a state and a prediction at `tau`."""
    scale = {"mc_noise": -1.0, "mc_velocity": 1.0 - tau}.get(parameterization)
    if scale is not None and then >= 1.0:
        return state + scale * prediction
    if parameterization == "mc_noise":
        return state - (then - tau) / (1.0 - tau) * prediction
    return state + (then - tau) * prediction
