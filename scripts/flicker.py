#!/usr/bin/env python3
"""Measures error and flicker of videos with few points, with and without `lsdc complete --temporal`.

Exports frames of a dataset and makes two kinds of video: `still`, each frame repeated with grain on the image, and
`moving`, the frames in order. Each image has its own points. Flicker is the standard deviation of a pixel over a still
video, in metres, averaged.

    pip install numpy opencv-python-headless
    python3 scripts/flicker.py --dataset nyu --root DIR [--program PROGRAM] [--points 5,20,50,200]
"""

import argparse
import subprocess
import tempfile
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
# Number of images of a still video, and the strength of their grain, in levels of 255.
LENGTH, GRAIN = 10, 3.0


def write(folder: Path, image: np.ndarray, depth: np.ndarray, name: str, points: int, noise: np.random.Generator) -> None:
    for part in ("images", "points"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    seen = np.clip(image + noise.normal(0, GRAIN, image.shape), 0, 255).astype(np.uint8)
    cv2.imwrite(str(folder / f"images/{name}.png"), seen)
    v, u = np.nonzero(depth)
    chosen = noise.choice(len(u), points, replace=False)
    sparse = np.zeros_like(depth)
    sparse[v[chosen], u[chosen]] = depth[v[chosen], u[chosen]]
    np.save(folder / f"points/{name}.npy", sparse)


def complete(program: str, folder: Path, out: str, *more: str) -> np.ndarray:
    args = [program, "complete", folder / "images", folder / "points", "-o", folder / out, "--formats", "npy", "-q", *more]
    subprocess.run(list(map(str, args)), check=True)
    return np.stack([np.load(path) for path in sorted((folder / out).glob("*_depth.npy"))])


def rmse(found: np.ndarray, truth: np.ndarray) -> float:
    off = [np.sqrt(((a - b)[b > 0] ** 2).mean()) for a, b in zip(found, truth)]
    return float(np.mean(off))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", default="nyu")
    parser.add_argument("--root", required=True)
    parser.add_argument("--split", default="train")
    parser.add_argument("--program", default=str(ROOT / "target/release/lsdc"))
    parser.add_argument("--points", default="5,20,50,200")
    parser.add_argument("--limit", type=int, default=12)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        at = Path(temporary)
        subprocess.run([args.program, "export", "--dataset", args.dataset, "--root", args.root, "--split", args.split,
                        "--limit", str(args.limit), "-o", str(at / "frames")], check=True, stdout=subprocess.DEVNULL)
        images = sorted((at / "frames/rgb").rglob("*.png"))
        truths = sorted((at / "frames/gt").rglob("*.npy"))
        assert len(images) == len(truths) > 1, (len(images), len(truths))
        frames = [(cv2.imread(str(i)).astype(np.float64), np.load(t)) for i, t in zip(images, truths)]
        print("| points | video | RMSE, each alone | with --temporal | flicker, each alone | with --temporal |")
        print("|---|---|---|---|---|---|")
        for points in map(int, args.points.split(",")):
            noise = np.random.default_rng(points)
            scores = []
            for number, (image, truth) in enumerate(frames):
                folder = at / f"still-{points}-{number}"
                for i in range(LENGTH):
                    write(folder, image, truth, f"{i:04}", points, noise)
                both = [complete(args.program, folder, "alone"), complete(args.program, folder, "chain", "--temporal")]
                scores.append([(rmse(found, [truth] * LENGTH), found.std(axis=0).mean()) for found in both])
            (error, flicker), (error_chain, flicker_chain) = np.mean(scores, axis=0)
            print(f"| {points} | still | {error:.3f} | {error_chain:.3f} | {flicker:.3f} | {flicker_chain:.3f} |", flush=True)
            folder = at / f"moving-{points}"
            for i, (image, truth) in enumerate(frames):
                write(folder, image, truth, f"{i:04}", points, noise)
            truth = [truth for _, truth in frames]
            alone, chain = complete(args.program, folder, "alone"), complete(args.program, folder, "chain", "--temporal")
            print(f"| {points} | moving | {rmse(alone, truth):.3f} | {rmse(chain, truth):.3f} | | |", flush=True)


if __name__ == "__main__":
    main()
