#!/usr/bin/env python3
"""Measures the error, at the best scale, of the depth map that a network predicts from the image alone.

Reads frames of NYU Depth v2 like the protocol `nyu` (half size, a crop of 304x228), runs the network in ONNX Runtime
(`scripts/peers/network.py`), and prints means over frames of the mean relative error of its first function, at the scale
that minimises it for each frame, and of the standard deviation of log(depth / map).

    python3 scripts/map_error.py --root NYU_TREE --split val --every 4 WEIGHTS ...

Needs Python 3.10, numpy, Pillow, safetensors, onnx and onnxruntime.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime
from PIL import Image
from safetensors import safe_open

sys.path.insert(0, str(Path(__file__).parent / "peers"))
import network  # noqa: E402

WIDTH, HEIGHT, LEFT, TOP = 304, 228, 8, 6


def halved(values: np.ndarray) -> np.ndarray:
    image = Image.fromarray(values.astype(np.float32)).resize((320, 240), Image.Resampling.BILINEAR)
    return np.asarray(image)[TOP : TOP + HEIGHT, LEFT : LEFT + WIDTH]


def read(image: Path) -> tuple[np.ndarray, np.ndarray]:
    """Returns colours from 0 to 1, and depths in metres, 0 if unknown."""
    with Image.open(image) as opened:
        small = opened.convert("RGB").resize((320, 240), Image.Resampling.BILINEAR)
    colours = np.asarray(small.crop((LEFT, TOP, LEFT + WIDTH, TOP + HEIGHT)), np.float64) / 255
    with Image.open(image.with_name(f"{image.stem}_depth.png")) as opened:
        depth = np.asarray(opened, np.float32) / 1000
    # Depths interpolated from holes are unknown.
    return colours, np.where(halved(depth == 0) > 0, 0, halved(depth))


def errors(predicted: np.ndarray, depth: np.ndarray) -> tuple[float, float]:
    known = depth > 0
    logs = np.log(depth[known] / predicted[known])
    # The smallest sum of |s p - z| / z has the weighted median of z / p as s, by weights p / z.
    order = np.argsort(logs)
    weights = np.cumsum(np.exp(-logs[order]))
    scale = np.exp(logs[order][np.searchsorted(weights, weights[-1] / 2)])
    return float(np.mean(np.abs(scale * np.exp(-logs) - 1))), float(logs.std())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("weights", nargs="+")
    parser.add_argument("--root", type=Path, required=True, help="tree of NYU Depth v2 with train and val")
    parser.add_argument("--split", default="val")
    parser.add_argument("--every", type=int, default=1, help="only every such frame")
    args = parser.parse_args()
    images = sorted((args.root / args.split).glob("*/*.jpg"))[:: args.every]
    if not images:
        parser.error(f"no frames SCENE/FRAME.jpg in {args.root / args.split}")
    print("| weights | frames | REL | deviation of the logarithm |\n|---|---|---|---|")
    for weights in args.weights:
        with safe_open(weights, "numpy") as file:
            metadata = file.metadata()
        settings = json.loads(metadata["network"])
        if not settings.get("mean") or settings["extractor"].get("encoder"):
            parser.error(f"{weights} predicts no map of depth by itself")
        normalisation = json.loads(metadata["normalisation"])
        mean, deviation = (np.array(normalisation[key]) for key in ("mean", "deviation"))
        model = network.build(weights, HEIGHT, WIDTH).SerializeToString()
        session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
        found = []
        for image in images:
            colours, depth = read(image)
            tensor = ((colours - mean) / deviation).transpose(2, 0, 1)[None].astype(np.float32)
            functions = session.run(None, {"image": tensor})[0]
            found.append(errors(functions[0, 0], depth))
        rel, spread = np.mean(found, axis=0)
        print(f"| {weights} | {len(images)} | {rel:.4f} | {spread:.4f} |", flush=True)


if __name__ == "__main__":
    main()
