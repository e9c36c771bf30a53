"""Many images, one after another."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any, Union

from ._completion import Completion
from ._errors import Error, InputError, SettingsError

Progress = Callable[[int, Union[int, None]], object]
"""Is called with the number of images that are done, and that of all, or None if it is not known."""


@dataclass(frozen=True)
class Completed:
    """The result of one of many images."""

    index: int
    """Its place among the images."""
    completion: Completion | None
    """None if it failed."""
    error: Error | None
    """Why it failed, or None."""

    def result(self) -> Completion:
        """The completion; raises the error if there is one."""
        if self.completion is None:
            raise self.error or Error("nothing was computed")
        return self.completion


def complete_each(
    work: Callable[..., Completion],
    columns: list[Iterable[Any]],
    workers: int,
    progress: Progress | None,
) -> Iterator[Completed]:
    """Runs `work` on each row of the columns, on a number of threads, and yields the results in order. Rows are requested as
    threads become free."""
    if workers < 1:
        raise SettingsError(f"`workers` is {workers}, which is less than one")
    lengths = [len(column) for column in columns if hasattr(column, "__len__")]  # type: ignore[arg-type]
    return _each(work, columns, workers, progress, min(lengths, default=None))


def _each(
    work: Callable[..., Completion],
    columns: list[Iterable[Any]],
    workers: int,
    progress: Progress | None,
    total: int | None,
) -> Iterator[Completed]:
    def attempt(index: int, row: tuple[Any, ...]) -> Completed:
        try:
            return Completed(index, work(*row), None)
        except Error as error:
            return Completed(index, None, error)

    missing = object()
    running: deque[Future[Completed]] = deque()
    count, uneven = 0, False

    def first() -> Completed:
        done = running.popleft().result()
        if progress is not None:
            progress(done.index + 1, total)
        return done

    pool = ThreadPoolExecutor(workers, thread_name_prefix="lsdc")
    try:
        for row in zip_longest(*columns, fillvalue=missing):
            uneven = any(value is missing for value in row)
            if uneven:
                break
            if len(running) == workers:
                yield first()
            running.append(pool.submit(attempt, count, row))
            count += 1
        while running:
            yield first()
    finally:
        # Also if the caller stops early.
        pool.shutdown(wait=True, cancel_futures=True)
    if uneven:
        raise InputError(f"there are {count} images or points, but more of the other", "give as many of each")
