#!/usr/bin/env python3
"""Weights on datasets that they have not seen: the shipped method beside untrained baselines.

Takes folders of FRAME.jpg (or .png) and 16-bit FRAME_depth.png, each with the metres of a stored
unit after a colon where these are not millimetres, and prints a table, with the geometric mean over
sets of the ratios to the RMSE of linear interpolation.

    python3 scripts/generalise.py -o results redwood tum_desk kitti:0.00390625
    python3 scripts/generalise.py -o results --points 200 --weights runs/mine/weights.safetensors DIR

Needs Python 3.10 and nothing else.
"""

import argparse
import json
import math
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
METHODS = ["lsdc", "linear", "wls"]


def measure(args: argparse.Namespace, folder: Path, scale: str) -> list[dict]:
    report = args.output / f"{folder.name}-{args.points}.json"
    if not report.exists():
        # The colour files of a set have one ending.
        ending = "jpg" if any(folder.glob("*.jpg")) else "png"
        command = [args.program, "eval", "--dataset", "folder", "--root", folder,
                   "--set", f'data.folder.rgb="{{frame}}.{ending}"',
                   "--set", 'data.folder.depth="{frame}_depth.png"',
                   "--set", f"data.folder.depth_scale={scale}",
                   "--points", str(args.points), "--method", ",".join(METHODS), "--json", report]
        if args.weights:
            command += ["--weights", args.weights]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return json.loads(report.read_text())["frames"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", nargs="+", metavar="DIR[:METRES]")
    parser.add_argument("--points", type=int, default=500)
    parser.add_argument("--weights")
    parser.add_argument("--program", default=str(ROOT / "target/release/lsdc"))
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    heads = [f"{m} {score}" for score in ("RMSE", "REL") for m in METHODS]
    print("| set | frames | " + " | ".join(heads) + " |\n|" + "---|" * (2 + len(heads)))
    ratios = []
    for text in args.folders:
        path, _, scale = text.partition(":")
        frames = measure(args, Path(path), scale or "0.001")
        mean = lambda m, s: sum(f["scores"][m][s] for f in frames) / len(frames)
        cells = [f"{mean(m, s):.4f}" for s in ("rmse", "rel") for m in METHODS]
        ratios.append(math.log(mean("lsdc", "rmse") / mean("linear", "rmse")))
        print(f"| {Path(path).name} | {len(frames)} | " + " | ".join(cells) + " |", flush=True)
    print(f"\nRMSE of lsdc / linear, geometric mean: {math.exp(sum(ratios) / len(ratios)):.3f}")


if __name__ == "__main__":
    main()
