#!/usr/bin/env python3
"""Makes tests/golden/backbone.json: PyTorch's results for the first stages of EfficientNet-Lite0.

Needs torch:

    python3 -m venv target/golden
    target/golden/bin/pip install torch
    target/golden/bin/python scripts/golden_backbone.py

Weights, with the published names, and the image are chirps, which the test computes as well; only results are stored. The
published network also clamps activations at 6; this script and lsdc do not.
"""

import json
from pathlib import Path

import torch
from torch.nn import functional

OUT = Path(__file__).resolve().parent.parent / "tests/golden/backbone.json"
HEIGHT, WIDTH, STEP = 37, 50, 29
# Expansion, taps, stride, channels of the input and of the output.
BLOCKS = [(1, 3, 1, 32, 16), (6, 3, 2, 16, 24), (6, 3, 1, 24, 24), (6, 5, 2, 24, 40), (6, 5, 1, 40, 40)]
READ = [2, 4]


def chirp(index: int, *shape: int) -> torch.Tensor:
    i = torch.arange(torch.Size(shape).numel(), dtype=torch.float64)
    return torch.sin(0.013 * i * i + 0.37 * i + index).reshape(shape)


def main() -> None:
    index = 0

    def layer(x, to, taps, stride=1, groups=1, relu=True):
        nonlocal index
        inputs = x.shape[1] // groups
        weight = chirp(index, to, inputs, taps, taps) * (2 / (inputs * taps * taps)) ** 0.5
        gain, shift, mean, variance = (chirp(index + k, to) for k in range(1, 5))
        index += 5
        x = functional.conv2d(x, weight, stride=stride, padding=taps // 2, groups=groups)
        x = functional.batch_norm(
            x, 0.1 * mean, 1 + 0.5 * variance, 1 + 0.3 * gain, 0.1 * shift, eps=1e-3
        )
        return functional.relu(x) if relu else x

    x = layer(chirp(1000, 1, 3, HEIGHT, WIDTH), 32, 3, stride=2)
    answers = []
    for i, (expansion, taps, stride, inputs, outputs) in enumerate(BLOCKS):
        inner = expansion * inputs
        y = layer(x, inner, 1) if expansion > 1 else x
        y = layer(y, inner, taps, stride, groups=inner)
        y = layer(y, outputs, 1, relu=False)
        x = x + y if stride == 1 and inputs == outputs else y
        if i in READ:
            # In the order [height, width, channels].
            values = x[0].permute(1, 2, 0).flatten()[::STEP]
            answers.append({"shape": list(x.shape), "values": [round(v, 7) for v in values.tolist()]})
    OUT.write_text(json.dumps(answers) + "\n")


if __name__ == "__main__":
    main()
