"""Cameras: from points in space to points of an image, and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._errors import InputError
from ._input import Array, Size, as_array, as_positions, as_size

Floats = NDArray[np.float64]
Lens = Literal["pinhole", "radtan", "fisheye"]


@dataclass(frozen=True)
class Cloud:
    """The points of a cloud that a camera sees, and counts of those that it does not see."""

    points: Floats
    """Rows x, y, depth of the visible ones `(N, 3)`, for `Scene.complete`."""
    invalid: int
    """Points whose coordinates are not finite."""
    outside: int
    """Points behind the camera or outside the image."""
    hidden: int
    """Points occluded by nearer surfaces."""

    def __len__(self) -> int:
        return len(self.points)


class Camera:
    """A calibrated camera with its pose in the world. Axes as in OpenCV: x to the right, y down, z forwards; the
    centre of the first pixel is (0, 0).

    Parameters
    ----------
    focal, center : (float, float)
        Focal lengths and principal point in pixels.
    lens : "pinhole", "radtan" or "fisheye"
        With `coefficients` as in OpenCV: k1, k2, p1, p2, k3 to k6, or those of its fisheye module, k1 to k4. Those
        left out are 0.
    rotation : array (3, 3), translation : array (3,)
        From the world to the camera: points are first rotated, then translated.

    >>> camera = lsdc.Camera((100, 100), (31.5, 23.5))
    >>> cloud = camera.see([[0, 0, 2], [0.1, 0, 2], [0, 0, 5], [0, 0, -1]], (64, 48))
    >>> cloud.points
    array([[31.5, 23.5,  2. ],
           [36.5, 23.5,  2. ]])
    >>> cloud.hidden, cloud.outside
    (1, 1)
    """

    def __init__(
        self,
        focal: Sequence[float],
        center: Sequence[float],
        *,
        lens: Lens = "pinhole",
        coefficients: Sequence[float] = (),
        rotation: Array | None = None,
        translation: Array | None = None,
    ) -> None:
        turned = (
            np.eye(3)
            if rotation is None
            else np.asarray(as_array(rotation, "the rotation"), dtype=np.float64)
        )
        moved = (
            np.zeros(3)
            if translation is None
            else np.asarray(as_array(translation, "the translation"), np.float64)
        )
        if turned.shape != (3, 3) or moved.shape != (3,):
            raise InputError(
                f"a pose is a rotation (3, 3) and a translation (3,), not {turned.shape}, {moved.shape}"
            )
        self.lens: Lens = lens
        self.coefficients = tuple(float(value) for value in coefficients)
        self.rotation, self.translation = turned, moved
        self.focal, self.center = _pair(focal, "focal lengths"), _pair(center, "a principal point")
        self._native = _native.Camera(
            self.focal, self.center, lens, list(self.coefficients), turned.tolist(), moved.tolist()
        )

    def scaled(self, across: float, down: float) -> Camera:
        """The camera for the same image with this many times the columns and rows."""
        focal, center = self._native.scaled((across, down))
        pose = {"rotation": self.rotation, "translation": self.translation}
        return Camera(focal, center, lens=self.lens, coefficients=self.coefficients, **pose)

    def see(self, points: Array, size: Size) -> Cloud:
        """The points `(N, 3)` of the world that are visible in an image of this width and height. Points occluded by
        nearer surfaces are left out; where the nearer points are sparse, some remain."""
        return Cloud(*self._native.see(as_positions(points, 3), *as_size(size, "size")))

    def project(self, points: Array) -> Floats:
        """Rows x, y, depth `(N, 3)` of points `(N, 3)` of the world, in their order; NaN where a point is behind the
        camera, or beyond what the lens sees. Neither the borders of an image nor occlusion are looked at."""
        return self._native.project(as_positions(points, 3))

    def unproject(self, depth: Array) -> Floats:
        """Points of the world: `(H, W, 3)` of a depth map `(H, W)`, or `(N, 3)` of rows x, y, depth `(N, 3)`. NaN
        where there is no depth, or beyond what the lens sees.

        >>> lsdc.Camera((100, 100), (31.5, 23.5)).unproject([[36.5, 23.5, 2.0]])
        array([[0.1, 0. , 2. ]])
        """
        given = np.asarray(as_array(depth, "the depth"), dtype=np.float64)
        if given.ndim != 2:
            raise InputError(f"depth is a map (H, W) or rows x, y, depth, not {given.shape}")
        if given.shape[1] == 3:
            rows = np.ascontiguousarray(given)
            return self._native.unproject(np.ascontiguousarray(rows[:, :2]), np.ascontiguousarray(rows[:, 2]))
        down, across = np.indices(given.shape, dtype=np.float64)
        positions = np.stack([across.ravel(), down.ravel()], axis=1)
        return self._native.unproject(positions, given.ravel()).reshape(*given.shape, 3)

    def __repr__(self) -> str:
        return f"<lsdc.Camera {self.lens}, focal lengths {self.focal}, principal point {self.center}>"


def _pair(values: Sequence[float], what: str) -> tuple[float, float]:
    try:
        first, second = values
        return float(first), float(second)
    except (TypeError, ValueError):
        raise InputError(f"{what} are two numbers, not {values!r}") from None
