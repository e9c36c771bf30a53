"""The files of results."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from .._errors import SettingsError
from ._attempts import Attempts
from ._frame import SCHEMA, TYPES
from ._options import as_text
from ._place import Place

Format = Literal["parquet", "tar"]

# Rows that are buffered before they are compressed.
ROWS = 16

# Number of simultaneous requests.
READ = 32


class Destination:
    """A folder of results:

    - `plan.json`: the frames and options, so that no other results are added
    - `data/shard-0000000.parquet` or `.tar`: the results
    - `done/shard-0000000.json`: written after its shard, with its number of frames and its failures
    - `failures.csv`: all failures
    """

    def __init__(self, place: Place, format: Format) -> None:
        if format not in WRITERS:
            raise SettingsError(f"`format` is {format!r}", f"formats are {', '.join(WRITERS)}")
        self._place, self._format = place, format

    def begin(self, plan: dict[str, Any]) -> None:
        """Writes the plan; refuses a folder with another plan or other files."""
        plan = {**plan, "format": self._format}
        if not self._place.is_file("plan.json"):
            if there := self._place.files()[:1]:
                raise SettingsError(f"`{self._place}` has other files: `{there[0]}`", "give an empty folder")
            self._place.write("plan.json", (json.dumps(plan, sort_keys=True, indent=2) + "\n").encode())
            return
        # Compare with what is read back, in which tuples are lists.
        before, now = json.loads(self._place.read("plan.json")), json.loads(as_text(plan))
        if differing := [name for name in {**now, **before} if before.get(name) != now.get(name)]:
            was, wanted = (as_text(record.get(differing[0])) for record in (before, now))
            raise SettingsError(
                f"`{self._place}` was begun with another `{differing[0]}`: {was[:80]}, now {wanted[:80]}",
                "resume with the same frames and options, or give another folder",
            )

    def finished(self) -> set[str]:
        """Returns the names of finished shards."""
        return {name[len("done/") : -len(".json")] for name in self._place.files("done")}

    def attempts(self, name: str) -> Attempts:
        """Begins an attempt at a shard."""
        return Attempts(self._place, name)

    def find(self, name: str) -> dict[str, Any] | None:
        """Returns the summary of a finished shard; None if it is not finished."""
        file = f"done/{name}.json"
        return json.loads(self._place.read(file)) if self._place.is_file(file) else None

    def put(self, name: str, rows: Iterable[dict[str, Any]], seconds: Callable[[], float]) -> dict[str, Any]:
        """Writes a shard and then its summary."""
        frames = clipped = 0
        failures: list[list[str]] = []

        def counted() -> Iterable[dict[str, Any]]:
            nonlocal frames, clipped
            for row in rows:
                frames += 1
                clipped += bool(row["clipped"])
                if row["error"] is not None:
                    failures.append([row["key"], row["error"]])
                yield row

        data = WRITERS[self._format](counted())
        self._place.write(f"data/{name}.{self._format}", data)
        summary: dict[str, Any] = {"frames": frames, "failed": failures, "clipped": clipped, "bytes": len(data)}
        summary["seconds"] = round(seconds(), 3)
        self._place.write(f"done/{name}.json", as_text(summary).encode())
        return summary

    def summaries(self) -> dict[str, dict[str, Any]]:
        """Returns the summaries of all finished shards, by name."""
        names = sorted(self.finished())
        with ThreadPoolExecutor(READ) as pool:
            found = pool.map(self.find, names)
            return {name: summary for name, summary in zip(names, found, strict=True) if summary}

    def end(self, summaries: dict[str, dict[str, Any]]) -> None:
        """Writes the table of failures."""
        lines = ["key,shard,error\n"]
        for name, summary in summaries.items():
            lines += [f"{_quoted(key)},{name},{_quoted(error)}\n" for key, error in summary["failed"]]
        self._place.write("failures.csv", "".join(lines).encode())
        self._place.clean()


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""').replace("\n", " ") + '"'


def _parquet(rows: Iterable[dict[str, Any]]) -> bytes:
    target = io.BytesIO()
    with pq.ParquetWriter(target, SCHEMA, compression="zstd", use_dictionary=False) as writer:
        some: list[dict[str, Any]] = []
        for row in rows:
            some.append(row)
            if len(some) == ROWS:
                writer.write_table(pa.Table.from_pylist(some, SCHEMA))
                some.clear()
        if some:
            writer.write_table(pa.Table.from_pylist(some, SCHEMA))
    return target.getvalue()


def _tar(rows: Iterable[dict[str, Any]]) -> bytes:
    """Encodes rows for WebDataset: `KEY.depth.npy`, `KEY.standard_deviation.npy`, and the rest in `KEY.json`."""
    target = io.BytesIO()
    with tarfile.open(fileobj=target, mode="w", format=tarfile.GNU_FORMAT) as tar:
        for row in rows:
            described = {name: value for name, value in row.items() if not isinstance(value, bytes)}
            if row["report"] is not None:
                described["report"] = json.loads(row["report"])
            _add(tar, f"{row['key']}.json", as_text(described).encode())
            for name in ("depth", "standard_deviation"):
                if row[name] is not None:
                    # Standard deviations are always floats.
                    form = row["encoding"] if name == "depth" or row["encoding"] == "f32" else "f16"
                    values = np.frombuffer(row[name], TYPES[form]).reshape(row["height"], row["width"])
                    content = io.BytesIO()
                    np.save(content, values)
                    _add(tar, f"{row['key']}.{name}.npy", content.getvalue())
    return target.getvalue()


def _add(tar: tarfile.TarFile, name: str, data: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size = len(data)
    tar.addfile(member, io.BytesIO(data))


WRITERS: dict[str, Callable[[Iterable[dict[str, Any]]], bytes]] = {"parquet": _parquet, "tar": _tar}
