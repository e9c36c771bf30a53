#!/usr/bin/env python3
"""Kills workers and nodes while a cluster completes frames, and counts frames that are lost, duplicated or different.

    python3 python/benchmarks/kill.py [--frames 2000] [--nodes 3] [--seed 0]

Starts a cluster of several nodes on this machine, runs `python -m lsdc.ray` on it, and at random times kills a worker
process; a whole node, which is replaced; or the command itself, which is restarted. In the end, every key must exist
once, with the same bits as from one process.
Needs `lsdc[ray]`. Prints a table; the exit code is 1 if a frame was lost, duplicated, different or failed.
"""

import argparse
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from PIL import Image

import lsdc
import lsdc.ray

WIDTH, HEIGHT = 96, 72

# Shares of workers, nodes and commands among victims.
SHARES = (0.7, 0.25, 0.05)


def write_frames(folder: Path, count: int) -> None:
    """Writes different slanted, tinted planes with 40 depths each."""
    down, across = np.mgrid[:HEIGHT, :WIDTH]
    for name in ("images", "sparse"):
        (folder / name).mkdir()
    for number in range(count):
        rng = np.random.default_rng(number)
        tint = rng.uniform(0.5, 2.5, 3)
        image = np.stack([across * tint[0], down * tint[1], (across + down) * tint[2] / 2], -1)
        image += rng.normal(0, 4, image.shape)
        depth = (2 + rng.normal() * 0.2 + across * rng.uniform(0, 0.02)).astype(np.float32)
        sparse = np.zeros((HEIGHT, WIDTH), np.float32)
        rows, columns = rng.integers(0, HEIGHT, 40), rng.integers(0, WIDTH, 40)
        sparse[rows, columns] = depth[rows, columns]
        Image.fromarray(np.clip(image, 0, 255).astype(np.uint8)).save(folder / f"images/{number:05}.png")
        np.save(folder / f"sparse/{number:05}.npy", sparse)


class Victims:
    """A cluster whose parts can be killed."""

    def __init__(self, nodes: int) -> None:
        from ray.cluster_utils import Cluster

        settings = {"health_check_initial_delay_ms": 1000, "health_check_period_ms": 1000}
        settings |= {"health_check_timeout_ms": 1000, "health_check_failure_threshold": 3}
        common = {"object_store_memory": 80 << 20, "include_dashboard": False}
        self._common = common
        # The head node runs the job but no work: losing it means restarting the command.
        head = {**common, "num_cpus": 0, "_system_config": settings}
        self.cluster = Cluster(initialize_head=True, head_node_args=head)
        self._nodes = [self._added() for _ in range(nodes)]

    def _added(self):
        return self.cluster.add_node(num_cpus=1, object_store_memory=self._common["object_store_memory"])

    def kill_node(self, rng: random.Random) -> None:
        """Kills the raylet of a node without warning, and thereby its workers."""
        victim = self._nodes.pop(rng.randrange(len(self._nodes)))
        self.cluster.remove_node(victim, allow_graceful=False)
        self._nodes.append(self._added())

    def kill_worker(self, rng: random.Random) -> bool:
        workers = [pid for node in self._nodes for pid in _workers(node)]
        if not workers:
            return False
        os.kill(rng.choice(workers), 9)
        return True

    def stop(self) -> None:
        self.cluster.shutdown()


def _workers(node) -> list[int]:
    """Returns the actor processes that complete frames, among the children of a node's raylet."""
    raylets = [process.process.pid for process in node.all_processes.get("raylet", [])]
    found = []
    for raylet in raylets:
        children = Path(f"/proc/{raylet}/task/{raylet}/children").read_text().split()
        for child in children:
            try:
                title = Path(f"/proc/{child}/cmdline").read_bytes()
            except FileNotFoundError:
                continue
            if b"MapWorker" in title:
                found.append(int(child))
    return found


def compared(folder: Path, dest: Path) -> tuple[int, int, int, int]:
    """Counts frames that are lost, duplicated, different from one process, and without a depth."""
    rows = pq.read_table(dest / "data").to_pylist()
    count = Counter(row["key"] for row in rows)
    names = {path.stem for path in (folder / "images").iterdir()}
    completer = lsdc.Completer("small")
    different = sum(key not in names for key in count)
    empty = sum(row["error"] is not None for row in rows)
    for row in rows:
        image = np.asarray(Image.open(folder / f"images/{row['key']}.png"))
        depth = completer.complete(image, np.load(folder / f"sparse/{row['key']}.npy")).depth
        found = lsdc.ray.decode(row)
        different += found is not None and not np.array_equal(found, depth)
    lost = len(names - set(count))
    return lost, sum(number - 1 for number in count.values()), different, empty


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=2000)
    parser.add_argument("--nodes", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--per-shard", type=int, default=10)
    parser.add_argument("--pause", type=float, default=4.0, help="mean seconds between kills")
    args = parser.parse_args()
    rng = random.Random(args.seed)
    with tempfile.TemporaryDirectory() as scratch:
        folder, dest = Path(scratch) / "frames", Path(scratch) / "results"
        folder.mkdir()
        write_frames(folder, args.frames)
        victims = Victims(args.nodes)
        try:
            started = time.monotonic()
            command = [sys.executable, "-m", "lsdc.ray", folder, dest, "--weights", "small"]
            command += ["--encoding", "f32", "--per-shard", str(args.per_shard)]
            command += ["--address", victims.cluster.address]
            job = subprocess.Popen(command)
            workers = nodes = commands = 0
            while True:
                try:
                    job.wait(rng.expovariate(1 / args.pause))
                    break
                except subprocess.TimeoutExpired:
                    if not (dest / "done").exists():
                        continue
                kind = rng.choices(("worker", "node", "command"), SHARES)[0]
                if kind == "worker":
                    workers += victims.kill_worker(rng)
                elif kind == "node":
                    victims.kill_node(rng)
                    nodes += 1
                else:
                    job.kill()
                    job.wait()
                    job = subprocess.Popen(command)
                    commands += 1
            seconds = time.monotonic() - started
        finally:
            victims.stop()
        lost, doubled, different, empty = compared(folder, dest)
    kills = f"{workers} | {nodes} | {commands}"
    print("| frames | workers killed | nodes killed | commands killed | lost | doubled | other bits | without a depth | seconds |")
    print("|---|---|---|---|---|---|---|---|---|")
    print(f"| {args.frames} | {kills} | {lost} | {doubled} | {different} | {empty} | {seconds:.0f} |")
    return int(bool(lost or doubled or different or empty or job.returncode))


if __name__ == "__main__":
    sys.exit(main())
