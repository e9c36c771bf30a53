#!/usr/bin/env python3
"""Times lsdc and other programs in turns, on the same work with the same weights.

    python3 scripts/peers/run.py completion --size 304x228
    python3 scripts/peers/run.py fit --sizes 304x228,640x480 --points 5,500 --before OTHER/lsdc
    python3 scripts/peers/run.py encoder --size 448x336
    python3 scripts/peers/run.py training --preset paper
    python3 scripts/peers/run.py solve

Needs Python 3.10 and `cargo build --release`. Installs packages from PyPI into a separate environment (`target/peers` or
`--environment`; PyTorch, a large download, is not needed for `fit`). Prints medians, their ranges, and ratios to the first
peer.

completion  image to basis functions for the peers, image to dense depth including the fit for lsdc;
            first checks that all compute the same depth map
fit         network, fit, further fits to the same image, and reading out, with the default weights, each
            relative to ONNX Runtime's time for the paper's network at 304x228; also of another lsdc
encoder     an image to the features of ViT-S/14 with random weights (sides are multiples of 14); first checks
            that all are the same. Needs `cargo build --release -p lsdc-core --example encoder`
training    a step with a batch of 2 and every pixel in the loss: forward, fit, backward, Adam
solve       500 and 1000 points, 129 basis functions, f64: lsdc (cargo bench --bench solve) against
            MKL's Cholesky on the normal equations and MKL's gelsd, as PyTorch calls them
"""

import argparse
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCRATCH = ROOT / "target/peers"
PACKAGES = ["numpy", "onnx", "safetensors", "onnxruntime"]
MORE_PACKAGES = ["openvino", "pillow", "torch", "onnxscript"]


def arguments() -> argparse.Namespace:
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("task", choices=["completion", "fit", "encoder", "training", "solve"])
    parser.add_argument("--size", default="304x228", help="WIDTHxHEIGHT")
    parser.add_argument("--sizes", default="304x228", help="of `fit`, separated by commas")
    parser.add_argument("--points", default="500", help="of `fit` also several, separated by commas")
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--runs", type=int, default=5, help="runs of each program in a round")
    keep = "make the C library keep freed pages, for all programs (lsdc does by itself)"
    parser.add_argument("--keep-pages", action="store_true", help=keep)
    parser.add_argument("--preset", help="random weights of a preset (paper, medium, sharp, small)")
    parser.add_argument("--weights", default=str(ROOT / "crates/core/weights/default.safetensors"))
    parser.add_argument("--lsdc", default=str(ROOT / "target/release/lsdc"))
    parser.add_argument("--before", help="another lsdc that `fit` times in turns with it")
    parser.add_argument("--environment", type=Path, default=SCRATCH, help="with the packages")
    return parser.parse_args()


def enter_environment(args: argparse.Namespace) -> None:
    """Runs this script again inside the separate environment."""
    if args.keep_pages:
        for name in ["MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_"]:
            os.environ[name] = str(1 << 30)
    if Path(sys.prefix) == args.environment:
        return
    python = args.environment / "bin/python"
    if not python.exists():
        venv.create(args.environment, with_pip=True)
    packages = PACKAGES if args.task == "fit" else PACKAGES + MORE_PACKAGES
    subprocess.run([python, "-m", "pip", "install", "-q", *packages], check=True)
    os.execv(python, [str(python), *sys.argv])


# The fit of the other programs.
PLAIN = ["--fit", "lse", "--prior", "none"]


def lsdc(args: argparse.Namespace, *words) -> str:
    environment = {**os.environ, "RAYON_NUM_THREADS": str(args.threads)}
    return subprocess.run(
        [args.lsdc, *map(str, words)], check=True, capture_output=True, env=environment
    ).stdout


