#!/usr/bin/env python3
"""Checks how `lsdc complete` fills the holes of depth camera maps.

Reads lists of frames: CSV files with columns `set`, `rgb`, `depth` and `depth_scale_m`, whose paths are relative to the
list. Uses frames with at least 20 % of their depth measured, at most `--per-set` of each set, spread over the set.

    python3 scripts/holes.py FRAMES.csv [MORE.csv] --per-set 3 [--program target/release/lsdc] [-- OPTIONS]

Two tests for each frame:

- holes of the map itself that are enclosed by measurements (do not touch the border of the image). The range of a hole
  is that of the depths measured within 15 pixels of it. Counts pixels nearer than 0.8 times its nearest or farther than
  1.25 times its farthest depth ("outside"), and those within 1 % of one of these bounds ("at a bound"), where a clamp
  would show;
- eight rectangles of 15 to 70 pixels cut out of the map, where the truth is known: RMSE, and the share of pixels with
  an error above 25 %.

With `--given 0.1 0.5 5000`, instead, these numbers (below 1: shares) of measured pixels are drawn at random and given, and
the others are the truth. Prints the geometric mean of the frames' RMSE, and the mean share of errors within one and two
standard deviations.

Needs numpy, scipy and Pillow.
"""

import argparse
import csv
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage

ROOT = Path(__file__).resolve().parent.parent
REACH = 15
LEAST, MOST = 0.8, 1.25


