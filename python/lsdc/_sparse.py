"""Known depths from arrays or files."""

from __future__ import annotations

import os
from typing import Union

from . import _native
from ._errors import InputError
from ._files import read_points
from ._input import Array, Noise, Size, Unit, as_observations, with_noise

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
