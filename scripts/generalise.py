#!/usr/bin/env python3
"""Evaluates weights on datasets that were not used for training, compared with untrained methods.

Takes folders of FRAME.jpg (or .png) and 16-bit FRAME_depth.png, followed by a colon and the metres per stored unit
unless these are millimetres, or of scans (FRAME_points.npz, docs/evaluation.md; protocol `scans-filtered`). Prints the
scores of all methods on every set with the ratio of `lsdc` to the best other method, and the geometric means over sets of
its ratios to each. Reports in the output folder are reused if they were made by the same command.

    python3 scripts/generalise.py -o results redwood tum_desk kitti:0.00390625
    python3 scripts/generalise.py -o results --points grid:16 --set fit.joint.surface=false DIR
    python3 scripts/generalise.py -o results --hold-out ring:4 scans/*

Needs only Python 3.10.
"""

import argparse
import hashlib
import json
import math
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SCORES = ["rmse", "mae", "rel"]
BASELINES = ["linear", "linear-inverse", "wls"]
# Other fits with the same weights.
FITS = {"field": ["--fit", "field"], "without a surface": ["--set", "fit.joint.surface=false"]}
OTHERS = [*BASELINES, *FITS]


def evaluate(args: argparse.Namespace, folder: Path, scale: str, fit: str) -> list[dict]:
    if any(folder.glob("*_points.npz")):
        data = ["--dataset", "scans", "--root", folder, "--protocol", "scans-filtered"]
    else:
        # All colour files of a set have the same ending.
        ending = "jpg" if any(folder.glob("*.jpg")) else "png"
        data = ["--dataset", "folder", "--root", folder,
                "--set", f'data.folder.rgb="{{frame}}.{ending}"',
                "--set", 'data.folder.depth="{frame}_depth.png"',
                "--set", f"data.folder.depth_scale={scale}"]
    given = ["--hold-out", args.hold_out] if args.hold_out else ["--points", args.points]
    methods = "lsdc" if fit in FITS else ",".join(["lsdc", *BASELINES])
    command = [args.program, "eval", *data, *given, "--method", methods, *args.rest, *FITS.get(fit, [])]
    made_by = hashlib.sha256(repr([str(word) for word in command]).encode()).hexdigest()[:12]
    report = args.output / f"{folder.name}-{made_by}.json"
    if not report.exists():
        subprocess.run([*command, "--json", report], check=True, stdout=subprocess.DEVNULL)
    return json.loads(report.read_text())["frames"]


def measure(args: argparse.Namespace, folder: Path, scale: str) -> tuple[int, dict[str, dict[str, float]]]:
    """Returns the number of frames, and the mean of every score by method."""
    frames = evaluate(args, folder, scale, "lsdc")
    mean = lambda frames, method: {
        score: sum(f["scores"][method][score] for f in frames) / len(frames) for score in SCORES}
    found = {method: mean(frames, method) for method in ["lsdc", *BASELINES]}
    return len(frames), found | {fit: mean(evaluate(args, folder, scale, fit), "lsdc") for fit in FITS}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", nargs="+", metavar="DIR[:METRES]")
    parser.add_argument("--points", default="500")
    parser.add_argument("--hold-out")
    parser.add_argument("--weights")
    parser.add_argument("--set", action="append", default=[], help="a setting of `lsdc eval`")
    parser.add_argument("--program", default=str(ROOT / "target/release/lsdc"))
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args()
    args.rest = [word for setting in args.set for word in ("--set", setting)]
    args.rest += ["--weights", args.weights] if args.weights else []
    args.output.mkdir(parents=True, exist_ok=True)

    heads = ["set", "frames", "score", "lsdc", *OTHERS, "lsdc / best of the others"]
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    ratios: dict[str, dict[str, list[float]]] = {m: {s: [] for s in SCORES} for m in [*OTHERS, "the best"]}
    for text in args.folders:
        path, _, scale = text.partition(":")
        count, found = measure(args, Path(path), scale or "0.001")
        for score in SCORES:
            own, others = found["lsdc"][score], {m: found[m][score] for m in OTHERS}
            best = min(others, key=others.get)
            for method, value in [*others.items(), ("the best", others[best])]:
                ratios[method][score].append(math.log(own / value))
            cells = [f"{value:.4f}" for value in [own, *others.values()]]
            cells = [Path(path).name, str(count), score.upper(), *cells, f"{own / others[best]:.3f}"]
            print("| " + " | ".join(cells) + " |", flush=True)

    print("\nGeometric mean of lsdc / method:\n| method | " + " | ".join(s.upper() for s in SCORES) + " |")
    print("|" + "---|" * (1 + len(SCORES)))
    for method, found in ratios.items():
        means = [f"{math.exp(sum(found[s]) / len(found[s])):.3f}" for s in SCORES]
        print(f"| {method} | " + " | ".join(means) + " |")


if __name__ == "__main__":
    main()
