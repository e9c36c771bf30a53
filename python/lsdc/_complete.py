"""Completion in one call."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ._completer import NAMES, Completer, Weights
from ._input import Array, ImageLike, Noise, Order, Size, Unit
from ._many import Completed, Progress
from ._scene import Guide
from ._settings import Robust
from ._sparse import Sparse


def complete(
    image: ImageLike,
    sparse: Sparse,
    *,
    sigma: Array | float | None = None,
    noise: Noise | None = None,
    unit: Unit | None = None,
    robust: Robust = None,
    guide: Guide | Literal["none"] | None = None,
    size: Size | None = None,
    order: Order = "rgb",
    weights: Weights = "default",
    threads: int | None = None,
) -> NDArray[np.float32]:
    """Completes sparse depths of an image.

    Parameters
    ----------
    image : array (H, W, 3), (H, W) or (H, W, 4), image of Pillow, or path
        See `Completer.scene`.
    sparse : array (H, W), (N, 3) or (N, 4), tuple of arrays (N,), or path
        A depth map of the image's shape, with 0 or NaN at pixels without a measurement; or points as rows x (to the
        right), y (down), depth[, sigma]; or a file of either. See `Scene.complete`, also for `sigma`, `noise`, `unit`,
        `robust`, `guide` and `size`.
    weights, threads
        See `Completer`. Weights of the package are prepared on first use and cached.

    Returns
    -------
    array (H, W) of float32
        Metres, positive and finite at every pixel.

    >>> depth = lsdc.complete(image, sparse)
    >>> depth.shape, depth.dtype
    ((48, 64), dtype('float32'))
    >>> millimetres = (sparse * 1000).astype(np.uint16)
    >>> bool(np.allclose(lsdc.complete(image, millimetres, unit="mm"), depth, atol=2e-3))
    True
    """
    scene = _completer(weights, threads).scene(image, guide=guide, order=order)
    completion = scene.complete(sparse, sigma=sigma, noise=noise, unit=unit, robust=robust)
    return completion.depth_at(scene.size if size is None else size)


def complete_many(
    images: Iterable[ImageLike],
    points: Iterable[Sparse],
    *,
    guides: Iterable[Guide | Literal["none"] | None] | None = None,
    sigma: float | None = None,
    noise: Noise | None = None,
    unit: Unit | None = None,
    robust: Robust = None,
    size: Size | None = None,
    order: Order = "rgb",
    weights: Weights = "default",
    threads: int | None = None,
    workers: int = 2,
    progress: Progress | None = None,
) -> Iterator[Completed]:
    """Completes many images, each with its own depths: `Completer.complete_many` with these weights.

    >>> for done in lsdc.complete_many([image, image], [sparse, sparse * 0], weights="small"):
    ...     print(done.index, done.completion or done.error)
    0 <lsdc.Completion 64x48, 192 points, residual 0.00... m>
    1 there is no sparse depth to fit: ...
    """
    completer = _completer(weights, threads)
    return completer.complete_many(
        images,
        points,
        guides=guides,
        sigma=sigma,
        noise=noise,
        unit=unit,
        robust=robust,
        size=size,
        order=order,
        workers=workers,
        progress=progress,
    )


def _completer(weights: Weights, threads: int | None) -> Completer:
    if isinstance(weights, str) and weights in NAMES:
        return _prepared(weights, threads)
    return Completer(weights, threads=threads)


@lru_cache(maxsize=4)
def _prepared(weights: str, threads: int | None) -> Completer:
    return Completer(weights, threads=threads)
