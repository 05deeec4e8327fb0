"""What PyTorch makes of our network: outputs and gradients for made-up weights and inputs, for the project's tests.

python reference.py > ../../nodes/train/src/network/pytorch.json

Weights have our names and layouts (see docs/kinds/training.md), and PyTorch's autograd goes back to them.
"""

import json
import math

import torch

from network import CHANNELS, CLOCK, PLANS, WEIGHTS, bases, network

SIDE, PRESET = 16, "tiny"


def numbers(size, salt):
    """The same as `made_up` of the test."""
    i = torch.arange(size, dtype=torch.int64)
    return ((i * 7919 + salt * 104729) % 2003).double() / 1001.5 - 1.0


def shapes():
    """Our weights: names and shapes."""
    widths, blocks, convolutions, embedding = PLANS[PRESET]
    found = {"time.0": (CLOCK, embedding), "time.1": (embedding, embedding), "stem": (9 * 4 * CHANNELS, widths[0])}

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
    found["head"] = (9 * widths[0], 4 * WEIGHTS)
    return {f"{name}.{part}": shape if part == "kernel" else (1, shape[1])
            for name, shape in found.items() for part in ("kernel", "bias")}


def place(name):
    """Where a layer of ours is in PyTorch's network."""
    levels = len(PLANS[PRESET][0]) - 1
    first, *rest = name.split(".")
    up = lambda i: levels - 1 - int(i)
    match first, rest:
        case "time", [i]:
            return f"time.{2 * int(i)}"
        case "stem", []:
            return "stem"
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
    level, rest = ("middle", rest) if first == "middle" else (f"{first}.{rest[0] if first == 'down' else up(rest[0])}", rest[1:])
    block, step, *time = rest
    return f"{level}.{block}.steps.{step}.{'time' if time else 'conv'}"


def layout(name, kernel, bias):
    """A layer's weights as PyTorch has them. Four pixels in the channels of one: ours pixel by pixel, PyTorch's channel by
    channel."""
    outputs = kernel.shape[1]
    if name == "head" or name.endswith(".in"):
        turn = lambda w: w.reshape(-1, 4, outputs // 4).transpose(1, 2).reshape(-1, outputs)
        kernel, bias = turn(kernel), turn(bias)
    size = 3 if name in ("stem", "head") or name.split(".")[-1].isdigit() and not name.startswith("time") else 1
    weight = kernel.reshape(size, size, -1, outputs)
    if name == "stem" or name.endswith(".out"):
        weight = weight.reshape(size, size, 4, -1, outputs).transpose(2, 3).reshape(size, size, -1, outputs)
    weight = weight.permute(3, 2, 0, 1)
    return (weight[:, :, 0, 0] if "time" in name else weight), bias.reshape(-1)


def main():
    torch.set_default_dtype(torch.float64)
    net = network(PRESET)
    ours = {}
    for salt, (name, shape) in enumerate(sorted(shapes().items())):
        scale = 0.1 if name.endswith("bias") else 1.5 / math.sqrt(shape[0])
        ours[name] = (numbers(math.prod(shape), salt) * scale).float().double().reshape(shape).requires_grad_()
    theirs = {}
    for name in sorted({name.rsplit(".", 1)[0] for name in ours}):
        weight, bias = layout(name, ours[f"{name}.kernel"], ours[f"{name}.bias"])
        theirs[f"{place(name)}.weight"], theirs[f"{place(name)}.bias"] = weight, bias
    assert {name: w.shape for name, w in theirs.items()} == {name: w.shape for name, w in net.named_parameters()}
    image = lambda channels, salt: numbers(SIDE * SIDE * channels, salt).float().double().reshape(1, SIDE, SIDE, channels)
    first = lambda x: x.permute(0, 3, 1, 2)
    inputs = [first(image(CHANNELS, 1001)), numbers(CLOCK, 1002).float().double().reshape(1, CLOCK)]
    inputs += [bases(first(image(3, 1003))), first(image(3, 1004)), first(image(3, 1007)), torch.full((1, 1, 1, 1), -1.5)]
    output = torch.func.functional_call(net, theirs, tuple(inputs)).permute(0, 2, 3, 1)
    (output * image(3, 1005)).sum().backward()
    gradients = {}
    for name, weight in ours.items():
        found = weight.grad.reshape(-1)
        gradients[name] = [float(f"{v:.9g}") for v in (found.norm(), (found * numbers(found.numel(), 1006)).sum())]
    digits = [float(f"{v:.7g}") for v in output.reshape(-1).tolist()]
    print(json.dumps({"pytorch": torch.__version__, "gradients": gradients, "output": digits}))


main()
