#!/usr/bin/env python3
"""What each part of the network, the fit and the training is worth, on equal budgets.

Trains one variant after the other from the same seed, measures each on test frames, and prints a
table. What exists is not done again: stop and go on as you like.

    python3 scripts/ablation.py --root NYU_TREE --steps 1000 -o ablation
    python3 scripts/ablation.py --root NYU_TREE --steps 1000 -o ablation --only joint,lse,wls
    python3 scripts/ablation.py --list

Needs Python 3.11 and nothing else.
"""

import argparse
import json
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# The medium network; presets cannot be changed in part.
NETWORK = {
    "extractor": {
        "stem": 32,
        "stages": [
            {"width": 32, "blocks": 3},
            {"width": 64, "blocks": 4},
            {"width": 128, "blocks": 3},
            {"width": 128, "blocks": 3},
        ],
        "pools": [32, 16, 8, 4],
        "branch": 32,
        "merge": 128,
        "features": 32,
    },
    "octaves": 5,
    "hidden": [128, 128],
    "bases": 128,
    "detail": 16,
    "norm": "batch",
}


def bases(count: int) -> dict:
    # The last hidden layer is at least as wide as there are base functions.
    return {"network": {"bases": count, "hidden": [128, max(128, count)]}}


# Changes of the first one, by name.
VARIANTS = {
    "joint": {},
    "lse": {"fit": {"method": "lse", "ridge": 1e-4}, "train": {"loss": {"edges": 0.0}}},
    "wls": {"fit": {"method": "wls"}},
    "edges of colours alone": {"network": {"detail": 0}},
    "no edge loss": {"train": {"loss": {"edges": 0.0}}},
    "absolute loss alone": {"train": {"loss": {"l2": 0.0}}},
    "squared loss alone": {"train": {"loss": {"l1": 0.0}}},
    "no gradient loss": {"train": {"loss": {"gradient": 0.0}}},
    "two draws": {"train": {"supervision": {"draws": 2}}},
    "average of steps": {"train": {"average": 0.995}},
    "from scratch": {"train": {"start": None}},
    "no augmentation": {
        "train": {"augment": {"zoom": 1.0, "rotation": 0.0, "mirror": 0.0, "jitter": 0.0}}
    },
    **{f"N = {n}": bases(n) for n in (16, 32, 64, 256, 512)},
    "no position": {"network": {"octaves": 0}},
    "raw position": {"network": {"octaves": 1}},
    **{f"E = {e}": {"network": {"octaves": e}} for e in (3, 4, 6, 7, 8)},
}


def laid_over(base: dict, changes: dict) -> dict:
    merged = dict(base)
    for key, value in changes.items():
        if value is None:
            merged.pop(key, None)
        elif isinstance(value, dict) and isinstance(merged.get(key), dict):
            merged[key] = laid_over(merged[key], value)
        else:
            merged[key] = value
    return merged


def toml(table: dict, name: str = "") -> str:
    """Enough of TOML for settings: tables of numbers, strings, arrays and inline tables."""
    def value(v) -> str:
        if isinstance(v, dict):
            return "{ " + ", ".join(f"{k} = {value(x)}" for k, x in v.items()) + " }"
        if isinstance(v, list):
            return "[" + ", ".join(map(value, v)) + "]"
        return json.dumps(v)

    plain = {k: v for k, v in table.items() if not isinstance(v, dict)}
    text = f"[{name}]\n" if name else ""
    text += "".join(f"{k} = {value(v)}\n" for k, v in plain.items()) + "\n"
    for key, inner in table.items():
        if isinstance(inner, dict):
            text += toml(inner, f"{name}.{key}" if name else key)
    return text


def settings(args: argparse.Namespace, name: str) -> dict:
    base = tomllib.loads((ROOT / "configs/nyu-joint.toml").read_text())
    base.pop("preset")
    base["network"] = NETWORK
    common = {"train": {"steps": args.steps, "measure_every": args.steps, "start": args.start}}
    return laid_over(laid_over(base, common), VARIANTS[name])


def folder_of(args: argparse.Namespace, name: str) -> Path:
    return args.output / name.replace(" = ", "").replace(" ", "-")


def train(args: argparse.Namespace, name: str) -> Path:
    folder = folder_of(args, name)
    weights = folder / "run/weights.safetensors"
    if weights.exists():
        return weights
    folder.mkdir(parents=True, exist_ok=True)
    config = folder / "settings.toml"
    run = [args.program, "train", "--device", args.device]
    if (folder / "run/config.toml").exists():
        run += ["--resume", folder / "run"]
    else:
        config.write_text(toml(settings(args, name)))
        run += ["--config", config, "--root", args.root, "-o", folder / "run"]
    subprocess.run(run, check=True, stdout=sys.stderr)
    return weights


def measure(args: argparse.Namespace, weights: Path, points: int) -> dict:
    report = weights.parent.parent / f"{points}.json"
    if not report.exists():
        command = [args.program, "eval", "--dataset", "nyu", "--root", args.root, "--weights",
                   weights, "--points", str(points), "--method", "lsdc", "--json", report]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    frames = json.loads(report.read_text())["frames"]
    return {m: sum(f["scores"]["lsdc"][m] for f in frames) / len(frames) for m in ("rmse", "rel")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--root", help="tree of NYU Depth v2 with train and val")
    parser.add_argument("--steps", type=int, default=1000, help="of each variant")
    parser.add_argument("--start", help="weights to start from [default: none]")
    parser.add_argument("--only", help="names of variants, with commas [default: all]")
    parser.add_argument("--task", type=int, help="only the variant of this number, from 0")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--program", default=str(ROOT / "target/release/lsdc"))
    parser.add_argument("-o", "--output", type=Path, default=Path("ablation"))
    parser.add_argument("--list", action="store_true", help="print the names and stop")
    args = parser.parse_args()
    names = args.only.split(",") if args.only else list(VARIANTS)
    if args.task is not None:
        names = [names[args.task]]
    if args.list:
        print("\n".join(f"{i:3} {name}" for i, name in enumerate(names)))
        return
    if not args.root:
        parser.error("--root is needed")
    print("| variant | RMSE 500 | REL 500 | RMSE 50 | REL 50 |\n|---|---|---|---|---|")
    for name in names:
        weights = train(args, name)
        many, few = measure(args, weights, 500), measure(args, weights, 50)
        cells = [many["rmse"], many["rel"], few["rmse"], few["rel"]]
        print(f"| {name} | " + " | ".join(f"{v:.4f}" for v in cells) + " |", flush=True)


if __name__ == "__main__":
    main()
