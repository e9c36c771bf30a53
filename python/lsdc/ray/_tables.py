"""Parquet: a row per frame, with image and depths as bytes of files or as nested lists of numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from .._errors import InputError, ReadError
from ._frame import Frame, Inputs, as_depths, as_picture
from ._place import Place

COLUMNS = {"key": "key", "image": "image", "sparse": "sparse", "sigma": "sigma", "guide": "guide"}
NEEDED = ("key", "image", "sparse")

# Number of rows held in memory.
ROWS = 8


class Tables:
    def __init__(self, place: Place, files: Sequence[str], columns: Mapping[str, str]) -> None:
        if unknown := set(columns) - set(COLUMNS):
            raise InputError(f"`{min(unknown)}` is no part of a frame", f"parts are {', '.join(COLUMNS)}")
        self._place, self._files, self._columns = place, list(files), COLUMNS | dict(columns)
        self._must = {*NEEDED, *columns}

    def files(self) -> Sequence[str]:
        return self._files

    def index(self, file: str) -> list[tuple[str, int]]:
        """Lists keys and their rows; reads only the column of keys."""
        with self._place.open(file) as stream, self._opened(stream, file) as table:
            names = set(table.schema_arrow.names)
            for part in sorted(self._must):
                if self._columns[part] not in names:
                    hint = f"it has {', '.join(sorted(names))}; `--column {part}=NAME` says which to use"
                    raise InputError(
                        f"`{self._place}/{file}` has no column `{self._columns[part]}`", hint
                    )
            keys = table.read(columns=[self._columns["key"]]).column(0).to_pylist()
        return [(str(key), row) for row, key in enumerate(keys)]

    def _opened(self, stream: Any, file: str) -> Any:
        try:
            return pq.ParquetFile(stream)
        except pa.ArrowInvalid as error:
            raise ReadError(f"`{self._place}/{file}` is no sound Parquet: {error}") from error

    def reference(self, file: str, entries: Sequence[tuple[str, int]]) -> Any:
        return [file, entries[0][1], len(entries)]

    def frames(self, reference: Any) -> Iterator[Frame]:
        file, start, count = reference
        with self._place.open(file) as stream, self._opened(stream, file) as table:
            sizes = [table.metadata.row_group(i).num_rows for i in range(table.num_row_groups)]
            ends = np.cumsum(sizes)
            first = int(np.searchsorted(ends, start, side="right"))
            last = int(np.searchsorted(ends, start + count - 1, side="right"))
            names = [name for name in self._columns.values() if name in table.schema_arrow.names]
            row = int(ends[first]) - sizes[first]
            groups = list(range(first, last + 1))
            for batch in table.iter_batches(ROWS, row_groups=groups, columns=names):
                low, high = max(start - row, 0), min(start + count - row, len(batch))
                for values in batch.slice(low, max(high - low, 0)).to_pylist() if low < high else []:
                    yield self._frame(values)
                row += len(batch)

    def _frame(self, values: dict[str, Any]) -> Frame:
        def part(name: str) -> Any:
            value = values.get(self._columns[name])
            return np.asarray(value) if isinstance(value, list) else value

        def decode() -> Inputs:
            others = [None if part(name) is None else as_depths(part(name)) for name in ("sigma", "guide")]
            return Inputs(as_picture(part("image")), as_depths(part("sparse")), *others)

        return Frame(str(values[self._columns["key"]]), decode)
