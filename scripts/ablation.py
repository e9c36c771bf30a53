#!/usr/bin/env python3
"""Measures the effect of each part of the network, the fit and the training, with equal budgets.

Trains one variant after the other from the same seed, evaluates each on test frames, and prints a table. Existing
results are reused, so the script can be interrupted and restarted. Variants of `nyu-affinities.toml` and
`nyu-joint.toml` learn affinities and start from weights with basis functions; those of `nyu-half.toml` learn basis
functions; those of `nyu-map.toml` learn a depth map in addition to the basis functions of the start; those of
`nyu-lite.toml` ("further") start from the weights `default`. Some use the weights `anything` as a teacher.
FRAMES/SET/FRAME.jpg and FRAME_depth.png are further frames, PHOTOS/SET/FRAME.jpg photographs without depths.

    python3 scripts/ablation.py --root NYU_TREE --more FRAMES --photos PHOTOS --backbone FILE \\
        --start WEIGHTS -o ablation
    python3 scripts/ablation.py --root NYU_TREE --steps 1000 -o ablation --only 'bases;N=16'
    python3 scripts/ablation.py --root NYU_TREE --more FRAMES --steps 300 -o ablation --points 500 50 5 --only further
    python3 scripts/ablation.py --list

Needs only Python 3.11.
"""

import argparse
import contextlib
import json
import subprocess
import sys
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# The sharp network without its affinities; presets cannot be modified.
NETWORK = {
    "extractor": {
        "stem": 16,
        "stages": [
            {"width": 16, "blocks": 2},
            {"width": 32, "blocks": 6},
            {"width": 64, "blocks": 2},
            {"width": 64, "blocks": 1},
        ],
        "pools": [32, 16, 8, 4],
        "branch": 16,
        "merge": 64,
        "features": 64,
        "sharpening": 2,
    },
    "octaves": 5,
    "hidden": [128, 128],
    "bases": 128,
    "affinities": 0,
    "norm": "batch",
}
# The extractor of the medium network.
MEDIUM = {
    "stem": 32,
    "stages": [
        {"width": 32, "blocks": 3},
        {"width": 64, "blocks": 4},
        {"width": 128, "blocks": 3},
        {"width": 128, "blocks": 3},
    ],
    "branch": 32,
    "merge": 128,
}
# Additions of the lite network to the extractor: stages for context, and a pretrained backbone.
LITE = {
    "context": [
        {"width": 96, "blocks": 1},
        {"width": 128, "blocks": 2},
        {"width": 192, "blocks": 1},
    ],
    "backbone": {"stages": 5, "decoder": 64},
}
# Placeholders of command-line arguments.
FRAMES, FEWER, PHOTOS = "FRAMES", "FEWER", "PHOTOS"
OTHERS = {
    "dataset": "folder",
    "root": FRAMES,
    "share": 0.4,
    "folder": {"rgb": "{set}/{frame}.jpg", "depth": "{set}/{frame}_depth.png"},
}
IMAGES = {
    "dataset": "folder",
    "root": PHOTOS,
    "share": 0.4,
    "folder": {"rgb": "{set}/{frame}.jpg", "depth": ""},
}
NO_AUGMENTATION = {"zoom": 1.0, "rotation": 0.0, "mirror": 0.0, "jitter": 0.0}
FLAWS = {
    "shrink": 0.7,
    "grey": 0.1,
    "blur": {"chance": 0.2, "most": 1.5},
    "noise": {"chance": 0.2, "most": 8.0},
    "compression": {"chance": 0.2, "most": 60.0},
}
# Their networks predict a depth map from the image: the prior is learned on the frames of its use.
OWN_PRIOR = ("nyu-lite", "nyu-map")
# Rendered at the input size of half-size images.
ROOMS = {"dataset": "rooms", "rooms": {"train": 800, "width": 160, "height": 120}}


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


@dataclass
class Variant:
    """A configuration and its changes, or the weights of another variant."""
    config: str = ""
    changes: dict = field(default_factory=dict)
    # Name of the variant whose weights start the training.
    after: str = ""
    # Name of the variant whose weights are evaluated; "start" for the initial weights.
    weights: str = ""
    # Options of the fit.
    flags: tuple[str, ...] = ()


