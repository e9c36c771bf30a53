#!/usr/bin/env python3
"""Completes an image with the network running in ONNX Runtime, and compares the depths with those of lsdc alone.

    pip install lsdc onnxruntime pillow
    lsdc weights export default --onnx default.onnx
    python3 onnx_runtime.py default.onnx assets/room/rgb.png assets/room/sparse.npy

Any other runtime that reads ONNX can be used instead, on any device.
"""

import argparse

import numpy as np
import onnxruntime

import lsdc


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("network", help="from `lsdc weights export`")
    parser.add_argument("image")
    parser.add_argument("sparse", help="a depth map or points in metres, as for `Scene.complete`")
    parser.add_argument("--weights", default="default", help="that were exported: the fit needs their prior")
    args = parser.parse_args()

    session = onnxruntime.InferenceSession(args.network)
    completer = lsdc.Completer(args.weights)
    # Resized as for training; other sizes are possible, but less accurate.
    inputs = {"image": completer.network_input(args.image)}
    outputs = session.run(["basis", "affinities"], inputs)
    scene = completer.scene(args.image, outputs=outputs)
    depth = scene.complete(args.sparse, unit="m").depth

    alone = completer.complete(args.image, args.sparse, unit="m").depth
    difference = np.abs(depth / alone - 1).max()
    print(f"{depth.shape[1]}x{depth.shape[0]} pixels, {depth.min():.3f} to {depth.max():.3f} m")
    print(f"largest difference from lsdc alone: {difference:.1e} of the depth")


if __name__ == "__main__":
    main()