def random_weights(args: argparse.Namespace) -> str:
    """Writes the weights of a preset after one training step on one room."""
    path = SCRATCH / f"{args.preset}.safetensors"
    SCRATCH.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        with tempfile.TemporaryDirectory() as folder:
            settings = ["train.steps=1", "train.held_out=0", "train.calibrate=false"]
            settings += ["data.rooms.train=2", "fit.ridge=1e-4"]
            words = [word for setting in settings for word in ("--set", setting)]
            words += ["--set", f'preset="{args.preset}"']
            lsdc(args, "train", "--dataset", "rooms", *words, "-o", f"{folder}/run")
            (Path(folder) / "run/weights.safetensors").rename(path)
    return str(path)


def ridged(weights: str) -> str:
    """Adds a ridge to the weights: without one, the ill-conditioned fit makes depths of all programs differ."""
    from safetensors import safe_open
    from safetensors.numpy import load_file, save_file

    with safe_open(weights, "np") as file:
        record = file.metadata()
    record["fit"] = json.dumps({**json.loads(record["fit"]), "ridge": 1e-4})
    path = SCRATCH / "ridged.safetensors"
    save_file(load_file(weights), path, record)
    return str(path)


def seconds(run, count: int) -> float:
    """Returns the mean of a few runs after a warm-up."""
    run()
    started = time.perf_counter()
    for _ in range(count):
        run()
    return (time.perf_counter() - started) / count


def race(title: str, rounds: int, programs: dict) -> None:
    """Calls each program, which returns milliseconds, in turns."""
    times = {name: [] for name in programs}
    for _ in range(rounds):
        for name, program in programs.items():
            times[name].append(program())
    print(title)
    reference = statistics.median(times[list(programs)[1]])
    for name, values in times.items():
        median = statistics.median(values)
        print(
            f"{name:<14} {median:9.2f} ms  {median / reference:5.2f} x"
            f"  ({min(values):.2f} to {max(values):.2f})"
        )


def onnx_session(model: bytes, threads: int) -> "onnxruntime.InferenceSession":
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])


def peers(args: argparse.Namespace, width: int, height: int) -> dict:
    """Returns functions from an image to basis functions, by name."""
    import openvino
    import torch
    from network import build
    from pytorch import Network

    model = build(args.weights, height, width).SerializeToString()
    session = onnx_session(model, args.threads)
    core = openvino.Core()
    settings = {
        "INFERENCE_NUM_THREADS": args.threads,
        "INFERENCE_PRECISION_HINT": "f32",
        "PERFORMANCE_HINT": "LATENCY",
    }
    compiled = core.compile_model(core.read_model(model), "CPU", settings)
    torch.set_num_threads(args.threads)
    net = Network(args.weights).fold().to(memory_format=torch.channels_last)

    def pytorch(image):
        with torch.inference_mode():
            x = torch.from_numpy(image).to(memory_format=torch.channels_last)
            return net(x).numpy()

    return {
        "onnxruntime": lambda image: session.run(None, {"image": image})[0],
        "openvino": lambda image: compiled(image)[0],
        "pytorch": pytorch,
    }