def edges(**changes: dict) -> Variant:
    return Variant("nyu-affinities", laid_over({"network": {"affinities": 16}}, changes))


def bases(after: str = "", **changes: dict) -> Variant:
    return Variant("nyu-half", changes, after)


def depths(**changes: dict) -> Variant:
    network = {"affinities": 16, "mean": True, "extractor": LITE}
    base = {"network": network, "train": {"average": 0.99}, "data": {"more": [OTHERS]}}
    return Variant("nyu-map", laid_over(base, changes))


def photographs(*more: dict) -> Variant:
    teacher = {"weights": "anything", "folder": "answers", "target": "images"}
    return depths(data={"more": [*more, IMAGES]}, train={"teacher": teacher})


def further(**changes: dict) -> Variant:
    network = {"affinities": 16, "mean": True, "extractor": LITE}
    train = {"start": "default", "average": 0.98}
    return Variant("nyu-lite", laid_over({"network": network, "train": train}, changes))


def from_teacher(target: str = "measured", part: str = "bases", **weights: float) -> Variant:
    teacher = {"weights": "anything", "folder": "answers", "target": target}
    return further(train={"teacher": teacher, "part": part, **loss(**weights)})


def functions(count: int) -> Variant:
    # The last hidden layer has at least as many units as there are basis functions.
    return bases(network={"bases": count, "hidden": [128, max(128, count)]})


def loss(**weights: float) -> dict:
    return {"loss": weights}


VARIANTS = {
    "edges": edges(),
    "edges, field alone": Variant(weights="edges", flags=("--fit", "field")),
    "edges, basis functions alone": Variant(weights="edges", flags=("--fit", "lse")),
    "colours alone": Variant(weights="start"),
    "colours and field alone": Variant(weights="start", flags=("--fit", "field")),
    "half as wide": edges(network={"affinities": 8}),
    "wider by half": edges(network={"affinities": 24}),
    "likelihood of steps": edges(train=loss(l1=0.0, rmse=0.0, affinities=1.0)),
    "and likelihood of steps": edges(train=loss(affinities=0.05)),
    "rms error alone": edges(train=loss(l1=0.0)),
    "absolute error alone": edges(train=loss(rmse=0.0)),
    "no average of steps": edges(train={"average": None}),
    "everything, jointly": Variant("nyu-joint", {"network": {"affinities": 16}}),
    "bases": bases(),
    "bases, not sharpened": bases(network={"extractor": {"sharpening": 0}}),
    "bases, 32 features": bases(network={"extractor": {"features": 32}}),
    "bases, medium extractor": bases(network={"extractor": MEDIUM}),
    "bases, Adam": bases(train={"optimiser": "adam", "learning_rate": 5e-3}),
    "bases, Adam, a fifth of the rate": bases(
        train={"optimiser": "adam", "learning_rate": 1e-3}
    ),
    "bases, absolute loss alone": bases(train=loss(rmse=0.0)),
    "bases, rms loss alone": bases(train=loss(l1=0.0)),
    "bases, the paper's losses": bases(train=loss(rmse=0.0, l2=1.0)),
    "bases, no gradient loss": bases(train=loss(gradient=0.0)),
    "bases, one draw": bases(train={"supervision": {"draws": 1}}),
    "bases, no augmentation": bases(train={"augment": NO_AUGMENTATION}),
    "bases, rooms alone": bases(data=ROOMS),
    "bases, after rooms": bases(after="bases, rooms alone"),
    **{f"N={n}": functions(n) for n in (16, 32, 64, 256, 512)},
    "no position": bases(network={"octaves": 0}),
    "raw position": bases(network={"octaves": 1}),
    **{f"E={e}": bases(network={"octaves": e}) for e in (3, 4, 6, 7, 8)},
    "map": depths(),
    "map, NYU alone": depths(data={"more": []}),
    "map, a third of NYU alone": depths(data={"root": FEWER, "more": []}),
    "map, photographs too": photographs({**OTHERS, "share": 0.24}),
    "map, photographs in place of other frames": photographs(),
    "map, stages not pretrained": depths(train={"backbone": {"pretrained": None}}),
    "map, four stages": depths(network={"extractor": {"backbone": {"stages": 4}}}),
    "map, six stages": depths(network={"extractor": {"backbone": {"stages": 6}}}),
    "map, half the pyramid": depths(network={"extractor": {"backbone": {"decoder": 32}}}),
    "map, stages at half the rate": depths(train={"backbone": {"rate": 0.1}}),
    "map, no augmentation": depths(train={"augment": NO_AUGMENTATION}),
    "map, images with flaws": depths(train={"augment": FLAWS}),
    "default": Variant(weights="default"),
    "further": further(),
    "further, affinities too": further(train={"part": "all"}),
    "further, a higher rate": further(train={"learning_rate": 4e-3}),
    "further, functions of the teacher": from_teacher(teacher_span=0.05),
    "further, affinities too, of the teacher": from_teacher(part="all", teacher_affinities=0.01),
    "further, depths of the teacher": from_teacher("all"),
    "further, other frames too": further(data={"more": [OTHERS]}),
    "further, a third of the frames": further(data={"root": FEWER}),
    "further, no context": further(network={"extractor": {"context": []}}),
    "further, no loss of the map": further(train=loss(mean=0.0)),
    "further, images with flaws": further(train={"augment": FLAWS}),
    "further, fits of 200 points and more": further(train={"supervision": {"fewest": 200}}),
}


