#!/usr/bin/env python3
"""Compares the networks of `lsdc weights export` in ONNX Runtime with lsdc's own, at several sizes.

    python3 scripts/peers/export_onnx.py --sizes 304x228,412x308,161x97

Needs `cargo build --release` and the Python package of this repository (`pip install ./python`) with numpy, onnx and
onnxruntime. Checks the graphs with `onnx.checker`, then prints for each of the weights and sizes the largest relative
differences: of basis functions, relative to the largest value of each function, and of the depths and standard deviations of
a completion of points at pixel centres, which depend on the affinities. Fails if one exceeds 1e-4. `between` is the difference
of depths for points between pixels, which has no limit: lsdc computes basis functions at the point, but outputs are
interpolated. Times of the network are medians of several runs.
"""

import argparse
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import lsdc
import numpy as np
import onnx
import onnxruntime

ROOT = Path(__file__).resolve().parents[2]
TOLERANCE = 1e-4


def room(width: int, height: int) -> np.ndarray:
    """Returns patches of different colours with soft and hard edges, and noise."""
    generator = np.random.default_rng(1)
    down, across = np.mgrid[:height, :width] / max(width, height)
    image = np.stack([0.3 + 0.4 * across, 0.6 - 0.3 * down, 0.5 + 0.2 * np.sin(9 * across * down)], -1)
    for _ in range(12):
        x, y = generator.uniform(0, [across.max(), down.max()])
        inside = (np.abs(across - x) < generator.uniform(0.02, 0.2)) & (np.abs(down - y) < generator.uniform(0.02, 0.2))
        image[inside] = 0.3 * image[inside] + 0.7 * generator.uniform(0, 1, 3)
    image += generator.normal(0, 0.01, image.shape)
    return (255 * image.clip(0, 1)).round().astype(np.uint8)


def points(width: int, height: int, count: int = 300) -> np.ndarray:
    generator = np.random.default_rng(2)
    x, y = generator.uniform(0, [width - 1, height - 1], (count, 2)).T
    return np.stack([x, y, 2 + x / width + 0.5 * np.sin(5 * y / height)], -1)


def milliseconds(run, count: int = 7) -> float:
    times = []
    for _ in range(count):
        started = time.perf_counter()
        run()
        times.append(1e3 * (time.perf_counter() - started))
    return statistics.median(times)


def compare(session: onnxruntime.InferenceSession, weights: str, width: int, height: int) -> float:
    """Prints the differences, and returns the largest."""
    completer = lsdc.Completer(weights, working_size=(width, height))
    image = room(width, height)
    inputs = {"image": completer.network_input(image)}
    assert inputs["image"].shape == (1, 3, height, width)
    basis, affinities = session.run(["basis", "affinities"], inputs)
    own, other = completer.scene(image), completer.scene(image, outputs=(basis, affinities))
    y, x = np.mgrid[:height, :width]
    exact = own.basis_functions(np.stack([x.ravel(), y.ravel()], -1)).T.reshape(basis[0].shape)
    scale = np.abs(exact).max((1, 2), keepdims=True)
    between = points(width, height)
    centred = between.copy()
    centred[:, :2] = centred[:, :2].round()
    # Keep one depth per pixel.
    centred = centred[np.unique(centred[:, :2], axis=0, return_index=True)[1]]

    def apart(known: np.ndarray, what: str) -> float:
        expected, found = (getattr(scene.complete(known), what) for scene in (own, other))
        return np.abs(found / expected - 1).max()

    differences = {
        "basis": np.abs((basis[0] - exact) / scale).max(),
        "depth": apart(centred, "depth"),
        "sigma": apart(centred, "standard_deviation"),
    }
    unbounded = {"between": apart(between, "depth")}
    texts = [f"{name} {value:.1e}" for name, value in (differences | unbounded).items()]
    ours = milliseconds(lambda: completer.scene(image))
    theirs = milliseconds(lambda: session.run(None, inputs))
    print(f"{weights:<8} {width}x{height}  {'  '.join(texts)}  lsdc {ours:.0f} ms, ONNX Runtime {theirs:.0f} ms")
    return max(differences.values())


def main() -> None:
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("--sizes", default="304x228,412x308,161x97", help="WIDTHxHEIGHT, separated by commas")
    parser.add_argument("--weights", default="default,small", help="names or files, separated by commas")
    parser.add_argument("--lsdc", default=str(ROOT / "target/release/lsdc"))
    args = parser.parse_args()
    worst = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for weights in args.weights.split(","):
            path = Path(folder) / "network.onnx"
            subprocess.run([args.lsdc, "-q", "weights", "export", weights, "--force", "--onnx", path], check=True)
            onnx.checker.check_model(str(path), full_check=True)
            session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
            for size in args.sizes.split(","):
                width, height = map(int, size.split("x"))
                worst = max(worst, compare(session, weights, width, height))
    if worst > TOLERANCE:
        raise SystemExit(f"the largest difference is {worst:.1e}, more than {TOLERANCE:.0e}")


if __name__ == "__main__":
    main()
