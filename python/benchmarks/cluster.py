#!/usr/bin/env python3
"""Overhead of a cluster: frames per second and core of `python -m lsdc.ray` and of `lsdc complete` on the same folder.

    python3 python/benchmarks/cluster.py [--frames 60] [--rounds 2] [--cores 2]

Both complete copies of the room of this repository (304x228, 500 points) on all cores and write float32, in turns, N
frames and 3 N frames: the difference is the time of 2 N frames, and the rest is the start-up time. Needs `lsdc[ray]` and
the program (`LSDC_PROGRAM`, by default the one built by cargo). Also prints the largest memory of a worker.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).parents[2]
ROOM = ROOT / "assets/room"
PROGRAM = os.environ.get("LSDC_PROGRAM", ROOT / "target/release/lsdc")


def write_frames(folder: Path, count: int) -> None:
    image, sparse = np.asarray(Image.open(ROOM / "rgb.png")).astype(int), np.load(ROOM / "sparse.npy")
    for name in ("images", "sparse"):
        (folder / name).mkdir(parents=True)
    for number in range(count):
        tinted = np.minimum(image + number % 4 * 10, 255).astype(np.uint8)
        Image.fromarray(tinted).save(folder / f"images/{number:05}.png")
        np.save(folder / f"sparse/{number:05}.npy", sparse)


class Peak(threading.Thread):
    """The largest resident memory among workers, in bytes."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.bytes, self._stop_asked = 0, threading.Event()

    def run(self) -> None:
        while not self._stop_asked.wait(0.2):
            for process in Path("/proc").glob("[0-9]*"):
                try:
                    if b"MapWorker" in (process / "cmdline").read_bytes():
                        status = (process / "status").read_text()
                        peak = int(status.partition("VmHWM:")[2].split()[0]) << 10
                        self.bytes = max(self.bytes, peak)
                except (OSError, IndexError, ValueError):
                    continue

    def end(self) -> int:
        self._stop_asked.set()
        self.join()
        return self.bytes


def timed(command: list[object]) -> float:
    started = time.perf_counter()
    subprocess.run([str(part) for part in command], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    return time.perf_counter() - started


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--cores", type=int, default=os.cpu_count())
    args = parser.parse_args()
    counts = (args.frames, 3 * args.frames)
    seconds: dict[tuple[str, int], list[float]] = {}
    peak = Peak()
    peak.start()
    with tempfile.TemporaryDirectory() as scratch:
        for count in counts:
            write_frames(Path(scratch) / str(count), count)
        for turn in range(args.rounds):
            for count in counts:
                frames, out = Path(scratch) / str(count), Path(scratch) / f"out-{turn}-{count}"
                program = [PROGRAM, "complete", frames / "images", frames / "sparse", "-o", f"{out}-program"]
                program += ["--formats", "npy", "--quiet"]
                cluster = [sys.executable, "-m", "lsdc.ray", frames, f"{out}-ray", "--encoding", "f32"]
                cluster += ["--per-shard", 10, "--address", "local"]
                seconds.setdefault(("program", count), []).append(timed(program))
                seconds.setdefault(("cluster", count), []).append(timed(cluster))
    print("| | starting | frames a second and core |")
    print("|---|---|---|")
    for name in ("program", "cluster"):
        few, many = (statistics.median(seconds[name, count]) for count in counts)
        each = (many - few) / (counts[1] - counts[0])
        print(f"| {name} | {few - counts[0] * each:.1f} s | {1 / each / args.cores:.2f} |")
    print(f"\nlargest memory of a worker: {peak.end() / 1e6:.0f} MB; all times: {seconds}")


if __name__ == "__main__":
    main()
