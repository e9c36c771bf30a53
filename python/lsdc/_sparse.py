"""Known depths from arrays or files."""

from __future__ import annotations

import os
from typing import Union

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._errors import InputError
from ._files import read_points
from ._input import Array, Noise, Size, Unit, as_array, as_observations, with_noise

Sparse = Union[Array, tuple[Array, ...], "os.PathLike[str]", str]
"""A map, a table or columns of points, or the path of a file of them."""


def observed(
    sparse: Sparse, sigma: Array | float | None, noise: Noise | None, unit: Unit | None, size: Size
) -> _native.Observations:
    """Returns depths in an image of this width and height; those without a standard deviation get that of a depth camera."""
    if isinstance(sparse, (str, os.PathLike)):
        if noise is not None and unit is None:
            raise InputError("`noise` is in metres, but the unit of a file may be a guess", 'give `unit`, as in "m"')
        sparse, unit = read_points(sparse, size, unit=unit), None
    known = as_observations(sparse, sigma, unit, size)
    return known if noise is None else with_noise(known, noise)


def remove_hidden(sparse: Array, *, unit: Unit | None = None) -> tuple[NDArray[np.float32], int]:
    """Removes points that nearer ones hide, from the depth map of a projected scan.

    A scanner beside the camera measures background that the camera does not see, next to the outlines of nearer objects. If
    points lie between two sides of an object, points next to nearer ones are removed. `read_points` and `Camera.see` do so.

    Parameters
    ----------
    sparse : array (H, W)
        A depth map, with 0 or NaN at pixels without a measurement.
    unit : "m", "cm", "mm" or metres of one step
        See `Scene.complete`.

    Returns
    -------
    array (H, W) of float32
        Metres, 0 at pixels without a point.
    int
        Number of removed points.

    Raises
    ------
    InputError
        `sparse` is no map.

    >>> visible, hidden = lsdc.remove_hidden(sparse)
    >>> visible.shape, hidden
    ((48, 64), 0)
    """
    shape = as_array(sparse, "the map").shape
    if len(shape) != 2:
        raise InputError(f"the map has shape {shape}", "give (H, W); `Camera.see` removes hidden points of clouds")
    size = (shape[1], shape[0])
    known, hidden = as_observations(sparse, None, unit, size).without_hidden(size)
    visible = np.zeros(shape, np.float32)
    points = known.table()
    visible[points[:, 1].astype(int), points[:, 0].astype(int)] = points[:, 2]
    return visible, hidden