def check(runs: dict, args: argparse.Namespace, width: int, height: int) -> "numpy.ndarray":
    """Compares the depth maps of all peers on one room; returns its normalised image."""
    import numpy as np
    from PIL import Image
    from safetensors import safe_open

    with safe_open(args.weights, "np") as file:
        record = file.metadata()
    normalisation = json.loads(record["normalisation"])
    ridge = json.loads(record["fit"])["ridge"]
    with tempfile.TemporaryDirectory() as folder:
        room = Path(folder)
        sizes = [f"data.rooms.width={width}", f"data.rooms.height={height}"]
        sizes = [word for size in sizes for word in ("--set", size)]
        source = ["--dataset", "rooms", "--limit", 1, "--points", args.points]
        lsdc(args, "export", *source, "-o", room / "frame", *sizes)
        [colours], [points] = (sorted(room.glob(f"frame/{part}/*/*")) for part in ("rgb", "sparse"))
        rgb = np.asarray(Image.open(colours), np.float32) / 255
        sparse = np.load(points)
        files = [colours, points, "-o", room / "depth.npy"]
        lsdc(args, "complete", *files, "--weights", args.weights, "--full", *PLAIN)
        ours = np.load(room / "depth.npy")
    image = (rgb - normalisation["mean"]) / normalisation["deviation"]
    image = np.ascontiguousarray(image.transpose(2, 0, 1)[None], np.float32)
    at = np.nonzero(sparse)
    low, high = sparse[at].min(), sparse[at].max()
    for name, run in runs.items():
        bases = run(image)[0].astype(np.float64)
        if not json.loads(record["network"]).get("mean"):
            bases = np.concatenate([np.ones_like(bases[:1]), bases])
        rows = bases[:, *at].T
        normal = rows.T @ rows
        normal += ridge * np.trace(normal) / len(normal) * np.eye(len(normal))
        weights = np.linalg.solve(normal, rows.T @ sparse[at].astype(np.float64))
        depth = np.tensordot(weights, bases, 1).clip(low / 10, high * 10)
        print(f"{name:<14} largest difference of depth {np.abs(depth - ours).max():.1e} m")
    return image


def bench(args: argparse.Namespace, *words) -> dict:
    common = ["--json", "--runs", args.runs, "--size", args.size, "--weights", args.weights]
    return json.loads(lsdc(args, "bench", *common, *words))


def completion(args: argparse.Namespace) -> None:
    width, height = map(int, args.size.split("x"))
    args.weights = ridged(args.weights)
    runs = peers(args, width, height)
    image = check(runs, args, width, height)
    ours = lambda: bench(args, "--full", "--points", args.points, *PLAIN)["total_ms"]
    others = {
        name: lambda run=run: seconds(lambda: run(image), args.runs) * 1e3
        for name, run in runs.items()
    }
    title = f"{args.size}, {args.points} points, {args.threads} threads"
    race(title, args.rounds, {"lsdc": ours, **others})


def fit(args: argparse.Namespace) -> None:
    import numpy as np
    from network import build

    default = args.weights
    args.preset = "paper"
    model = build(random_weights(args), 228, 304).SerializeToString()
    session = onnx_session(model, args.threads)
    image = np.random.default_rng(0).standard_normal((1, 3, 228, 304), np.float32)
    programs = {"now": args.lsdc, **({"before": args.before} if args.before else {})}
    works = [(size, points) for size in args.sizes.split(",") for points in args.points.split(",")]
    units, times = [], {}
    for _ in range(args.rounds):
        for size, points in works:
            units.append(seconds(lambda: session.run(None, {"image": image}), args.runs) * 1e3)
            for name, program in programs.items():
                words = ["--json", "--runs", args.runs, "--size", size, "--weights", default]
                words += ["--points", points]
                program = argparse.Namespace(lsdc=program, threads=args.threads)
                found = json.loads(lsdc(program, "bench", *words))
                found["again_ms"] = found["fit_ms"] - found["field_ms"]
                times.setdefault((size, points, name), []).append(found)
    unit = statistics.median(units)
    print(f"{args.threads} threads, ONNX Runtime {unit:.0f} ms = 1")
    print("| size, points | | network | first fit | further fits | reading out | image to depth |")
    print("|---|---|---|---|---|---|---|")
    for (size, points, name), found in times.items():
        parts = ["network_ms", "fit_ms", "again_ms", "dense_ms", "total_ms"]
        shares = [statistics.median(run[part] for run in found) / unit for part in parts]
        cells = " | ".join(f"{share:.3f}" for share in shares)
        print(f"| {size}, {points} | {name} | {cells} |")


