#!/usr/bin/env python3
"""Time and error of lsdc and of methods of OpenCV and SciPy, in turns, on the room of the repository.

    pip install ./python opencv-python-headless scipy pillow
    python3 python/benchmarks/peers.py [--rounds 7]

Prints the table of python/README.md: the median time from image and sparse depths to the dense map, and the error of the
map.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from PIL import Image
from scipy.interpolate import RBFInterpolator, griddata

import lsdc

ROOM = Path(__file__).parents[2] / "assets/room"
Map = np.ndarray


def inpainted(method: int) -> Callable[[Map, Map], Map]:
    return lambda image, sparse: cv2.inpaint(sparse, (sparse == 0).astype(np.uint8), 3, method)


def grid(sparse: Map) -> tuple[Map, Map, tuple[Map, Map]]:
    v, u = np.nonzero(sparse)
    down, across = np.indices(sparse.shape)
    return np.column_stack([v, u]), sparse[v, u], (down, across)


def nearest(image: Map, sparse: Map) -> Map:
    return griddata(*grid(sparse), method="nearest")


def linear(image: Map, sparse: Map) -> Map:
    """Linear interpolation; outside the convex hull, the nearest depth."""
    between = griddata(*grid(sparse), method="linear")
    return np.where(np.isnan(between), nearest(image, sparse), between)


def cubic(image: Map, sparse: Map) -> Map:
    between = griddata(*grid(sparse), method="cubic")
    return np.where(np.isnan(between), nearest(image, sparse), between)


def thin_plates(image: Map, sparse: Map) -> Map:
    places, depths, (down, across) = grid(sparse)
    surface = RBFInterpolator(places, depths, neighbors=50)
    return surface(np.column_stack([down.ravel(), across.ravel()])).reshape(sparse.shape)


def bilateral(image: Map, sparse: Map) -> Map:
    """A joint bilateral filter: the mean of the nearest 16 depths, weighted by distance and colour similarity."""
    places, depths, (down, across) = grid(sparse)
    pixels = np.column_stack([down.ravel(), across.ravel()])
    # 500 points are few enough for a single array.
    squares = ((pixels[:, None] - places[None]) ** 2).sum(-1)
    chosen = np.argpartition(squares, 16, axis=1)[:, :16]
    far = np.take_along_axis(squares, chosen, axis=1)
    colours = image.reshape(-1, 3).astype(np.float32) / 255
    at_points = image[places[:, 0], places[:, 1]].astype(np.float32) / 255
    unlike = ((colours[:, None] - at_points[chosen]) ** 2).sum(-1)
    weights = np.exp(-far / (2 * 10.0**2) - unlike / (2 * 0.1**2)) + 1e-12 / (1 + far)
    return ((weights * depths[chosen]).sum(1) / weights.sum(1)).reshape(sparse.shape)


def methods(image: Map) -> dict[str, Callable[[Map, Map], Map]]:
    small = lsdc.Completer("small")
    scene = lsdc.Completer().scene(image)
    return {
        "`lsdc.complete`": lsdc.complete,
        '... with `weights="small"`': lambda image, sparse: small.complete(image, sparse).depth,
        "`scene.complete`, the image being known": lambda image, sparse: scene.complete(sparse).depth,
        "OpenCV `inpaint`, Telea": inpainted(cv2.INPAINT_TELEA),
        "OpenCV `inpaint`, Navier-Stokes": inpainted(cv2.INPAINT_NS),
        "SciPy `griddata`, nearest": nearest,
        "SciPy `griddata`, linear": linear,
        "SciPy `griddata`, cubic": cubic,
        "SciPy `RBFInterpolator`, thin plates": thin_plates,
        "joint bilateral filter, in NumPy": bilateral,
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=7)
    rounds = parser.parse_args().rounds
    image = np.asarray(Image.open(ROOM / "rgb.png"))
    sparse, truth = np.load(ROOM / "sparse.npy"), np.load(ROOM / "depth.npy")
    known = methods(image)
    times: dict[str, list[float]] = {name: [] for name in known}
    errors: dict[str, Map] = {}
    for _ in range(rounds + 1):
        for name, method in known.items():
            started = time.perf_counter()
            depth = method(image, sparse)
            times[name].append(time.perf_counter() - started)
            errors[name] = depth - truth
    print("| method | ms | RMSE | mean relative error |\n|---|---|---|---|")
    for name, error in errors.items():
        # The first round is a warm-up.
        milliseconds = 1000 * statistics.median(times[name][1:])
        rmse, relative = np.sqrt(np.mean(error**2)), np.mean(np.abs(error) / truth)
        print(f"| {name} | {milliseconds:.0f} | {rmse:.3f} m | {100 * relative:.1f} % |")


if __name__ == "__main__":
    main()
