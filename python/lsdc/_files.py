"""Depth maps, points and models from files, by the readers of the program."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Literal, Union

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._camera import Camera
from ._errors import InputError
from ._input import Size, as_size, per_metre
from ._pickling import Unpicklable
from ._warnings import FileWarning, warn

Path = Union[str, "os.PathLike[str]"]
FileUnit = Union[Literal["m", "cm", "mm", "kitti", "tum", "vkitti"], float]
"""Of depths in a file: a name, or the metres of one step."""
DepthKind = Literal["z", "ray"]
# The unit, whether it was guessed, and remarks to be checked.
_Said = tuple[str, bool, list[str]]
# Rows x, y, depth[, sigma]; numbers of points ignored, outside and hidden; unit and remarks.
_Points = tuple[NDArray[np.float64], list[int], _Said]


def read_depth(path: Path, *, unit: FileUnit | None = None) -> NDArray[np.float32]:
    """Reads a depth map: `npy`, `npz`, `png`, `pgm`, `tiff`, `exr`, `pfm` or `h5`.

    Parameters
    ----------
    unit : "m", "cm", "mm", "kitti", "tum", "vkitti", or the metres of one step
        Unit of the depths, if it is not in the file. Without it, integers are taken for millimetres and other numbers for
        metres, with a `FileWarning`.

    Returns
    -------
    array (H, W) of float32
        Metres; 0 at pixels without depth.

    Raises
    ------
    ReadError
        The file is missing, damaged, or contains no map.
    """
    depth, sigma, said = _native.read_depth(os.fspath(path), _name(unit))
    _warn(path, said, [] if sigma is None else ["its standard deviations are left out; `read_points` keeps them"])
    return depth


def read_points(
    path: Path, size: Size, *, camera: Camera | Path | None = None, unit: FileUnit | None = None,
    kind: DepthKind | None = None,
) -> NDArray[np.float64]:
    """Reads the known depths of an image: a map, a table of points (`csv`, `txt`, arrays of 3 or 4 columns), or a cloud
    (`ply`, `pcd`, `las`, `laz`, `xyz`, `bin`), whose visible points a camera projects.

    Parameters
    ----------
    size : (width, height)
        Size of the image that contains the points.
    camera : Camera or path
        Camera, or its path as for `Camera.from_file`; required for clouds.
    unit
        As for `read_depth`.
    kind : "z" or "ray"
        Quantity of depths in maps and tables of pixels: depth along the optical axis (default), or distance along the ray
        of the pixel, which needs the camera.

    Returns
    -------
    array (N, 3) or (N, 4) of float64
        Rows x, y, depth[, sigma] for `Scene.complete`, in pixels and metres; sigma is NaN for points without one. A
        `FileWarning` reports guesses and omissions.
    """
    seeing = camera if camera is None or isinstance(camera, Camera) else Camera.from_file(camera)
    native = None if seeing is None else seeing._native
    return _points(path, _native.read_points(os.fspath(path), as_size(size, "size"), native, _name(unit), kind))


class Colmap(Unpicklable):
    """A sparse COLMAP model: a folder with `cameras`, `images` and `points3D`, binary or text.

    Depths are in the unit of the model. Images alone do not determine its scale, and completion does not need it.

    Parameters
    ----------
    folder : path
    files : dict of bytes, optional
        Contents of these files by name, such as `cameras.bin`, if they are not on a disk; errors name the folder.

    Raises
    ------
    ReadError
        Files are missing or damaged, or an image has an unknown camera.
    """

    _instead = "send the folder, and read the model there"

    def __init__(self, folder: Path, *, files: Mapping[str, bytes] | None = None) -> None:
        self._native = _native.Colmap(os.fspath(folder), None if files is None else dict(files))
        self._folder = folder
        self.images: dict[str, tuple[int, int]] = dict(self._native.images())
        """The names of the images, and their widths and heights in the model."""

    def points(self, name: str, *, size: Size | None = None, exif: int = 1) -> NDArray[np.float64]:
        """Returns the points of the model that an image sees: rows x, y, depth, sigma `(N, 4)` for `Scene.complete`. Points that
        their images do not determine have a sigma of NaN.

        Parameters
        ----------
        name : str
            One of `images`.
        size : (width, height)
            Size of the file, if it differs from the model.
        exif : int from 1 to 8
            Orientation of the file, Pillow's `image.getexif().get(0x0112, 1)`: images given by path are rotated upright,
            but models refer to stored pixels.

        Raises
        ------
        InputError, ReadError
            There is no image of this name, its proportions differ from the model, or it sees no points.
        """
        return _points(name, self._seen(name, size, exif))

    def _seen(self, name: str, size: Size | None, exif: int) -> _Points:
        if exif not in range(1, 9):
            raise InputError(f"`exif` is {exif!r}, not a number from 1 to 8")
        return self._native.points(name, None if size is None else as_size(size, "size"), exif)

    def __repr__(self) -> str:
        return f"<lsdc.Colmap {os.fspath(self._folder)!r}, {len(self.images)} images>"


def _name(unit: FileUnit | None) -> str | None:
    """Converts a unit for the extension module, in which numbers are steps per metre."""
    return unit if unit is None or isinstance(unit, str) else str(per_metre(unit))


def _points(path: Path, found: _Points) -> NDArray[np.float64]:
    table, (ignored, outside, hidden), said = found
    left_out = {"without a usable depth": ignored, "outside the image": outside, "hidden": hidden}
    counts = ", ".join(f"{count} {what}" for what, count in left_out.items() if count)
    _warn(path, said, [f"points left out: {counts}"] if counts else [])
    return table


def _warn(path: Path, said: _Said, more: list[str] | None = None) -> None:
    unit, guessed, remarks = said
    guess = [f"taken to be in {unit}; `unit` says otherwise"] if guessed else []
    warn(os.fspath(path), [*guess, *remarks, *(more or [])], FileWarning)