def frames(lists: list[Path], per_set: int) -> list[tuple[str, Path, Path, float]]:
    """Returns set, image, depth map and metres per stored unit of some frames of every set."""
    sets: dict[str, list] = {}
    for path in lists:
        for row in csv.DictReader(path.open()):
            if row["depth"].endswith(".png") and row["depth_scale_m"]:
                files = path.parent / row["rgb"], path.parent / row["depth"]
                if all(file.is_file() for file in files):
                    frame = (row["set"], *files, float(row["depth_scale_m"]))
                    sets.setdefault(row["set"], []).append(frame)
    chosen = []
    for found in sets.values():
        step = max(1, len(found) // per_set)
        chosen += found[step // 2::step][:per_set]
    return chosen


def complete(program: str, rgb: Path, depth: np.ndarray, options: list[str]) -> list[np.ndarray]:
    """Returns the written depth map, and with `--uncertainty` the map of standard deviations."""
    with tempfile.TemporaryDirectory() as folder:
        sparse, out = Path(folder) / "sparse.npy", Path(folder) / "out"
        np.save(sparse, depth.astype(np.float32))
        command = [program, "complete", rgb, sparse, "--depth-unit", "m", "-o", out, "--quiet", *options]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return [np.load(found) for kind in ("depth", "sigma") for found in out.glob(f"*_{kind}.npy")]


def enclosed(depth: np.ndarray, filled: np.ndarray) -> tuple[int, int, int, float]:
    """Counts pixels of enclosed holes, outside the range and at a bound; returns the largest factor outside as well."""
    measured = depth > 0
    labels, _ = ndimage.label(~measured, np.ones((3, 3)))
    rim = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    total = outside = at_bound = 0
    worst = 1.0
    for label, place in enumerate(ndimage.find_objects(labels), 1):
        if label in rim:
            continue
        around = tuple(slice(max(0, s.start - REACH), s.stop + REACH) for s in place)
        hole = labels[around] == label
        near = ndimage.distance_transform_edt(~hole) <= REACH
        known = depth[around][near & measured[around]]
        if known.size == 0:
            continue
        low, high = LEAST * known.min(), MOST * known.max()
        values = filled[around][hole]
        total += values.size
        outside += int(((values < low) | (values > high)).sum())
        at_bound += int(((abs(values / low - 1) < 0.01) | (abs(values / high - 1) < 0.01)).sum())
        worst = max(worst, float((low / values).max()), float((values / high).max()))
    return total, outside, at_bound, worst


def cut(depth: np.ndarray, seed: int) -> np.ndarray:
    """Returns eight rectangles of pixels with known depth."""
    rng = np.random.default_rng(seed)
    height, width = depth.shape
    holes = np.zeros(depth.shape, bool)
    for _ in range(8):
        h, w = (int(s) for s in rng.integers(15, 71, 2) * height / 480)
        y, x = rng.integers(0, height - h), rng.integers(0, width - w)
        holes[y:y + h, x:x + w] = True
    return holes & (depth > 0)


def held_out(program: str, rgb: Path, depth: np.ndarray, given: float, options: list[str]) -> list[float]:
    """Returns the RMSE at measured pixels that are not given, and the shares of errors within one and two deviations."""
    share = given if given < 1 else given / (depth > 0).sum()
    kept = np.random.default_rng(7).random(depth.shape) < share
    filled, deviation = complete(program, rgb, np.where(kept, depth, 0), ["--uncertainty", *options])
    others = (depth > 0) & ~kept
    error = abs(filled - depth)[others]
    return [np.sqrt((error**2).mean()), *((error < k * deviation[others]).mean() for k in (1, 2))]


def print_held_out(args: argparse.Namespace, options: list[str]) -> None:
    print("| given | frames | RMSE m | within one deviation | within two |\n|---|---|---|---|---|")
    found: dict[float, list] = {given: [] for given in args.given}
    for _, rgb, path, scale in frames(args.lists, args.per_set):
        depth = np.array(Image.open(path)).astype(np.float64) * scale
        if depth.ndim == 2 and (depth > 0).mean() >= 0.2:
            for given, rows in found.items():
                rows.append(held_out(args.program, rgb, depth, given, options))
    for given, rows in found.items():
        error, one, two = np.array(rows).T
        print(f"| {given:g} | {len(rows)} | {np.exp(np.log(error).mean()):.4f} | {one.mean():.3f} | {two.mean():.3f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("lists", nargs="+", type=Path)
    parser.add_argument("--per-set", type=int, default=3)
    parser.add_argument("--program", default=str(ROOT / "target/release/lsdc"))
    parser.add_argument("--given", nargs="+", type=float)
    own = sys.argv[1:]
    options = own[own.index("--") + 1:] if "--" in own else []
    args = parser.parse_args(own[:own.index("--")] if "--" in own else own)
    if args.given:
        print_held_out(args, options)
        return
    print("| set | frames | enclosed pixels | outside | worst factor | at a bound | cut: pixels | error above 25 % | RMSE m |")
    print("|---|---|---|---|---|---|---|---|---|")
    sets: dict[str, list] = {}
    for name, rgb, path, scale in frames(args.lists, args.per_set):
        depth = np.array(Image.open(path)).astype(np.float64) * scale
        if depth.ndim != 2 or (depth > 0).mean() < 0.2:
            continue
        row = [*enclosed(depth, complete(args.program, rgb, depth, options)[0])]
        holes = cut(depth, zlib.crc32(path.name.encode()))
        truth = depth[holes]
        error = complete(args.program, rgb, np.where(holes, 0, depth), options)[0][holes] - truth
        row += [truth.size, int((abs(error) > 0.25 * truth).sum()), float((error**2).sum())]
        sets.setdefault(name, []).append(row)
    everything = []
    for name, rows in [*sets.items(), ("all", everything)]:
        everything += rows if name != "all" else []
        table = np.array(rows)
        total, outside, at_bound, worst, pixels, wrong, squares = (
            *table[:, :3].sum(0), table[:, 3].max(), *table[:, 4:].sum(0))
        print(f"| {name} | {len(rows)} | {total:.0f} | {outside:.0f} | {worst:.2f} | {at_bound:.0f} | {pixels:.0f} | "
              f"{wrong:.0f} | {np.sqrt(squares / max(pixels, 1)):.4f} |", flush=True)


if __name__ == "__main__":
    main()
