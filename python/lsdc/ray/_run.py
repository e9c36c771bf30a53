"""Shards as tasks of Ray Data.

A task is a shard: it fetches its frames, completes them one after the other, writes one file, and returns a summary.
Frames are transferred only from their source to a worker and to their shard; losing a worker loses only its current
shard; and a task that runs twice writes the same file twice.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from typing import Any

import ray
import ray.data

from ._dataset import actors
from ._frame import completed, failed
from ._options import Options
from ._plan import Shard
from ._shards import Destination
from ._sources import Source

# Largest number of tasks in Ray Data; with more shards, several share a task.
TASKS = 20_000


def run(
    shards: Sequence[Shard],
    source: Source,
    options: Options,
    destination: Destination,
    *,
    num_cpus: int = 1,
    num_gpus: float = 0,
    concurrency: int | None = None,
    progress: Callable[[dict[str, Any]], None] = lambda summary: None,
) -> None:
    """Completes shards on the cluster to which Ray is connected. Calls `progress` with the summary of each finished shard.
    The summary has `error` if the shard failed because its source or destination does not answer or is damaged."""
    if not shards:
        return
    ray.data.DataContext.get_current().enable_progress_bars = False
    # Objects of this process, which outlive the nodes that work on them.
    tasks = ray.data.from_items([asdict(shard) for shard in shards], override_num_blocks=min(len(shards), TASKS))
    # Start all actors at once instead of one by one.
    resources = ray.cluster_resources()
    room = int(resources.get("CPU", 1)) // num_cpus
    if num_gpus:
        room = min(room, int(resources.get("GPU", 0) / num_gpus))
    finished = tasks.map_batches(
        _Worker,
        fn_constructor_args=(source, options, destination),
        batch_size=1,
        batch_format="numpy",
        compute=actors(concurrency, initial=max(1, min(room, len(shards)))),
        num_cpus=num_cpus,
        num_gpus=num_gpus or None,
    )
    for row in finished.iter_rows():
        progress(json.loads(row["summary"]))


class _Worker:
    """The actor that completes shards."""

    def __init__(self, source: Source, options: Options, destination: Destination) -> None:
        self._source, self._options, self._destination = source, options, destination
        self._completer = options.on_worker()

    def __call__(self, batch: dict[str, Any]) -> dict[str, list[str]]:
        shard = Shard(str(batch["name"][0]), int(batch["frames"][0]), str(batch["reference"][0]))
        try:
            # The shard may be finished by a task that died afterwards, or that still runs on a machine considered lost.
            summary = self._destination.find(shard.name) or self._make(shard)
        # Errors of file and store libraries. Other shards continue; the same command retries this one.
        except Exception as error:
            what = f"{shard.name}: {type(error).__name__}: {error}"
            summary = {"frames": 0, "failed": [], "error": what}
        return {"summary": [json.dumps(summary)]}

    def _make(self, shard: Shard) -> dict[str, Any]:
        started = time.perf_counter()
        return self._destination.put(shard.name, self._rows(shard), lambda: time.perf_counter() - started)

    def _rows(self, shard: Shard) -> Iterable[dict[str, Any]]:
        attempts = self._destination.attempts(shard.name)
        count = 0
        try:
            for frame in self._source.frames(json.loads(shard.reference)):
                reason = attempts.begin(frame.key)
                if reason is None:
                    yield completed(frame, self._completer, self._options)
                else:
                    yield failed(frame.key, reason)
                count += 1
        finally:
            attempts.pause()
        if count != shard.frames:
            raise OSError(f"{shard.name} was planned for {shard.frames} frames, but {count} are there")
