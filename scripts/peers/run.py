#!/usr/bin/env python3
"""Times lsdc and other runtimes of the same network with the same weights, in turns.

    python3 scripts/peers/run.py --size 304x228

Needs Python 3.10 and `cargo build --release`. Packages come from PyPI into a scratch environment
(`target/peers`). First it checks that all compute the same: base functions of each peer, fitted
in NumPy, against the depth map of lsdc. Then it times all in turns and prints medians and ratios
to ONNX Runtime: image to base functions for the peers, image to dense depth for lsdc.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ["numpy", "onnx", "safetensors", "onnxruntime", "openvino", "pillow"]


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--size", default="304x228", help="WIDTHxHEIGHT")
    parser.add_argument("--points", type=int, default=500)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--weights", default=str(ROOT / "assets/weights.safetensors"))
    parser.add_argument("--lsdc", default=str(ROOT / "target/release/lsdc"))
    parser.add_argument("--torch", action="store_true", help="time PyTorch too (a large download)")
    return parser.parse_args()


def enter_environment(args: argparse.Namespace) -> None:
    """Runs this script again inside the scratch environment."""
    folder = ROOT / "target/peers"
    python = folder / "bin/python"
    if Path(sys.prefix) == folder:
        return
    if not python.exists():
        venv.create(folder, with_pip=True)
    packages = PACKAGES + (["torch", "onnx2torch"] if args.torch else [])
    subprocess.run([python, "-m", "pip", "install", "-q", *packages], check=True)
    os.execv(python, [str(python), *sys.argv])


def peers(model: bytes, args: argparse.Namespace) -> dict:
    """Functions from an image to base functions, by name."""
    import onnxruntime
    import openvino

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = args.threads
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    core = openvino.Core()
    settings = {
        "INFERENCE_NUM_THREADS": args.threads,
        "INFERENCE_PRECISION_HINT": "f32",
        "PERFORMANCE_HINT": "LATENCY",
    }
    compiled = core.compile_model(core.read_model(model), "CPU", settings)
    runs = {
        "onnxruntime": lambda image: session.run(None, {"image": image})[0],
        "openvino": lambda image: compiled(image)[0],
    }
    if args.torch:
        import onnx
        import torch
        from onnx2torch import convert

        torch.set_num_threads(args.threads)
        net = convert(onnx.load_from_string(model)).eval().to(memory_format=torch.channels_last)

        def run(image):
            with torch.inference_mode():
                x = torch.from_numpy(image).to(memory_format=torch.channels_last)
                return net(x).numpy()

        runs["pytorch"] = run
    return runs


def environment(args: argparse.Namespace) -> dict:
    return {**os.environ, "RAYON_NUM_THREADS": str(args.threads)}


def check(runs: dict, args: argparse.Namespace) -> "numpy.ndarray":
    """Compares the depth maps of all on one room; returns its normalised image."""
    import numpy as np
    from PIL import Image
    from safetensors import safe_open

    width, height = map(int, args.size.split("x"))
    with safe_open(args.weights, "np") as file:
        record = file.metadata()
    normalisation = json.loads(record["normalisation"])
    ridge = json.loads(record["fit"])["ridge"]
    with tempfile.TemporaryDirectory() as folder:
        room = Path(folder)
        lsdc = lambda *words: subprocess.run(
            [args.lsdc, *map(str, words)], check=True, stdout=subprocess.DEVNULL
        )
        lsdc(
            *("export", "--dataset", "rooms", "--points", args.points, "-o", room),
            *("--set", f"data.rooms.width={width}", "--set", f"data.rooms.height={height}"),
        )
        rgb = np.asarray(Image.open(room / "rgb.png"), np.float32) / 255
        sparse = np.load(room / "sparse.npy")
        lsdc(
            *("complete", room / "rgb.png", room / "sparse.npy", "--weights", args.weights),
            "--full",
        )
        ours = np.load(room / "rgb_depth.npy")
    image = (rgb - normalisation["mean"]) / normalisation["deviation"]
    image = np.ascontiguousarray(image.transpose(2, 0, 1)[None], np.float32)
    at = np.nonzero(sparse)
    low, high = sparse[at].min(), sparse[at].max()
    for name, run in runs.items():
        bases = run(image)[0].astype(np.float64)
        bases = np.concatenate([np.ones_like(bases[:1]), bases])
        rows = bases[:, *at].T
        normal = rows.T @ rows
        normal += ridge * np.trace(normal) / len(normal) * np.eye(len(normal))
        weights = np.linalg.solve(normal, rows.T @ sparse[at].astype(np.float64))
        depth = np.tensordot(weights, bases, 1).clip(low / 10, high * 10)
        print(f"{name:<12} largest difference of depth {np.abs(depth - ours).max():.1e} m")
    return image


def main() -> None:
    args = arguments()
    enter_environment(args)
    from network import build

    width, height = map(int, args.size.split("x"))
    runs = peers(build(args.weights, height, width).SerializeToString(), args)
    image = check(runs, args)
    times = {name: [] for name in ["lsdc", *runs]}
    bench = [args.lsdc, "bench", "--json", "--full", "--runs", "5", "--size", args.size]
    bench += ["--points", str(args.points), "--weights", args.weights]
    for _ in range(args.rounds):
        output = subprocess.run(
            bench, check=True, capture_output=True, env=environment(args)
        ).stdout
        outcome = json.loads(output)
        times["lsdc"].append(outcome["total_ms"])
        for name, run in runs.items():
            run(image)
            started = time.perf_counter()
            for _ in range(5):
                run(image)
            times[name].append((time.perf_counter() - started) / 5 * 1e3)
    reference = statistics.median(times["onnxruntime"])
    print(f"{args.size}, {args.points} points, {args.threads} threads, {outcome['instructions']}")
    for name, values in times.items():
        median = statistics.median(values)
        print(
            f"{name:<12} {median:8.1f} ms  {median / reference:5.2f} x"
            f"  ({min(values):.1f} to {max(values):.1f})"
        )
    print(f"lsdc held {outcome['peak_mb']:.0f} MB at most")


if __name__ == "__main__":
    main()
