"""The command `python -m lsdc.ray`."""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import ray

from .._completer import Completer
from .._errors import Error, SettingsError
from ._dataset import check_gpus
from ._options import ENCODINGS, Options
from ._place import Place
from ._plan import Plan, planned
from ._run import run
from ._shards import WRITERS, Destination
from ._sources import Source, opened

DONE, NOT_WRITTEN, WRONG, PARTIAL, INTERRUPTED = 0, 1, 2, 3, 130
"""Exit codes, as those of the program."""

# Seconds between lines of progress.
PACE = 2.0

# Errors of shards.
SHOWN = 5


def main(arguments: Sequence[str] | None = None) -> int:
    args = _parser().parse_args(arguments)
    started = time.monotonic()
    try:
        job = _prepared(args)
        left = [shard for shard in job.plan.shards if shard.name not in job.destination.finished()]
        bar = _Progress(len(job.plan.shards), len(left), quiet=args.quiet)
        if left:
            _connected(args)
            run(
                left,
                job.source,
                job.options,
                job.destination,
                num_cpus=args.cpus,
                num_gpus=args.gpus,
                concurrency=args.workers,
                progress=bar.add,
            )
        return _ended(job, bar.errors, time.monotonic() - started)
    except Error as error:
        print(f"error: {error}", file=sys.stderr)
        if error.hint:
            print(f"hint: {error.hint}", file=sys.stderr)
        return WRONG
    except OSError as error:
        print(f"error: {error}", file=sys.stderr)
        return NOT_WRITTEN
    except KeyboardInterrupt:
        print("stopped; the same command goes on", file=sys.stderr)
        return INTERRUPTED


@dataclass(frozen=True)
class _Job:
    source: Source
    options: Options
    destination: Destination
    plan: Plan


def _prepared(args: argparse.Namespace) -> _Job:
    """Checks arguments and source before the cluster is used."""
    try:
        fit = None if args.fit is None else json.loads(args.fit)
    except json.JSONDecodeError as error:
        raise SettingsError(f"`--fit` is no JSON: {error}") from None
    completer = Completer(
        args.weights,
        fit=fit,
        robust=args.robust,
        working_size=args.working_size,
        encoder_side=args.encoder_side,
        threads=max(1, args.cpus),
    )
    options = Options(
        completer,
        unit=args.unit,
        sigma=args.sigma,
        size=args.size,
        encoding=args.encoding,
        step=args.step,
        standard_deviation=args.standard_deviation,
        device=args.device,
    )
    check_gpus(args.device, args.gpus)
    if args.cpus < 1 or (args.workers is not None and args.workers < 1):
        raise SettingsError("`--cpus` and `--workers` are at least 1")
    if _below(args.dest, args.source):
        raise SettingsError("DEST is inside SOURCE", "results would be taken for frames: give another folder")
    destination = Destination(Place(args.dest), args.format)
    source = opened(args.source, args.sparse, dict(args.column))
    plan = planned(source, args.per_shard, dotless=args.format == "tar")
    record = {"frames": plan.frames, "shards": len(plan.shards), "digest": plan.digest, "columns": dict(args.column)}
    destination.begin({**record, **options.record()})
    return _Job(source, options, destination, plan)


def _below(inner: str, outer: str) -> bool:
    paths = [path if "://" in path else os.path.abspath(path) for path in (inner, outer)]
    return f"{paths[0].rstrip('/')}/".startswith(f"{paths[1].rstrip('/')}/")


def _connected(args: argparse.Namespace) -> None:
    logging.getLogger("ray.data").setLevel(logging.WARNING)
    if not ray.is_initialized():
        ray.init(address=args.address, log_to_driver=False, logging_level=logging.WARNING)


def _ended(job: _Job, errors: list[str], seconds: float) -> int:
    """Prints a summary, and returns the exit code."""
    summaries = job.destination.summaries()
    frames = sum(summary["frames"] for summary in summaries.values())
    failed = sum(len(summary["failed"]) for summary in summaries.values())
    clipped = sum(summary["clipped"] for summary in summaries.values())
    missing = len(job.plan.shards) - len(summaries)
    job.destination.end(summaries)
    print(f"{frames} of {job.plan.frames} frames, {failed} failed, {seconds:.1f} s")
    if clipped:
        print(f"note: in {clipped} frames, depths are beyond what `--encoding` can store", file=sys.stderr)
    if failed:
        first = next(summary["failed"][0] for summary in summaries.values() if summary["failed"])
        print(f"warning: `{first[0]}`: {first[1]}; all that failed is in failures.csv", file=sys.stderr)
    if missing:
        print(f"warning: {missing} shards could not be made; the same command tries again", file=sys.stderr)
    for error in errors[:SHOWN]:
        print(f"warning: {error}", file=sys.stderr)
    return PARTIAL if failed or missing else DONE


