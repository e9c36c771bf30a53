"""Images of a sequence with their poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from . import _native
from ._camera import Camera
from ._errors import InputError
from ._input import Array, Noise, Size, Unit, as_array, as_count, as_size
from ._pickling import Unpicklable
from ._sparse import Sparse, observed


class PosedView(Unpicklable):
    """The measured points of one image of a sequence, and its camera with the pose. Poses and depths have the same unit.

    Parameters
    ----------
    sparse : array, tuple of arrays or path
        The known depths of the image, as for `Scene.complete`.
    camera : Camera
        Camera of the image, with any lens.
    pose : array (4, 4) or (3, 4), optional
        From the camera to the world, with the axes of OpenCV (x to the right, y down, z forwards), as for `Camera.with_pose`;
        by default the pose of the camera.
    size : (width, height), optional
        Size of the image; by default the size of the camera.
    sigma, noise, unit
        As for `Scene.complete`.
    ids : array (N,) of integers, optional
        Identity of every point, as in a structure-from-motion model: a point shared by views was measured once.

    Raises
    ------
    InputError, SettingsError
        Arrays of another shape or type, a pose that mirrors or scales, no size, or different numbers of ids and points.

    >>> pose = np.eye(4)
    >>> pose[:3, 3] = 0.5, 0, 0
    >>> camera = lsdc.Camera((60, 60), (31.5, 23.5), size=(64, 48))
    >>> lsdc.PosedView(sparse, camera, pose)
    <lsdc.PosedView 64x48, 192 points>
    """

    _instead = "send the points, the camera and the pose, and make the view there"

    def __init__(
        self,
        sparse: Sparse,
        camera: Camera,
        pose: Array | None = None,
        *,
        size: Size | None = None,
        sigma: Array | float | None = None,
        noise: Noise | None = None,
        unit: Unit | None = None,
        ids: Array | None = None,
    ) -> None:
        size = camera.size if size is None else as_size(size, "size")
        if size is None:
            raise InputError("the size of the image is not known", "give `size=(width, height)`, here or to the camera")
        self.size: Size = size
        """Width and height of the image."""
        self.camera: Camera = camera if pose is None else camera.with_pose(pose)
        """At its pose."""
        self._given = observed(sparse, sigma, noise, unit, size)
        numbers = None
        if ids is not None:
            found = as_array(ids, "`ids`")
            if found.dtype.kind not in "iu" or found.ndim != 1:
                raise InputError(f"`ids` are whole numbers (N,), not {found.shape} of {found.dtype}")
            numbers = np.ascontiguousarray(found.astype(np.uint64))
        self._native = _native.PosedView(self.camera._native, size, self._given, numbers)

    def __len__(self) -> int:
        return len(self._given)

    def __repr__(self) -> str:
        width, height = self.size
        return f"<lsdc.PosedView {width}x{height}, {len(self)} points>"


def neighbours(
    views: Sequence[PosedView], index: int, *, count: int = 8, only_past: bool = False
) -> list[int]:
    """Returns the indices of the views that share most with the view of an index, best first. Views that share less than a
    twentieth are not neighbours. With `only_past`, only earlier views are, as in online use.

    >>> camera = lsdc.Camera((60, 60), (31.5, 23.5), size=(64, 48))
    >>> poses = [np.eye(4) for _ in range(4)]
    >>> for i, pose in enumerate(poses):
    ...     pose[0, 3] = 0.3 * i
    >>> views = [lsdc.PosedView(sparse, camera, pose) for pose in poses]
    >>> lsdc.neighbours(views, 2, count=2), lsdc.neighbours(views, 2, only_past=True)
    ([1, 3], [1, 0])
    """
    place = range(len(views))[index]
    return _native.neighbours([view._native for view in views], place, as_count(count, "count"), only_past)