def toml(table: dict, name: str = "") -> str:
    """Formats settings as TOML: tables of numbers, strings, arrays and inline tables."""
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


def fewer(args: argparse.Namespace) -> Path:
    """Creates links to every third training frame of the first dataset."""
    folder = args.output / "fewer"
    train = Path(args.root, "train").resolve()
    for image in sorted(train.glob("*/*.jpg"))[::3]:
        for file in (image, image.with_name(f"{image.stem}_depth.png")):
            link = folder / "train" / file.relative_to(train)
            link.parent.mkdir(parents=True, exist_ok=True)
            # Another task may have created it.
            with contextlib.suppress(FileExistsError):
                link.symlink_to(file)
    return folder


def settings(args: argparse.Namespace, variant: Variant) -> dict:
    base = tomllib.loads((ROOT / f"configs/{variant.config}.toml").read_text())
    base.pop("preset")
    base["network"] = NETWORK
    base["data"]["root"] = str(args.root)
    common = {"train": {"steps": args.steps, "measure_every": args.steps, "calibrate": True}}
    if variant.config in OWN_PRIOR:
        common["train"]["calibrate"] = False
    if variant.config != "nyu-lite" and "start" in base["train"]:
        common["train"]["start"] = args.start
    if variant.after:
        common["train"]["start"] = str(weights_of(args, variant.after))
    merged = laid_over(laid_over(base, common), variant.changes)
    if "teacher" in merged["train"]:
        merged["train"]["teacher"]["folder"] = str(args.output / "answers")
    backbone = merged["train"].get("backbone", {})
    if "pretrained" in backbone:
        backbone["pretrained"] = str(args.backbone)
    data = merged["data"]
    if data["root"] == FEWER:
        data["root"] = str(fewer(args))
    roots = {FRAMES: args.more, PHOTOS: args.photos}
    data["more"] = [{**other, "root": str(roots[other["root"]])} for other in data.get("more", [])]
    return merged


def folder_of(args: argparse.Namespace, name: str) -> Path:
    return args.output / name.replace(",", "").replace(" ", "-")


def calibrated_start(args: argparse.Namespace) -> Path:
    weights = args.output / "start.safetensors"
    if not weights.exists():
        args.output.mkdir(parents=True, exist_ok=True)
        command = [args.program, "calibrate", "--fit", "joint", "--dataset", "nyu", "--root",
                   args.root, "--weights", args.start, "-o", weights]
        subprocess.run(command, check=True, stdout=sys.stderr)
    return weights