def encoder(args: argparse.Namespace) -> None:
    import numpy as np
    import torch
    from encoder import PATCH, Encoder
    from safetensors.torch import save_file

    width, height = map(int, args.size.split("x"))
    torch.set_num_threads(args.threads)
    net = Encoder(height // PATCH, width // PATCH).eval()
    image = torch.randn((1, 3, height, width), generator=torch.Generator().manual_seed(1))
    with tempfile.TemporaryDirectory() as folder, torch.inference_mode():
        folder = Path(folder)
        save_file(net.randomise(), folder / "weights.safetensors")
        exported = folder / "encoder.onnx"
        torch.onnx.export(net, (image,), exported, input_names=["image"], dynamo=True)
        session = onnx_session(str(exported), args.threads)
        image[0].permute(1, 2, 0).numpy().tofile(folder / "image")
        ours = [ROOT / "target/release/examples/encoder", folder / "weights.safetensors"]
        ours += [folder / "image", height, width, args.runs, folder / "features"]
        words = [str(word) for word in ours]
        environment = {**os.environ, "RAYON_NUM_THREADS": str(args.threads)}
        run = lambda: float(subprocess.check_output(words, env=environment))
        run()
        expected = net(image).numpy()
        found = np.fromfile(folder / "features", np.float32).reshape(expected.shape)
        unit = np.abs(expected).mean()
        inputs = {"image": image.numpy()}
        for name, values in [("lsdc", found), ("onnxruntime", session.run(None, inputs)[0])]:
            print(f"{name:<14} largest difference {np.abs(values - expected).max() / unit:.1e}")
        programs = {
            "lsdc": run,
            "onnxruntime": lambda: seconds(lambda: session.run(None, inputs), args.runs) * 1e3,
            "pytorch": lambda: seconds(lambda: net(image), args.runs) * 1e3,
        }
        race(f"encoder, {args.size}, {args.threads} threads", args.rounds, programs)


def training(args: argparse.Namespace) -> None:
    import torch
    from pytorch import trainer

    torch.set_num_threads(args.threads)
    width, height = map(int, args.size.split("x"))
    step = trainer(args.weights, height, width, 2, 1000)
    programs = {
        "lsdc": lambda: bench(args, "--training")["step_ms"],
        "pytorch": lambda: seconds(step, args.runs) * 1e3,
    }
    race(f"{args.size}, batch 2, {args.threads} threads", args.rounds, programs)


def solve(args: argparse.Namespace) -> None:
    import torch

    torch.set_num_threads(args.threads)
    environment = {**os.environ, "RAYON_NUM_THREADS": str(args.threads)}
    for points in [500, 1000]:
        generator = torch.Generator().manual_seed(0)
        draw = lambda *shape: torch.randn(shape, generator=generator, dtype=torch.float64)
        rows, depths = draw(points, 129), draw(points, 1)

        def cholesky():
            normal = rows.mT @ rows
            normal.diagonal().add_(1e-4 * normal.diagonal().mean())
            return torch.cholesky_solve(rows.mT @ depths, torch.linalg.cholesky(normal))

        def gelsd():
            return torch.linalg.lstsq(rows, depths, driver="gelsd").solution

        words = ["cargo", "bench", "-q", "--bench", "solve", "--", f"{points} points/ridge"]
        words += ["--warm-up-time", "0.5", "--measurement-time", "1"]

        def ours():
            output = subprocess.run(
                words, check=True, capture_output=True, env=environment, cwd=ROOT, text=True
            ).stdout
            value, unit = re.search(r"time:\s+\[\S+ \S+ (\S+) (\S+)", output).groups()
            return float(value) * {"ns": 1e-6, "µs": 1e-3, "ms": 1.0}[unit]

        programs = {
            "lsdc": ours,
            "MKL Cholesky": lambda: seconds(cholesky, 50) * 1e3,
            "MKL gelsd": lambda: seconds(gelsd, 10) * 1e3,
        }
        title = f"{points} points, 129 basis functions, {args.threads} threads"
        race(title, args.rounds, programs)


def main() -> None:
    args = arguments()
    enter_environment(args)
    if args.preset and args.task != "fit":
        args.weights = random_weights(args)
    tasks = [completion, fit, encoder, training, solve]
    {task.__name__: task for task in tasks}[args.task](args)


if __name__ == "__main__":
    main()
