#!/usr/bin/env python3
"""Makes tests/golden/resnet18.pth, a tiny encoder, and tests/golden/systems.json: results of PyTorch and torchvision for the
systems of the paper's comparison at tiny widths, and the numbers of parameters at the published widths.

Needs torch and torchvision:

    python3 -m venv target/golden
    target/golden/bin/pip install torch torchvision
    target/golden/bin/python scripts/golden_systems.py

Weights and inputs are chirps, which the test computes as well; only results are stored.
"""

import json
import re
import sys
from pathlib import Path

import torch
from torch import nn
from torch.nn import functional

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / "scripts/peers"))

from systems import Cspn, Lsk, ResNet, S2d, count, named  # noqa: E402

OUT = ROOT / "tests/golden/systems.json"
ENCODER = ROOT / "tests/golden/resnet18.pth"
IMAGES, HEIGHT, WIDTH = 2, 59, 91
STEP = 23
# The last gain of a residual block of three convolutions.
LAST = r"layer\d\.\d\.convs\.2\.norm\.Batch\.gain$"

# Each system with a seed for its tensors, for which no unit is so close to its threshold that rounding decides.
# After a change, choose a seed with a large clearance, which is printed.
CASES = [
    ("S2d", {"method": "s2d", "encoder": "resnet18", "decoder": "upproj", "width": 8}, 26),
    ("S2d", {"method": "s2d", "encoder": "resnet50", "decoder": "deconv3", "width": 4}, 71),
    ("Cspn", {"method": "cspn", "encoder": "resnet50", "width": 4, "steps": 24}, 86),
    ("Lsk", {"method": "lsk", "width": 4, "order": 2, "neighbours": 12}, 1287),
    ("Lsk", {"method": "lsk", "width": 2, "order": 1, "neighbours": 40, "bounded": False}, 112),
]
KINDS = {"S2d": S2d, "Cspn": Cspn, "Lsk": Lsk}


def chirp(index: int, count: int) -> torch.Tensor:
    i = torch.arange(count, dtype=torch.float64)
    return torch.sin(0.013 * i * i + 0.37 * i + index)


def build(kind: str, config: dict):
    sizes = {name: value for name, value in config.items() if name != "method"}
    return KINDS[kind](**sizes)


def fill(net, kind: str, way: int):
    """Sets all tensors from a seed; returns their names, shapes in lsdc, scales and offsets in order."""
    tensors = named(net, kind)
    listed = []
    for index, name in enumerate(sorted(tensors)):
        tensor = tensors[name]
        turned = kind == "S2d" and ".DeConv." in name and tensor.dim() == 4
        shape = list(tensor.shape)
        if turned:
            shape[:2] = shape[1::-1]
        scale, offset = 0.1, 0.0
        if tensor.dim() == 4:
            scale = (4 / (shape[1] * shape[2] * shape[3])) ** 0.5
        elif re.search(LAST, name):
            # Small: with statistics of few values, consecutive blocks amplify rounding errors.
            scale, offset = 0.05, 0.2
        elif name.endswith(("gain", "running_variance")):
            scale, offset = 0.3, 1.0
        values = offset + scale * chirp(index + 1000 * way, tensor.numel())
        # In the layout of lsdc.
        values = values.float().double().reshape(shape)
        if turned:
            values = values.flip(2, 3).transpose(0, 1)
        with torch.no_grad():
            tensor.copy_(values)
        listed.append([name, shape, scale, offset])
    return listed, tensors


def inputs():
    images = chirp(7, IMAGES * HEIGHT * WIDTH * 3).reshape(IMAGES, HEIGHT, WIDTH, 3)
    sparse = torch.zeros(IMAGES, HEIGHT * WIDTH, dtype=torch.float64)
    for image in range(IMAGES):
        for point in range(40 - 5 * image):
            place = (point * 131 + image * 57) % (HEIGHT * WIDTH)
            sparse[image, place] = 2.0 + 0.05 * (point % 17)
    images = images.float().double().permute(0, 3, 1, 2)
    return images, sparse.float().double().reshape(IMAGES, 1, HEIGHT, WIDTH)


def clearance(kind: str, config: dict, way: int) -> float:
    """Returns the distance from 0 of the nearest unit in training, in root mean squares of its layer."""
    net = build(kind, config).double()
    fill(net, kind, way)
    least = []
    cut_off = functional.relu

    def watched(x, **settings):
        least.append((x.abs().min() / x.square().mean().sqrt()).item())
        return cut_off(x, **settings)

    functional.relu = watched
    try:
        with torch.no_grad():
            net.train()(*inputs())
    finally:
        functional.relu = cut_off
    return min(least)


def case(kind: str, config: dict, way: int) -> dict:
    print(config, "way", way, "clearance", clearance(kind, config, way), flush=True)
    net = build(kind, config).double()
    listed, tensors = fill(net, kind, way)
    images, sparse = inputs()
    net.eval()
    with torch.no_grad():
        evaluated = net(images, sparse)
    net.train()
    trained = net(images, sparse)
    direction = chirp(11, trained[0].numel()).reshape(trained[0].shape)
    sum((said * direction).sum() for said in trained).backward()
    gradients = []
    for index, (name, shape, *_) in enumerate(listed):
        gradient = tensors[name].grad
        if gradient is None:
            continue
        if list(gradient.shape) != shape or ".DeConv." in name and gradient.dim() == 4:
            gradient = gradient.transpose(0, 1).flip(2, 3)
        flat = gradient.reshape(-1)
        along = (flat * chirp(1000 + index, flat.numel())).sum().item()
        gradients.append([name, flat.norm().item(), along])
    some = lambda said: [round(value, 7) for value in said.detach().flatten()[::STEP].tolist()]
    return {
        "config": config,
        "way": way,
        "tensors": listed,
        "evaluated": some(evaluated[0]),
        "trained": some(trained[0]),
        "before": some(trained[1]) if len(trained) > 1 else None,
        "gradients": gradients,
    }


def counts() -> list:
    found = []
    for encoder in ("resnet18", "resnet50"):
        for decoder in ("upproj", "deconv3"):
            config = {"method": "s2d", "encoder": encoder, "decoder": decoder}
            found.append([config, count(build("S2d", config)), 0])
    cspn = Cspn()
    found.append([{"method": "cspn"}, count(cspn), cspn.never_run()])
    lsk = Lsk()
    found.append([{"method": "lsk"}, count(lsk), 0])
    print("lsk: kernels", count(lsk.published), "refinement", count(lsk.refine))
    return found


def encoder() -> None:
    """Saves a tiny ResNet-18 as torchvision does, including classifier and counters, in float16."""
    net = ResNet("resnet18", 3, 2)
    net.fc = nn.Linear(16, 5)
    state = net.state_dict()
    for index, name in enumerate(sorted(state)):
        tensor = state[name]
        if tensor.is_floating_point():
            state[name] = chirp(index, tensor.numel()).half().reshape(tensor.shape)
    torch.save(state, ENCODER)
    print(ENCODER, ENCODER.stat().st_size, "bytes")


def main() -> None:
    torch.set_num_threads(1)
    encoder()
    golden = {
        "images": IMAGES,
        "height": HEIGHT,
        "width": WIDTH,
        "step": STEP,
        "cases": [case(*each) for each in CASES],
        "counts": counts(),
    }
    OUT.write_text(json.dumps(golden, separators=(",", ":")) + "\n")
    for config, own, never in golden["counts"]:
        print(config, own, never, own + never)
    print(OUT, OUT.stat().st_size, "bytes")


if __name__ == "__main__":
    main()
