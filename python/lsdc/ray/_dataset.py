"""Completion of the frames of a Dataset, anywhere in a pipeline of Ray Data."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import ray.data

from .._completer import Completer, Weights
from .._errors import InputError, SettingsError
from .._input import Order, Size, Unit
from .._settings import FitSettings, Robust
from ._frame import SCHEMA, Frame, Inputs, as_depths, as_picture, completed
from ._options import Encoding, Options


def complete(
    dataset: ray.data.Dataset,
    *,
    key: str = "key",
    image: str = "image",
    sparse: str = "sparse",
    sigma: str | float | None = None,
    guide: str | None = None,
    weights: Weights = "default",
    fit: FitSettings | None = None,
    robust: Robust = None,
    working_size: Size | None = None,
    encoder_side: int | None = None,
    unit: Unit | None = None,
    size: Size | None = None,
    order: Order = "rgb",
    encoding: Encoding = "f16",
    step: float = 0.001,
    standard_deviation: bool = False,
    batch_size: int = 8,
    device: str = "cpu",
    num_cpus: int = 1,
    num_gpus: float = 0,
    concurrency: int | tuple[int, int] | None = None,
) -> ray.data.Dataset:
    """Completes every row of a Dataset lazily, as a stream with one row out for each row in.
    
    Each actor holds the weights and one batch, and completes one frame at a time; Ray Data decides how many batches
    wait. Results lost with a worker or a node are computed again, with the same bits.

    Parameters
    ----------
    dataset : Dataset
        With the columns below.
    key, image, sparse : str
        Names of columns: keys, which are passed through; images, as arrays (H, W, 3), bytes of image files, or paths
        that every node can read; sparse depths, as arrays (see `Scene.complete`), or bytes of npy files or 16-bit
        images.
    sigma : str or number, optional
        The column of standard deviations of the depths, or one standard deviation for all.
    guide : str, optional
        The column of depth predictions from another source.
    weights, fit, robust, working_size, encoder_side
        See `Completer`.
    unit, size, order
        See `Scene.complete` and `Completer.scene`.
    encoding : "f16", "u16" or "f32"
        How depths are stored, in 2, 2 or 4 bytes. Half precision keeps 11 bits (0.05 %) at any scale. `step` is the
        unit of "u16": with 0.001, up to 65.5 m. `clipped` counts the pixels of a frame outside the range of the encoding.
    standard_deviation : bool
        Whether to store the standard deviation of every pixel as well, which takes time.
    batch_size : int
        Rows that an actor holds; small, because a row is a whole image.
    num_cpus : int
        CPUs and threads of an actor. With 1, many frames at a time make the best use of all cores.
    device : str
        The device of the networks of actors, see `Completer`. With "wgpu", an actor uses the discrete GPU with the number that
        Ray assigned to it, if it assigned one.
    num_gpus : float
        GPUs that an actor takes from Ray, such as 0.25 for four actors on each GPU.
    concurrency : int or (int, int), optional
        Number of actors, or its bounds. By default, as many as fit into the cluster.

    Returns
    -------
    Dataset
        Rows with `key`, `error` (None on success; a failed frame never stops the rest), `width`, `height`, `encoding`,
        `step`, `depth` and `standard_deviation` (bytes, see `decode`), `clipped`, `report` (JSON). Other columns are
        dropped: join them again by key. Keys are not checked for uniqueness.

    Raises
    ------
    SettingsError, InputError, WeightsError, ReadError
        Invalid options, or a column that is known to be missing; raised immediately.
    """
    completer = Completer(
        weights,
        fit=fit,
        robust=robust,
        working_size=working_size,
        encoder_side=encoder_side,
        threads=max(1, int(num_cpus)),
    )
    number = None if isinstance(sigma, str) else sigma
    check_gpus(device, num_gpus)
    options = Options(completer, unit, number, size, order, encoding, step, standard_deviation, device)
    columns = {"key": key, "image": image, "sparse": sparse}
    columns |= {"sigma": sigma} if isinstance(sigma, str) else {}
    columns |= {} if guide is None else {"guide": guide}
    names = dataset.columns(fetch_if_missing=False)
    if names is not None:
        _check(columns, names)
    return dataset.map_batches(
        _Worker,
        fn_constructor_args=(options, columns),
        batch_size=batch_size,
        batch_format="numpy",
        compute=actors(concurrency),
        num_cpus=num_cpus,
        num_gpus=num_gpus or None,
    )


def check_gpus(device: str, num_gpus: float) -> None:
    """Refuses GPUs that workers would take from Ray and not use, and numbers that Ray refuses later."""
    if not (np.isfinite(num_gpus) and num_gpus >= 0) or (num_gpus > 1 and num_gpus % 1 != 0):
        raise SettingsError(f"a worker cannot take {num_gpus} GPUs", "give a share of one, or a whole number")
    if num_gpus > 0 and device == "cpu":
        raise SettingsError("workers on the CPU need no GPUs", 'add the device "wgpu"')


def actors(concurrency: int | tuple[int, int] | None, initial: int = 1) -> ray.data.ActorPoolStrategy:
    """One task waits at each actor while another runs; more waiting tasks would not be shared with actors added later."""
    in_flight = 2
    if concurrency is None:
        return ray.data.ActorPoolStrategy(
            min_size=1, initial_size=initial, max_tasks_in_flight_per_actor=in_flight
        )
    least, most = concurrency if isinstance(concurrency, tuple) else (concurrency, concurrency)
    return ray.data.ActorPoolStrategy(
        min_size=least, max_size=most, max_tasks_in_flight_per_actor=in_flight
    )


def _check(columns: dict[str, str], names: Any) -> None:
    for part, name in columns.items():
        if name not in names:
            hint = f"it has {', '.join(names)}; `{part}=` says which to use"
            raise InputError(f"the dataset has no column `{name}`", hint)


class _Worker:
    """The actor that completes batches."""

    def __init__(self, options: Options, columns: dict[str, str]) -> None:
        self._options, self._columns = options, columns
        self._completer = options.on_worker()

    def __call__(self, batch: dict[str, Any]) -> pa.Table:
        _check(self._columns, batch)
        keys = batch[self._columns["key"]]
        rows = [
            completed(self._frame(str(key), batch, row), self._completer, self._options)
            for row, key in enumerate(keys)
        ]
        return pa.Table.from_pylist(rows, SCHEMA)

    def _frame(self, key: str, batch: dict[str, Any], row: int) -> Frame:
        def part(name: str) -> Any:
            return batch[self._columns[name]][row] if name in self._columns else None

        def decode() -> Inputs:
            others = [None if part(name) is None else _numbers(part(name)) for name in ("sigma", "guide")]
            return Inputs(as_picture(part("image")), _numbers(part("sparse")), *others)

        return Frame(key, decode)


def _numbers(value: Any) -> Any:
    """Stacks nested lists, which arrive as arrays of arrays."""
    value = as_depths(value)
    if isinstance(value, np.ndarray) and value.dtype == object:
        return np.stack(value.tolist())
    return value
