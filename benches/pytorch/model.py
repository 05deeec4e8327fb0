"""A trained model in PyTorch: reads a model.safetensors as docs/formats/model.md describes it, and predicts.

See README.md.

python model.py MODEL          # as JSON: what it was trained for, and predictions of a made-up image

MODEL may be a checkpoint, too: of its four copies of the weights the averages are taken.

Predictions are in f64. The made-up image is that of the test `pytorch` of nodes/train, which compares.
"""

import json
import pathlib
import sys

import torch

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "python"))

import tauflow.torch  # noqa: E402

HEIGHT, WIDTH, TIMES = 12, 20, (0.0, 0.4)


def numbers(size, salt):
    """The same as `made_up` of the tests."""
    i = torch.arange(size, dtype=torch.int64)
    return ((i * 7919 + salt * 104729) % 2003).double() / 1001.5 - 1.0


def main():
    solver = tauflow.torch.load(sys.argv[1])
    image = lambda channels, salt: numbers(HEIGHT * WIDTH * channels, salt).reshape(HEIGHT, WIDTH, channels)
    # Some of the light is negative, and some of the albedo.
    state = ((1 + image(3, 2001)) * (1 + image(3, 2001)) - 0.1).float().double()
    gbuffer = image(6, 2002).float().double()
    predictions = [solver.predict(state, gbuffer, tau).reshape(-1).tolist() for tau in TIMES]
    if solver.info.get("unknown_counts"):
        predictions.append(solver.predict(state, gbuffer, None).reshape(-1).tolist())
    print(json.dumps({"model": solver.info, "predictions": predictions}))


if __name__ == "__main__":
    main()
