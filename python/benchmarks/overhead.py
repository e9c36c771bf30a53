#!/usr/bin/env python3
"""Overhead of Python: imports, calls, and many threads.

    python3 python/benchmarks/overhead.py [--images 48]

Prints the median time of `import lsdc` and of NumPy alone in new processes; the time of calls minus the time measured by
the library; and images per second with eight Python threads, for comparison with

    cargo run --release -p lsdc-core -p lsdc-python --example batch IMAGES
"""

import argparse
import statistics
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from PIL import Image

import lsdc

ROOM = Path(__file__).parents[2] / "assets/room"


def importing(module: str) -> float:
    """Returns the seconds of an import, measured in a new process."""
    script = f"import time; t = time.perf_counter(); import {module}; print(time.perf_counter() - t)"
    runs = [subprocess.run([sys.executable, "-c", script], capture_output=True, check=True) for _ in range(9)]
    return statistics.median(float(run.stdout) for run in runs)


def calling(image: np.ndarray, sparse: np.ndarray) -> tuple[float, float]:
    """Returns the seconds of a scene and a fit, and the part spent outside the library."""
    completer = lsdc.Completer()
    whole, outside = [], []
    for _ in range(30):
        started = time.perf_counter()
        scene = completer.scene(image)
        completion = scene.complete(sparse)
        seconds = time.perf_counter() - started
        whole.append(seconds)
        outside.append(seconds - completion.report["network"] - completion.report["fit"])
    return statistics.median(whole), statistics.median(outside)


def throughput(image: np.ndarray, sparse: np.ndarray, count: int) -> float:
    """Returns images per second, as in crates/core/examples/batch.rs."""
    completer = lsdc.Completer("small")
    images = [np.minimum(image.astype(int) + i % 4 * 10, 255).astype(np.uint8) for i in range(count)]

    def work(image: np.ndarray) -> np.ndarray:
        return completer.complete(image, sparse).depth

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(work, images[:8]))
        started = time.perf_counter()
        list(pool.map(work, images))
        return count / (time.perf_counter() - started)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--images", type=int, default=48)
    count = parser.parse_args().images
    image, sparse = np.asarray(Image.open(ROOM / "rgb.png")), np.load(ROOM / "sparse.npy")
    print(f"import numpy: {importing('numpy'):.3f} s, import lsdc: {importing('lsdc'):.3f} s")
    whole, outside = calling(image, sparse)
    print(f"scene and fit: {1e3 * whole:.1f} ms, of which {1e3 * outside:.2f} ms outside the library")
    print(f"eight threads: {throughput(image, sparse, count):.1f} images a second")


if __name__ == "__main__":
    main()
