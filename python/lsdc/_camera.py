"""Cameras: projection of points in space to an image, and back."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._errors import InputError, SettingsError
from ._input import Array, Size, as_array, as_positions, as_size

Floats = NDArray[np.float64]
Lens = Literal["pinhole", "radtan", "fisheye"]
# Lenses and their numbers of coefficients.
LENSES: dict[Lens, int] = {"pinhole": 0, "radtan": 8, "fisheye": 4}
# Lenses by their names, including those of ROS.
MODELS: dict[str, Lens] = {
    "pinhole": "pinhole",
    "radtan": "radtan",
    "plumb_bob": "radtan",
    "rational_polynomial": "radtan",
    "fisheye": "fisheye",
    "equidistant": "fisheye",
}


@dataclass(frozen=True)
class Cloud:
    """The points of a cloud that a camera sees, and the numbers of those that it does not see."""

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

    `Camera.from_file` reads a file, `Camera.from_matrix` takes the matrix of OpenCV, Open3D or ROS.

    Parameters
    ----------
    focal, center : (float, float)
        Focal lengths and principal point in pixels.
    lens : "pinhole", "radtan" or "fisheye"
        With `coefficients` as in OpenCV: k1, k2, p1, p2, k3 to k6, or k1 to k4 of its fisheye module. Missing
        coefficients are 0.
    rotation : array (3, 3), translation : array (3,)
        From the world to the camera: points are first rotated, then translated.
    size : (width, height), optional
        Size of the image to which the numbers belong. If given, the camera adapts to the same image with more or fewer
        pixels, and is refused for images of another shape.

    Raises
    ------
    InputError, SettingsError
        Arguments of another shape or type, or numbers that no camera has.

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
        size: Size | None = None,
    ) -> None:
        self.rotation = _numbers(np.eye(3) if rotation is None else rotation, (3, 3), "a rotation")
        self.translation = _numbers(np.zeros(3) if translation is None else translation, (3,), "a translation")
        if lens not in LENSES:
            raise SettingsError(f"`lens` is {lens!r}", f"lenses: {', '.join(LENSES)}")
        self.lens: Lens = lens
        self.coefficients = tuple(_numbers(coefficients, None, "coefficients").tolist())
        self.focal, self.center = _pair(focal, "focal lengths"), _pair(center, "a principal point")
        self.size: Size | None = None if size is None else as_size(size, "size")
        """Width and height of the image, if they are known."""
        pose = (self.rotation.tolist(), self.translation.tolist())
        self._native = _native.Camera(self.focal, self.center, lens, list(self.coefficients), pose, self.size)

    @classmethod
    def from_file(cls, path: str | os.PathLike[str]) -> Camera:
        """Reads a camera: TOML or JSON with `fx, fy, cx, cy`, or with the `intrinsic_matrix` of Open3D, and `width, height`,
        `model`, `distortion` and a pose; or YAML, the camera_info of ROS.

        Raises
        ------
        ReadError
            The file is missing, or is not a camera.
        """
        return cls._of(_native.Camera.read(os.fspath(path)))

    @classmethod
    def from_matrix(
        cls,
        matrix: Array,
        size: Size,
        distortion: Array | None = None,
        *,
        model: str | None = None,
        rotation: Array | None = None,
        translation: Array | None = None,
    ) -> Camera:
        """Makes a camera from its matrix K.

        Parameters
        ----------
        matrix : array (3, 3), or its 9 numbers row by row
            `[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`, as from `cv2.calibrateCamera`, from the `intrinsic_matrix` of
            `open3d.camera.PinholeCameraIntrinsic`, or `k` of the camera_info of ROS.
        size : (width, height)
            Size of the image to which the matrix belongs.
        distortion : array, optional
            The coefficients of the lens as OpenCV and ROS order them, of any shape.
        model : str, optional
            "pinhole", "radtan" ("plumb_bob", "rational_polynomial") or "fisheye" ("equidistant"), with ROS names in
            brackets. By default, a lens with coefficients is "radtan", as from `cv2.calibrateCamera`; `cv2.fisheye` needs
            "fisheye".
        rotation, translation
            See `Camera`.

        Raises
        ------
        InputError, SettingsError
            A matrix of another shape, with skew, or transposed; more coefficients than the lens has.

        >>> lsdc.Camera.from_matrix([[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1]], (640, 480))
        <lsdc.Camera pinhole 640x480, focal lengths (500.0, 500.0), principal point (319.5, 239.5)>
        """
        given = as_array(matrix, "the matrix")
        numbers = _numbers(given.reshape(3, 3) if given.shape == (9,) else given, (3, 3), "a matrix")
        (fx, skew, cx), (below, fy, cy), last = numbers.tolist()
        if last != [0, 0, 1] or below != 0:
            hint = "give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
            if numbers.T[2].tolist() == [0, 0, 1]:
                hint = "it is transposed: give `matrix.T`"
            raise InputError(f"{numbers.tolist()} is not the matrix of a camera", hint)
        if skew != 0:
            raise SettingsError(f"the matrix has a skew of {skew}, which is not supported", "undistort the image first")
        coefficients = np.zeros(0) if distortion is None else _numbers(distortion, None, "a distortion")
        if model is None:
            model = "radtan" if coefficients.any() else "pinhole"
        if model not in MODELS:
            raise SettingsError(f"`model` is {model!r}", f"models: {', '.join(MODELS)}")
        lens = MODELS[model]
        # Unsupported coefficients (prisms, tilted sensors) may be 0.
        known = LENSES[lens]
        if not coefficients[known:].any():
            coefficients = coefficients[:known]
        return cls(
            (fx, fy),
            (cx, cy),
            lens=lens,
            coefficients=coefficients.tolist(),
            rotation=rotation,
            translation=translation,
            size=size,
        )

    @classmethod
    def _of(cls, native: _native.Camera) -> Camera:
        focal, center, lens, coefficients, (rotation, translation), size = native.numbers()
        return cls(
            focal,
            center,
            lens=cast(Lens, lens),
            coefficients=coefficients,
            rotation=rotation,
            translation=translation,
            size=size,
        )

    def __reduce__(self) -> tuple[Any, ...]:
        pose = (self.rotation, self.translation)
        return _restored, (self.focal, self.center, self.lens, self.coefficients, *pose, self.size)

    def with_pose(self, pose: Array) -> Camera:
        """Returns the same camera at a pose: a camera-to-world matrix `(4, 4)` or `(3, 4)` with the axes of OpenCV. In matrices
        of OpenGL or `transforms.json`, the axes y and z are reversed: give `matrix @ np.diag([1, -1, -1, 1])`.

        >>> pose = np.eye(4)
        >>> pose[:3, 3] = 1, 0, 0
        >>> lsdc.Camera((100, 100), (31.5, 23.5)).with_pose(pose).project([[1, 0, 2]])
        array([[31.5, 23.5,  2. ]])
        """
        given = as_array(pose, "a pose")
        matrix = _numbers(given, (3, 4) if given.shape == (3, 4) else (4, 4), "a pose")
        if given.shape == (4, 4) and matrix[3].tolist() != [0, 0, 0, 1]:
            hint = "it is transposed: give `pose.T`" if matrix[:, 3].tolist() == [0, 0, 0, 1] else None
            raise InputError(f"the last row of a pose is {matrix[3].tolist()}, not 0, 0, 0, 1", hint)
        rotation = matrix[:3, :3].T
        return _restored(
            self.focal, self.center, self.lens, self.coefficients, rotation, -rotation @ matrix[:3, 3], self.size
        )

    def scaled(self, across: float, down: float) -> Camera:
        """Returns the camera for the same image with columns and rows scaled by these factors."""
        focal, center = self._native.scaled((across, down))
        size = None if self.size is None else (round(self.size[0] * across), round(self.size[1] * down))
        return _restored(focal, center, self.lens, self.coefficients, self.rotation, self.translation, size)

    def see(self, points: Array, size: Size) -> Cloud:
        """Returns the points `(N, 3)` of the world that are visible in an image of this width and height. Points occluded by
        nearer surfaces are left out; some remain where the nearer points are sparse."""
        return Cloud(*self._native.see(as_positions(points, 3), *as_size(size, "size")))

    def project(self, points: Array) -> Floats:
        """Projects points `(N, 3)` of the world to rows x, y, depth `(N, 3)`, in their order; NaN if a point is behind the
        camera or outside the view of the lens. Image borders and occlusion are not considered."""
        return self._native.project(as_positions(points, 3))

    def unproject(self, depth: Array) -> Floats:
        """Returns points of the world: `(H, W, 3)` for a depth map `(H, W)`, or `(N, 3)` for rows x, y, depth `(N, 3)`. NaN at
        pixels without depth or outside the view of the lens.

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
        size = "" if self.size is None else f" {self.size[0]}x{self.size[1]}"
        return f"<lsdc.Camera {self.lens}{size}, focal lengths {self.focal}, principal point {self.center}>"


def _restored(
    focal: tuple[float, float],
    center: tuple[float, float],
    lens: Lens,
    coefficients: Sequence[float],
    rotation: Array,
    translation: Array,
    size: Size | None,
) -> Camera:
    pose = {"rotation": rotation, "translation": translation}
    return Camera(focal, center, lens=lens, coefficients=coefficients, size=size, **pose)


def _pair(values: Sequence[float], what: str) -> tuple[float, float]:
    hint = "`lsdc.Camera((fx, fy), (cx, cy))`, or `lsdc.Camera.from_matrix(K, (width, height))`"
    try:
        first, second = values
        return float(first), float(second)
    except (TypeError, ValueError):
        raise InputError(f"{what} are two numbers, not {values!r}", hint) from None


def _numbers(values: Array, shape: tuple[int, ...] | None, what: str) -> Floats:
    """Converts a value to numbers of this shape, or of any shape flattened."""
    found = as_array(values, what)
    if found.size > 0 and found.dtype.kind not in "fiu":
        raise InputError(f"{what} has values of type {found.dtype}, not numbers")
    if shape is not None and found.shape != shape:
        raise InputError(f"{what} has the shape {shape}, not {found.shape}")
    found = found.astype(np.float64)
    return found.ravel() if shape is None else found
