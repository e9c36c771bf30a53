"""Depth completion by least squares: an image and a few depths in, a dense depth map out, with its errors.

>>> depth = lsdc.complete(image, sparse)          # (H, W) float32, metres

A network turns the image alone into basis functions, which a fit then combines to match the depths. For an image whose
points change, run the network once (`Completer.scene`) and fit as often as you like (`Scene.complete`); a `Completion`
knows standard deviations, residuals, leave-one-out errors and outliers.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ._camera import Camera, Cloud
from ._completer import NAMES, Completer, Weights
from ._completion import Completion, Outliers
from ._errors import Error, FitError, InputError, ReadError, SettingsError, WeightsError
from ._files import Colmap, FileWarning, read_depth, read_points
from ._guide import DepthGuide
from ._input import Array, ImageLike, Noise, Order, Size, Unit
from ._native import __version__
from ._scene import Scene, Sparse
from ._settings import FitSettings, JointSettings, Robust, RobustSettings

__all__ = [
    "Camera",
    "Cloud",
    "Colmap",
    "Completer",
    "Completion",
    "DepthGuide",
    "Error",
    "FileWarning",
    "FitError",
    "FitSettings",
    "InputError",
    "JointSettings",
    "Outliers",
    "ReadError",
    "RobustSettings",
    "Scene",
    "SettingsError",
    "WeightsError",
    "__version__",
    "complete",
    "read_depth",
    "read_points",
]


def complete(
    image: ImageLike,
    sparse: Sparse,
    *,
    sigma: Array | float | None = None,
    noise: Noise | None = None,
    unit: Unit | None = None,
    robust: Robust = None,
    guide: DepthGuide | Array | None = None,
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
        A depth map of the image's shape, with 0 or NaN where there is no measurement; or points, one row x (to the
        right), y (down), depth[, sigma] each; or a file of either. See `Scene.complete`, also for `sigma`, `noise`,
        `unit`, `robust`, `guide` and `size`.
    weights, threads
        See `Completer`. Those that come with the package are prepared on first use and kept.

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
    if isinstance(weights, str) and weights in NAMES:
        completer = _prepared(weights, threads)
    else:
        completer = Completer(weights, threads=threads)
    scene = completer.scene(image, guide=guide, order=order)
    completion = scene.complete(sparse, sigma=sigma, noise=noise, unit=unit, robust=robust)
    return completion.depth_at(scene.size if size is None else size)


@lru_cache(maxsize=4)
def _prepared(weights: str, threads: int | None) -> Completer:
    return Completer(weights, threads=threads)
