#!/usr/bin/env python3
"""Measures the effect of the standard deviations of COLMAP's points. Each image is completed from a random half of its points and
compared with the other half.

    python3 scripts/colmap_points.py IMAGES MODEL [--weights anything] [--robust auto] [--every 4] [--seed 0]

Prints the mean and the median relative error, that of points nearer than the median of the image, and the share of errors below
the standard deviation of depth and point (68.3 % if correct), each without and with the standard deviations of the points; means
over images. The commands in scripts/street.py make a model of a street. Needs the Python package and numpy.
"""

import argparse
from pathlib import Path

import lsdc
import numpy as np


def errors(completion: lsdc.Completion, points: np.ndarray) -> list[float]:
    columns, rows = np.round(points[:, :2]).astype(int).T
    depth = points[:, 2]
    apart = np.abs(completion.depth[rows, columns] - depth)
    relative = apart / depth
    inside = apart < np.hypot(completion.standard_deviation[rows, columns], np.nan_to_num(points[:, 3]))
    return [relative.mean(), np.median(relative), relative[depth < np.median(depth)].mean(), inside.mean()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", type=Path)
    parser.add_argument("model", type=Path)
    parser.add_argument("--weights", default="default")
    parser.add_argument("--robust")
    parser.add_argument("--every", type=int, default=1, help="complete only every such image")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    completer, model = lsdc.Completer(given.weights, robust=given.robust), lsdc.Colmap(given.model)
    rng = np.random.default_rng(given.seed)
    rows = []
    for name in sorted(model.images)[:: given.every]:
        points = model.points(name)
        kept = rng.random(len(points)) < 0.5
        scene = completer.scene(given.images / name)
        rows.append([errors(scene.complete(points[kept][:, :columns]), points[~kept]) for columns in (3, 4)])
    print(f"{len(rows)} images: mean and median relative error, that of the near half, share below the standard deviation")
    for label, row in zip(("without", "with"), np.mean(rows, axis=0)):
        print(f"{label:8}" + "".join(f"{value:8.4f}" for value in row))


if __name__ == "__main__":
    main()
