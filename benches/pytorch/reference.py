"""What PyTorch makes of our network: outputs and gradients for made-up weights and inputs, for the project's tests.

python reference.py > ../../nodes/train/src/network/pytorch.json

Weights have our names and layouts (see docs/formats/model.md), and PyTorch's autograd goes back to them.
"""

import json
import math

import torch

from model import numbers

from tauflow._network import CHANNELS, CLOCK, bases, network, shapes, state_dict

SIDE, PRESET = 16, "tiny"


def main():
    torch.set_default_dtype(torch.float64)
    net = network(PRESET)
    ours = {}
    for salt, (name, shape) in enumerate(sorted(shapes(PRESET, CHANNELS).items())):
        scale = 0.1 if name.endswith("bias") else 1.5 / math.sqrt(shape[0])
        ours[name] = (numbers(math.prod(shape), salt) * scale).float().double().reshape(shape).requires_grad_()
    theirs = state_dict(ours, PRESET)
    assert {name: w.shape for name, w in theirs.items()} == {name: w.shape for name, w in net.named_parameters()}
    double = lambda count, salt: numbers(count, salt).float().double()
    image = lambda channels, salt: double(SIDE * SIDE * channels, salt).reshape(1, SIDE, SIDE, channels)
    first = lambda x: x.permute(0, 3, 1, 2)
    inputs = [first(image(CHANNELS, 1001)), numbers(CLOCK, 1002).float().double().reshape(1, CLOCK)]
    inputs += [bases(first(image(3, 1003))), first(image(3, 1004)), first(image(3, 1007))]
    inputs += [torch.full((1, 1, 1, 1), -1.5)]
    output = torch.func.functional_call(net, theirs, tuple(inputs)).permute(0, 2, 3, 1)
    (output * image(3, 1005)).sum().backward()
    gradients = {}
    for name, weight in ours.items():
        found = weight.grad.reshape(-1)
        gradients[name] = [float(f"{v:.9g}") for v in (found.norm(), (found * numbers(found.numel(), 1006)).sum())]
    digits = [float(f"{v:.7g}") for v in output.reshape(-1).tolist()]
    print(json.dumps({"pytorch": torch.__version__, "gradients": gradients, "output": digits}))


main()
