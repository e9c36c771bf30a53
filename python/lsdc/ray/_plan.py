"""Assignment of frames to shards before any work begins, so that a retried shard gives the same file."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from .._errors import InputError, SettingsError
from ._options import as_text
from ._sources import Entry, Source

# Number of files listed at the same time.
LISTED = 32


@dataclass(frozen=True)
class Shard:
    """A task: frames whose results form one file."""

    name: str
    frames: int
    reference: str
    """JSON with which the source fetches the frames."""


@dataclass(frozen=True)
class Plan:
    shards: list[Shard]
    frames: int
    digest: str
    """Hash of all keys and shards, in order."""


def planned(source: Source, per_shard: int, dotless: bool = False) -> Plan:
    """Divides the frames of a source into shards of `per_shard` frames, which do not cross the end of a file.

    Raises
    ------
    InputError
        A key occurs twice, or has a dot in its last part if keys must be `dotless`; or there are no frames.
    """
    if per_shard < 1:
        raise SettingsError(f"a shard of {per_shard} frames is not possible")
    shards: list[Shard] = []
    digest, seen = hashlib.sha256(), set[str]()
    for file, entries in _listed(source):
        for key, _ in entries:
            _check(key, seen, dotless)
            seen.add(key)
        for start in range(0, len(entries), per_shard):
            part = entries[start : start + per_shard]
            shard = Shard(f"shard-{len(shards):07}", len(part), as_text(source.reference(file, part)))
            shards.append(shard)
            digest.update(as_text([shard.name, [key for key, _ in part]]).encode())
    if not shards:
        raise InputError("there is no frame to complete")
    return Plan(shards, len(seen), digest.hexdigest())


def _listed(source: Source) -> Iterator[tuple[str, list[Entry]]]:
    """Yields files and their entries in order, listing several files at once."""
    files: Any = source.files()
    with ThreadPoolExecutor(LISTED) as pool:
        for start in range(0, len(files), LISTED):
            some = files[start : start + LISTED]
            yield from zip(some, pool.map(source.index, some), strict=True)


def _check(key: str, seen: set[str], dotless: bool) -> None:
    if key in seen:
        raise InputError(f"the key `{key}` occurs twice", "results could not be told apart: name frames differently")
    if dotless and "." in key.rpartition("/")[2]:
        hint = "WebDataset ends keys at the first dot: write Parquet, or name frames differently"
        raise InputError(f"the key `{key}` has a dot", hint)
