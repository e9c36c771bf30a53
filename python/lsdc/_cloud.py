"""Point clouds from depth maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._camera import Camera
from ._errors import InputError, SettingsError
from ._input import Size


@dataclass(frozen=True)
class PointCloud:
    """The pixels of a depth map as points in space, row by row; see `Completion.point_cloud`."""

    points: NDArray[np.floating[Any]]
    """x, y, z `(N, 3)` in the world of the camera: float32, or float64 if a coordinate is beyond 1000 m."""
    colors: NDArray[np.uint8]
    """Red, green, blue `(N, 3)`."""
    sigma: NDArray[np.float32] | None
    """Standard deviation of the depth of each point `(N,)`; None if there are too few known depths for an estimate."""
    uncertain: int
    """Number of pixels left out because their standard deviation is above `max_sigma` or `max_relative_sigma`."""
    unseen: int
    """Number of pixels left out because they are outside the view of the lens."""
    flying: int
    """Number of pixels left out because they lie between the surfaces at a depth edge."""
    merged: int
    """Number of pixels that share a voxel with an earlier one."""

    def __len__(self) -> int:
        return len(self.points)


def cloud_of(
    native: _native.Completion,
    camera: Camera,
    size: Size,
    max_sigma: float | None,
    max_relative_sigma: float | None,
    voxel: float | None,
    keep_flying: bool,
) -> PointCloud:
    if not isinstance(cast(Any, camera), Camera):
        hint = "`lsdc.Camera.from_file(path)` reads one, `lsdc.Camera.from_matrix(K, size)` takes that of OpenCV"
        raise InputError(f"`camera` is a {type(camera).__name__}, not a lsdc.Camera", hint)
    for name, value in (("max_sigma", max_sigma), ("max_relative_sigma", max_relative_sigma), ("voxel", voxel)):
        if value is not None and not 0 < value < np.inf:
            raise SettingsError(f"`{name}` is {value!r}, not a positive number of metres")
    points, colors, sigma, counts = native.point_cloud(camera._native, size, max_sigma, max_relative_sigma, voxel, keep_flying)
    return PointCloud(points, colors, sigma, *counts)