def weights_of(args: argparse.Namespace, name: str) -> Path:
    if name == "start":
        return calibrated_start(args)
    if name == "default":
        return Path(name)
    variant = VARIANTS[name]
    if variant.weights:
        return weights_of(args, variant.weights)
    folder = folder_of(args, name)
    calibrated = variant.config in OWN_PRIOR
    weights = folder / ("calibrated.safetensors" if calibrated else "run/weights.safetensors")
    if weights.exists():
        return weights
    folder.mkdir(parents=True, exist_ok=True)
    config = folder / "settings.toml"
    run = [args.program, "train", "--device", args.device]
    if (folder / "run/config.toml").exists():
        run += ["--resume", folder / "run"]
    else:
        config.write_text(toml(settings(args, variant)))
        run += ["--config", config, "-o", folder / "run"]
    if not (folder / "run/weights.safetensors").exists():
        subprocess.run(run, check=True, stdout=sys.stderr)
    if calibrated:
        command = [args.program, "calibrate", "--dataset", "nyu", "--root", fewer(args), "--weights",
                   folder / "run/weights.safetensors", "-o", weights]
        subprocess.run(command, check=True, stdout=sys.stderr)
    return weights


def measure(args: argparse.Namespace, name: str, points: int) -> dict:
    report = folder_of(args, name) / f"{points}.json"
    if not report.exists():
        weights = weights_of(args, name)
        report.parent.mkdir(parents=True, exist_ok=True)
        command = [args.program, "eval", "--dataset", "nyu", "--root", args.root, "--weights",
                   weights, "--points", f"exactly:{points}", "--method", "lsdc", "--json", report,
                   *VARIANTS[name].flags]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    frames = json.loads(report.read_text())["frames"]
    return {m: sum(f["scores"]["lsdc"][m] for f in frames) / len(frames) for m in ("rmse", "rel")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--root", help="tree of NYU Depth v2 with train and val")
    parser.add_argument("--more", help="frames of other datasets, SET/FRAME.jpg and SET/FRAME_depth.png")
    parser.add_argument("--photos", help="photographs without depths, SET/FRAME.jpg")
    parser.add_argument("--backbone", help="EfficientNet-Lite0, saved as docs/training.md tells")
    parser.add_argument("--steps", type=int, default=1000, help="of each variant")
    parser.add_argument("--start", help="weights that those that judge edges or learn a map start from")
    parser.add_argument("--only", help="names of variants, with semicolons [default: all]")
    parser.add_argument("--task", type=int, help="only the variant with this number in --list")
    parser.add_argument("--points", type=int, nargs="+", default=[500, 50])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--program", default=str(ROOT / "target/release/lsdc"))
    parser.add_argument("-o", "--output", type=Path, default=Path("ablation"))
    parser.add_argument("--list", action="store_true", help="print what is trained and stop")
    args = parser.parse_args()
    names = args.only.split(";") if args.only else list(VARIANTS)
    # Variants from which another one starts are trained in its task, because two tasks must not share a folder.
    befores = {variant.after for variant in VARIANTS.values()}
    trained = [name for name in names if VARIANTS[name].config and name not in befores]
    if args.list:
        print("\n".join(f"{i:3} {name}" for i, name in enumerate(trained)))
        return
    if args.task is not None:
        names = [trained[args.task]]
    if not args.root:
        parser.error("--root is needed")
    own = ("nyu-half", "nyu-lite")
    variants = [VARIANTS[name] for name in names if VARIANTS[name].weights != "default"]
    if not args.start and any(variant.config not in own for variant in variants):
        parser.error("--start is needed")
    used = {other["root"] for v in variants for other in v.changes.get("data", {}).get("more", [])}
    if not args.more and FRAMES in used:
        parser.error("--more is needed")
    if not args.photos and PHOTOS in used:
        parser.error("--photos is needed")
    if not args.backbone and any(variant.config == "nyu-map" for variant in variants):
        parser.error("--backbone is needed")
    heads = [f"RMSE {n} | REL {n}" for n in args.points]
    print(f"| variant | {' | '.join(heads)} |\n|---|" + "---|---|" * len(args.points))
    for name in names:
        means = [measure(args, name, count) for count in args.points]
        cells = [mean[metric] for mean in means for metric in ("rmse", "rel")]
        print(f"| {name} | " + " | ".join(f"{v:.4f}" for v in cells) + " |", flush=True)


if __name__ == "__main__":
    main()