@dataclass
class _Progress:
    """Prints progress as lines of text, which also suit logs."""

    shards: int
    left: int
    quiet: bool
    frames: int = 0
    failed: int = 0
    finished: int = 0
    started: float = field(default_factory=time.monotonic)
    shown: float = 0.0
    errors: list[str] = field(default_factory=list[str])

    def add(self, summary: dict[str, Any]) -> None:
        self.finished += 1
        self.frames += summary["frames"]
        self.failed += len(summary["failed"])
        if "error" in summary:
            self.errors.append(summary["error"])
        now = time.monotonic()
        if self.quiet or (now - self.shown < PACE and self.finished < self.left):
            return
        self.shown = now
        rate = self.frames / max(now - self.started, 1e-9)
        remaining = (self.left - self.finished) * (now - self.started) / self.finished
        done = self.shards - self.left + self.finished
        print(
            f"{done}/{self.shards} shards, {self.frames} frames, {self.failed} failed, {rate:.1f} frames/s, "
            f"{remaining:.0f} s left",
            file=sys.stderr,
        )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m lsdc.ray",
        description="Completes the depths of many frames on a cluster of Ray. Interrupted or not, every frame is in "
        "the result exactly once; the same command again goes on where it stopped.",
        epilog="Exit codes: 0 done, 1 could not write, 2 wrong usage or input, 3 frames failed or are missing, 130 "
        "stopped by Ctrl-C. Places are paths, s3://..., gs://..., or addresses of fsspec.",
    )
    add = parser.add_argument
    add("source", metavar="SOURCE", help="images, tars of WebDataset, Parquet, or a folder with `images` and `sparse`")
    add("dest", metavar="DEST", help="folder for results: empty, or begun by the same command")
    add("--sparse", metavar="PLACE", help="maps of depths called as the images are, or a model of COLMAP")
    add(
        "--column",
        metavar="PART=NAME",
        action="append",
        default=[],
        type=_pair,
        help="column of Parquet, or ending in tars, of key, image, sparse, sigma or guide",
    )
    add("--unit", type=_unit, help="of depths: m, cm, mm, or metres of a step; integers need it")
    add("--sigma", type=float, help="standard deviation of all depths, in their unit")
    add("--weights", default="default", help="default, small, anything (its encoder must be installed on every machine), none, or a weights file (default: %(default)s)")
    add("--fit", metavar="JSON", help='settings of the fit, such as {"method": "lse"}')
    add("--robust", help="limits the influence of outliers: auto, or another loss")
    add("--size", type=_size, metavar="WxH", help="of results (default: that of the image)")
    add("--working-size", type=_size, metavar="WxH", help="of images in the network")
    add("--encoder-side", type=int, metavar="PIXELS", help="shorter side of the image that the encoder of the weights reads")
    add("--standard-deviation", action="store_true", help="also that of every pixel")
    add("--format", choices=list(WRITERS), default="parquet", help="of results (default: %(default)s)")
    add("--encoding", choices=ENCODINGS, default="f16", help="of depths (default: %(default)s)")
    add("--step", type=float, default=0.001, help="unit of the encoding u16 in metres (default: %(default)s)")
    add("--per-shard", type=int, default=128, help="frames in a file of results (default: %(default)s)")
    add("--cpus", type=int, default=1, help="CPUs and threads of a worker (default: %(default)s)")
    add("--device", default="cpu", help="of networks: cpu, or wgpu, which is the GPU that Ray assigns (default: %(default)s)")
    add("--gpus", type=float, default=0, help="GPUs of a worker, such as 0.25 (default: %(default)s)")
    add("--workers", type=int, help="number of workers (default: as many as there is room for)")
    add("--address", help="of the cluster (default: RAY_ADDRESS, or this machine)")
    add("--quiet", action="store_true", help="no progress")
    return parser


def _pair(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f"`{text}` is not PART=NAME")
    return name, value


def _size(text: str) -> tuple[int, int]:
    try:
        width, height = (int(side) for side in text.split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"`{text}` is not WIDTHxHEIGHT") from None
    return width, height


def _unit(text: str) -> Any:
    return text if text in ("m", "cm", "mm") else _number(text)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"`{text}` is not m, cm, mm or a number") from None
