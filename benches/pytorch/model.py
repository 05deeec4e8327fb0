"""A trained model in PyTorch: reads a model.safetensors as docs/formats/model.md describes it, and predicts.

See README.md.

python model.py MODEL          # as JSON: what it was trained for, and predictions of a made-up image

MODEL may be a checkpoint, too: of its four copies of the weights the averages are taken.

Predictions are in f64. The made-up image is that of the test `pytorch` of nodes/train, which compares.
"""

import json
import math
import sys

import torch
from torch.nn import functional as F

from network import CLOCK, PLANS, WEIGHTS, bases, network

HEIGHT, WIDTH, TIMES = 12, 20, (0.0, 0.4)
BLACK, FLOOR, STEEPEST, MULTIPLE = 0.02, 0.05, 16.0, 8


def channels(info):
    return 15 if info["conditioning"] == "gbuffer" else 6


def shapes(preset, channels, output="means"):
    """Our matrices: names and shapes."""
    widths, blocks, convolutions, embedding = PLANS[preset]
    found = {"time.0": (CLOCK, embedding), "time.1": (embedding, embedding), "stem": (9 * 4 * channels, widths[0])}

    def level(name, width):
        for block in range(blocks):
            for step in range(convolutions):
                found[f"{name}.{block}.{step}.time"] = (embedding, 2 * width)
                found[f"{name}.{block}.{step}"] = (9 * width, width)

    for i, (width, lower) in enumerate(zip(widths, widths[1:])):
        level(f"down.{i}", width)
        found[f"down.{i}.out"] = (4 * width, lower)
        found[f"up.{i}.in"] = (lower, 4 * width)
        found[f"up.{i}.skip"] = (width, width)
        level(f"up.{i}", width)
    level("middle", widths[-1])
    found["last.time"] = (embedding, 2 * widths[0])
    found["head"] = (9 * widths[0], 4 * (3 if output == "values" else WEIGHTS))
    if output == "shaded_means":
        found["shade"] = (9 * widths[0], 4 * 3)
    return {f"{name}.{part}": shape if part == "kernel" else (1, shape[1])
            for name, shape in found.items() for part in ("kernel", "bias")}


def place(name, levels):
    """Where a layer of ours is in PyTorch's network, whose levels on the way up begin with the lowest."""
    first, *rest = name.split(".")
    up = lambda i: levels - 1 - int(i)
    match first, rest:
        case "time", [i]:
            return f"time.{2 * int(i)}"
        case "stem" | "shade", []:
            return first
        case "head", []:
            return "last.conv"
        case "last", ["time"]:
            return "last.time"
        case "down", [i, "out"]:
            return f"smaller.{i}"
        case "up", [i, "in"]:
            return f"larger.{up(i)}"
        case "up", [i, "skip"]:
            return f"skip.{up(i)}"
    if first == "middle":
        level = "middle"
    else:
        level, rest = f"{first}.{rest[0] if first == 'down' else up(rest[0])}", rest[1:]
    block, step, *time = rest
    return f"{level}.{block}.steps.{step}.{'time' if time else 'conv'}"


