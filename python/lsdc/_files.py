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
# The unit, whether it was guessed, and what should be checked.
_Said = tuple[str, bool, list[str]]
# Rows x, y, depth[, sigma]; counts of those ignored, outside and hidden; what was said.
_Points = tuple[NDArray[np.float64], list[int], _Said]


def read_depth(path: Path, *, unit: FileUnit | None = None) -> NDArray[np.float32]:
    """Reads a map of depths: `npy`, `npz`, `png`, `pgm`, `tiff`, `exr`, `pfm` or `h5`.

    Parameters
    ----------
    unit : "m", "cm", "mm", "kitti", "tum", "vkitti", or the metres of one step
        If the file does not say: without it, integers are taken for millimetres and other numbers for metres, with a
        `FileWarning`.

    Returns
    -------
    array (H, W) of float32
        Metres; 0 where there is no depth.

    Raises
    ------
    ReadError
        A file that is missing, damaged, or holds no map.
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
        Of the image that the points lie in.
    camera : Camera or path
        Which clouds need: a camera, or the path of one as for `Camera.from_file`.
    unit
        As for `read_depth`.
    kind : "z" or "ray"
        What the depths of maps and tables of pixels measure: depth along the optical axis, or the distance along the ray of
        the pixel, which needs the camera. By default the former.

    Returns
    -------
    array (N, 3) or (N, 4) of float64
        Rows x, y, depth[, sigma] for `Scene.complete`, in pixels and metres; sigma is NaN for points without one. A
        `FileWarning` tells what was guessed or left out.
    """
    seeing = camera if camera is None or isinstance(camera, Camera) else Camera.from_file(camera)
    native = None if seeing is None else seeing._native
    return _points(path, _native.read_points(os.fspath(path), as_size(size, "size"), native, _name(unit), kind))


class Colmap(Unpicklable):
    """A sparse model of COLMAP: the folder of `cameras`, `images` and `points3D`, binary or text.

    Depths are in the unit of the model, whose scale images alone do not tell; completion does not need it.

    Parameters
    ----------
    folder : path
    files : dict of bytes, optional
        The contents of these files by name, such as `cameras.bin`, if they are not on a disk; errors name the folder.

    Raises
    ------
    ReadError
        Files that are missing or damaged, an image of an unknown camera.
    """

    _instead = "send the folder, and read the model there"

    def __init__(self, folder: Path, *, files: Mapping[str, bytes] | None = None) -> None:
        self._native = _native.Colmap(os.fspath(folder), None if files is None else dict(files))
        self._folder = folder
        self.images: dict[str, tuple[int, int]] = dict(self._native.images())
        """The names of the images, and their widths and heights in the model."""

    def points(self, name: str, *, size: Size | None = None, exif: int = 1) -> NDArray[np.float64]:
        """The points of the model that an image sees: rows x, y, depth, sigma `(N, 4)` for `Scene.complete`.

        Parameters
        ----------
        name : str
            One of `images`.
        size : (width, height)
            Of the file, if it is not that of the model.
        exif : int from 1 to 8
            How the file is turned to be upright, as it is completed if it is given by its path: Pillow's
            `image.getexif().get(0x0112, 1)`. Models know pixels as they are stored.

        Raises
        ------
        InputError, ReadError
            No image of this name, one of other proportions than in the model, or one that sees no point.
        """
        return _points(name, self._seen(name, size, exif))

    def _seen(self, name: str, size: Size | None, exif: int) -> _Points:
        if exif not in range(1, 9):
            raise InputError(f"`exif` is {exif!r}, not a number from 1 to 8")
        return self._native.points(name, None if size is None else as_size(size, "size"), exif)

    def __repr__(self) -> str:
        return f"<lsdc.Colmap {os.fspath(self._folder)!r}, {len(self.images)} images>"


def _name(unit: FileUnit | None) -> str | None:
    """As the extension module reads it: numbers are steps in a metre."""
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