def layout(name, kernel, bias):
    """A layer's weights as PyTorch has them.

    Four pixels in the channels of one: ours pixel by pixel, PyTorch's channel by channel.
    """
    outputs = kernel.shape[1]
    if name in ("head", "shade") or name.endswith(".in"):
        turn = lambda w: w.reshape(-1, 4, outputs // 4).transpose(1, 2).reshape(-1, outputs)
        kernel, bias = turn(kernel), turn(bias)
    steps = name.split(".")[-1].isdigit() and not name.startswith("time")
    size = 3 if name in ("stem", "head", "shade") or steps else 1
    weight = kernel.reshape(size, size, -1, outputs)
    if name == "stem" or name.endswith(".out"):
        weight = weight.reshape(size, size, 4, -1, outputs).transpose(2, 3).reshape(size, size, -1, outputs)
    weight = weight.permute(3, 2, 0, 1)
    return (weight[:, :, 0, 0] if "time" in name else weight), bias.reshape(-1)


def state_dict(ours, preset):
    """Our matrices as the weights of PyTorch's network."""
    theirs, levels = {}, len(PLANS[preset][0]) - 1
    for name in sorted({name.rsplit(".", 1)[0] for name in ours}):
        weight, bias = layout(name, ours[f"{name}.kernel"], ours[f"{name}.bias"])
        theirs[f"{place(name, levels)}.weight"], theirs[f"{place(name, levels)}.bias"] = weight, bias
    return theirs


def load(path):
    """What a model was trained for, and its network."""
    from safetensors import safe_open
    from safetensors.torch import load_file

    with safe_open(path, "pt") as file:
        info = json.loads(json.loads(file.metadata()["tauflow"])["model"])
    weights = load_file(path)
    if "average.stem.kernel" in weights:
        weights = {name.removeprefix("average."): w for name, w in weights.items() if name.startswith("average.")}
    output = info.get("output", "means")
    expected = shapes(info["preset"], channels(info), output)
    assert {name: tuple(w.shape) for name, w in weights.items()} == expected, "the matrices are those of the manual"
    assert all(w.dtype == torch.float32 for w in weights.values())
    net = network(info["preset"], channels(info), output, info["space"] == "log1p")
    net.load_state_dict({name: w.double() for name, w in state_dict(weights, info["preset"]).items()})
    return info, net.double().eval()


def signed_log1p(x):
    return x.sign() * x.abs().log1p()


def signed_expm1(x):
    return x.sign() * x.abs().expm1()


def features(info, state, gbuffer):
    """[1, C, H, W] of a state [1, 3, H, W] and a G-buffer [1, 6, H, W], with light and albedo."""
    around = lambda x: F.avg_pool2d(x, 5, stride=1, padding=2, count_include_pad=False)
    radiance = signed_expm1(state) if info["space"] == "log1p" else state
    albedo = torch.ones_like(state) if gbuffer is None else gbuffer[:, :3].clamp(min=0) + BLACK
    light = radiance / albedo
    seen = signed_log1p(light)
    mean = around(seen)
    spread = (mean.abs() + around((seen - mean).abs())).expm1() - mean.abs().expm1()
    found = [seen, signed_log1p((light - signed_expm1(mean)) / (FLOOR + spread))]
    if gbuffer is not None:
        found += [gbuffer, signed_log1p(radiance)]
    return torch.cat(found, 1), light, albedo


def ladder(info, tau):
    """First and last sample count, and that at tau."""
    first, last = info["counts"][0], info["counts"][-1]
    return first, last, (first**-0.5 - tau * (first**-0.5 - last**-0.5)) ** -2


def clock(info, tau):
    _, last, count = ladder(info, tau)
    angles = [math.pi * 2 ** (k / 2 - 1) * tau for k in range((CLOCK - 2) // 2)]
    waves = [wave(angle) for angle in angles for wave in (math.sin, math.cos)]
    return torch.tensor([[tau, math.log(count) / math.log(last), *waves]], dtype=torch.float64)


def gain(info, tau):
    first, last, count = ladder(info, tau)
    unit = first**-0.5 - last**-0.5
    match info["parameterization"]:
        case "mc_noise":
            return count / last - 1
        case "mc_velocity":
            return unit * (count**0.5 + count / last**0.5)
        case "local_velocity":
            return 2 * unit * count**0.5
        case "vanilla_rf":
            return min(1 / max(1 - tau, 1e-9), STEEPEST)


def predict(info, net, state, gbuffer, tau):
    """The prediction [H, W, 3] for a state [H, W, 3] and a G-buffer [H, W, 6], or None, in f64."""
    height, width, _ = state.shape
    beyond = (0, -width % MULTIPLE, 0, -height % MULTIPLE)
    plane = lambda x: F.pad(x.permute(2, 0, 1)[None], beyond, mode="replicate")
    state, gbuffer = plane(state), plane(gbuffer) if channels(info) == 15 else None
    shown, light, albedo = features(info, state, gbuffer)
    with torch.inference_mode():
        found = net(shown, clock(info, tau), bases(light), albedo, state, gain(info, tau))
    return found[0, :, :height, :width].permute(1, 2, 0)


def numbers(size, salt):
    """The same as `made_up` of the tests."""
    i = torch.arange(size, dtype=torch.int64)
    return ((i * 7919 + salt * 104729) % 2003).double() / 1001.5 - 1.0


def main():
    info, net = load(sys.argv[1])
    image = lambda channels, salt: numbers(HEIGHT * WIDTH * channels, salt).reshape(HEIGHT, WIDTH, channels)
    # Some of the light is negative, and some of the albedo.
    state = ((1 + image(3, 2001)) * (1 + image(3, 2001)) - 0.1).float().double()
    gbuffer = image(6, 2002).float().double()
    predictions = [predict(info, net, state, gbuffer, tau).reshape(-1).tolist() for tau in TIMES]
    print(json.dumps({"model": info, "predictions": predictions}))


if __name__ == "__main__":
    main()
