"""Conversion of arguments of any kind to contiguous arrays of one type.

Contiguous arrays of the right type are used directly, others are copied once.
"""

from __future__ import annotations

import operator
import os
import reprlib
import sys
from collections.abc import Sequence
from typing import Any, Literal, Protocol, Union, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._errors import InputError
from ._warnings import FileWarning, InputWarning, warn


class SupportsDLPack(Protocol):
    """An array of another library that can be exchanged through DLPack: of PyTorch, JAX, CuPy, ..."""

    def __dlpack__(self, *args: Any, **kwargs: Any) -> Any: ...
    def __dlpack_device__(self) -> Any: ...


Array = Union[ArrayLike, SupportsDLPack]
"""Anything that NumPy can look at: arrays, nested lists, tensors on the CPU, images of Pillow."""
ImageLike = Union[Array, "os.PathLike[str]", str]
"""An array `(H, W)`, `(H, W, 3)` or `(H, W, 4)`, an image of Pillow, or the path of an image file."""
Unit = Union[Literal["m", "cm", "mm"], float]
"""Of depths: "m", "cm", "mm", or the metres of one step, such as 1 / 256 for KITTI."""
Noise = Union[Literal["kinect", "realsense", "tof"], "tuple[float, float, float]"]
"""Of a depth camera, by its name, or A, B, C of the standard deviation A + B z + C z^2 in metres at z metres."""
Order = Literal["rgb", "bgr"]
"""Of the colours of a pixel: "bgr" as read by OpenCV."""
Size = tuple[int, int]
"""Width and height, as of an image of Pillow and in OpenCV; the shape of the array is `(height, width)`."""

UNITS = {"m": 1.0, "cm": 100.0, "mm": 1000.0}

# In metres. Larger values were probably meant as steps per metre.
LARGEST_STEP = 100


def as_array(value: Array, what: str) -> NDArray[Any]:
    """Returns `value` as an array of any layout and type, sharing its memory if possible."""
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, (str, bytes, os.PathLike)):
        raise InputError(f"{what} cannot be a {type(value).__name__}", "read the file first: `lsdc.read_depth(path)`")
    try:
        if hasattr(value, "__dlpack__"):
            try:
                return np.from_dlpack(cast(Any, value))
            # Exporters also refuse arrays that NumPy can access in other ways, such as read-only memory.
            except (BufferError, RuntimeError, TypeError, ValueError):
                if not hasattr(value, "__array__"):
                    raise
        found = np.asarray(value)
    except Exception as error:
        hint = "give an array in the memory of the CPU: of a tensor, `tensor.detach().cpu()`"
        raise InputError(f"{what} cannot be read as an array: {error}", hint) from error
    if found.dtype == object:
        raise InputError(f"{what} cannot be read as an array of numbers: {type(value).__name__}")
    return found


def as_image(value: ImageLike, order: Order) -> tuple[NDArray[Any], bool]:
    """Returns colours `(H, W, C)`, 8 bits or floats from 0 to 1, and whether blue comes first."""
    if order not in ("rgb", "bgr"):
        raise InputError(f"`order` is {order!r}", 'orders are "rgb" and "bgr"')
    colours = as_array(_unpacked(value), "the image")
    if colours.ndim == 2:
        colours = colours[:, :, None]
    if colours.ndim != 3 or colours.shape[2] not in (1, 3, 4):
        hint = "give (H, W), (H, W, 3) or (H, W, 4)"
        if colours.ndim == 3 and colours.shape[0] in (1, 3, 4):
            hint = "move the colours last: `image.transpose(1, 2, 0)`"
        raise InputError(f"{_shape(colours)} is not the shape of an image", hint)
    bgr = order == "bgr"
    if colours.shape[2] == 3 and colours.strides[2] == -colours.itemsize:
        # `bgr[..., ::-1]`: in memory order, the array need not be copied.
        colours, bgr = colours[:, :, ::-1], not bgr
    if (colours.dtype.kind, colours.itemsize) == ("u", 2):
        shown = 1 if colours.shape[2] == 1 else 3
        colours, remarks = _native.eight_bits(np.ascontiguousarray(colours[:, :, :shown], dtype=np.uint16))
        warn("the image", remarks, InputWarning)
    elif colours.dtype.kind == "f":
        colours = colours.astype(np.float32, copy=False)
    elif colours.dtype != np.uint8:
        hint = "give 8 or 16 bits unsigned (`image.astype(np.uint8)`), or floats from 0 to 1"
        raise InputError(f"colours of type {colours.dtype} have no known range", hint)
    return np.ascontiguousarray(colours), bgr


def _unpacked(value: ImageLike) -> Array:
    """Returns the image in a file, upright, as the program reads it; converts palettes, CMYK and other modes of Pillow."""
    if isinstance(value, (str, os.PathLike)):
        colours, remarks = _native.read_image(os.fspath(value))
        warn(os.fspath(value), remarks, FileWarning)
        return colours
    pillow: Any = sys.modules.get("PIL.Image")
    if pillow is None or not isinstance(value, pillow.Image):
        return cast(Array, value)
    picture = cast(Any, value)
    known = picture.mode in ("L", "RGB", "RGBA", "I;16")
    return cast(Array, picture if known else picture.convert("RGB"))


def as_outputs(value: Sequence[Array]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Returns basis functions `(functions, H, W)` and affinities `(2, H, W)` of one image, without a batch axis."""
    try:
        first, second = value
    except (TypeError, ValueError):
        what = "`outputs` is not a pair of basis functions and affinities"
        raise InputError(what, 'with ONNX Runtime: `session.run(["basis", "affinities"], {"image": image})`') from None

    def of_one(array: Array, what: str) -> NDArray[np.float32]:
        found = as_array(array, what)
        if found.ndim == 4 and found.shape[0] == 1:
            found = found[0]
        if found.ndim != 3 or found.dtype.kind != "f":
            hint = "give floats (channels, H, W) of one image"
            raise InputError(f"{what} cannot be {_shape(found)} of {found.dtype}", hint)
        return np.ascontiguousarray(found, dtype=np.float32)

    basis, affinities = of_one(first, "basis functions"), of_one(second, "affinities")
    if affinities.shape != (2, *basis.shape[1:]):
        expected = f"{_shape(affinities)} are not the affinities of basis functions {_shape(basis)}"
        raise InputError(expected, "give (2, H, W): of each pixel with its right and its lower neighbour")
    return basis, affinities


def as_guide(value: Array) -> NDArray[np.float32]:
    """Returns the values of a guide `(H, W)`."""
    found = as_array(value, "the guide")
    if found.ndim != 2 or found.dtype.kind not in "fiu":
        raise InputError(f"a guide is a map of numbers (H, W), not {_shape(found)} of {found.dtype}")
    return np.ascontiguousarray(_unmasked(found.astype(np.float32, copy=False), np.nan))


def as_observations(
    sparse: Array | tuple[Array, ...],
    sigma: Array | float | None,
    unit: Unit | None,
    size: Size,
) -> _native.Observations:
    """Returns known depths from a map of the image's shape, a table, or columns."""
    if isinstance(sparse, tuple):
        return _points(_stacked(sparse, unit), sigma, unit)
    given = as_array(sparse, "the sparse depths")
    if given.ndim == 3 and 1 in (given.shape[0], given.shape[2]):
        given = given.squeeze(0 if given.shape[0] == 1 else 2)
    width, height = size
    is_table = given.ndim == 2 and given.shape[1] in (3, 4)
    is_map = given.shape == (height, width) or (not is_table and _same_view(given.shape, (height, width)))
    if is_map and is_table:
        hint = "give columns as a tuple (x, y, depth)"
        raise InputError(f"{_shape(given)} may be a map of the image or a table of points", hint)
    if is_map:
        depths = _metres(_unmasked(given, 0), unit)
        deviations = None if sigma is None else _deviations(sigma, unit, depths.shape)
        return _native.Observations.of_map(depths, deviations, size)
    if is_table:
        return _points(given, sigma, unit)
    hint = "points are rows x, y, depth[, sigma], with x to the right"
    if given.shape == size:
        hint = "rows come first: transpose the map"
    raise InputError(
        f"{_shape(given)} is neither a map of the image of {height} rows and {width} columns nor a table of points",
        hint,
    )


def with_noise(known: _native.Observations, noise: Noise) -> _native.Observations:
    """Returns the depths with the standard deviations of a depth camera at those that have none."""
    return known.with_noise(noise if isinstance(noise, str) else ",".join(map(str, noise)))


def _same_view(map: tuple[int, ...], image: tuple[int, int]) -> bool:
    """Whether a map has the proportions of an image, up to rounding to whole pixels. A map with the same number of only rows
    or only columns was cropped."""
    if len(map) != 2 or 0 in map or map[0] == image[0] or map[1] == image[1]:
        return False
    down, across = image[0] / map[0], image[1] / map[1]
    return abs(across / down - 1) * min(*map, *image) <= 1 + 1e-9


def _stacked(columns: tuple[Array, ...], unit: Unit | None) -> NDArray[np.float64]:
    """Stacks columns into rows."""
    if any(isinstance(column, (list, tuple)) for column in columns):
        raise InputError(
            "a tuple holds columns of points, as arrays", "give rows as a list or an array (N, 3)"
        )
    found = [as_array(column, "a column of the points") for column in columns]
    lengths = {column.shape for column in found}
    if len(found) not in (3, 4) or len(lengths) != 1 or found[0].ndim != 1:
        shapes = ", ".join(_shape(column) for column in found)
        raise InputError(f"columns of points are x, y, depth and possibly sigma, all (N,), not {shapes}")
    if found[2].dtype.kind in "iu" and unit is None:
        raise _unknown_unit()
    return np.stack([_numbers(column, "a column of the points") for column in found], axis=-1)


def _unknown_unit() -> InputError:
    return InputError("depths that are integers have no unit of their own", 'give `unit="mm"`, for example')


def _points(table: NDArray[Any], sigma: Array | float | None, unit: Unit | None) -> _native.Observations:
    """Reads rows x, y, depth and optionally sigma."""
    if table.ndim != 2 or table.shape[1] not in (3, 4):
        raise InputError(f"points have x, y, depth and possibly sigma, not {_shape(table)}")
    if table.dtype.kind in "iu" and unit is None:
        raise _unknown_unit()
    rows = np.array(_unmasked(_numbers(table, "the points"), np.nan), order="C")
    factor = per_metre(unit)
    rows[:, 2:] /= factor
    deviations: NDArray[np.float32] | None = None
    if rows.shape[1] == 4:
        if sigma is not None:
            raise InputError("the points have a column of standard deviations, and `sigma` is given too")
        deviations = rows[:, 3].astype(np.float32)
    elif sigma is not None:
        deviations = _deviations(sigma, unit, rows.shape[:1])
    return _native.Observations.of_table(np.ascontiguousarray(rows[:, :3]), deviations)


def _numbers(values: NDArray[Any], what: str) -> NDArray[np.float64]:
    if values.dtype.kind not in "fiu":
        raise InputError(f"{what} has values of type {values.dtype}, not numbers")
    return values.astype(np.float64, copy=False)


def _deviations(sigma: Array | float, unit: Unit | None, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Returns one standard deviation for each value of an array of this shape; a single number applies to all."""
    given = as_array(sigma, "`sigma`")
    if given.shape not in ((), shape):
        raise InputError(f"`sigma` has the shape {_shape(given)}, but depths have {shape}")
    scaled = _numbers(given, "`sigma`") / per_metre(unit)
    if given.shape == () and not (np.isfinite(scaled) and scaled > 0):
        raise InputError(f"`sigma` is {given}, not a positive number")
    return np.ascontiguousarray(np.broadcast_to(scaled, shape), dtype=np.float32)


def _metres(values: NDArray[Any], unit: Unit | None) -> NDArray[np.float32]:
    """Converts a depth map to metres; floats without a unit are in metres."""
    if values.dtype.kind in "iu" and unit is None:
        raise _unknown_unit()
    if values.dtype.kind not in "fiu":
        raise InputError(f"the sparse depths have values of type {values.dtype}, not numbers")
    factor = per_metre(unit)
    with np.errstate(over="ignore"):
        stored = np.ascontiguousarray(values, dtype=np.float32)
        bits = (8 * values.itemsize, values.dtype.kind == "i") if values.dtype.kind in "iu" else None
        known, remarks = _native.without_marks(stored, bits, 1 / factor)
        warn("the sparse depths", remarks, InputWarning)
        if factor != 1.0:
            values = np.where(np.isnan(known), np.nan, values / np.float64(factor))
            known = np.ascontiguousarray(values, dtype=np.float32)
    return known


def per_metre(unit: Unit | None) -> float:
    """Returns the steps of a unit per metre."""
    if unit is None:
        return 1.0
    if isinstance(unit, str):
        if unit in UNITS:
            return UNITS[unit]
    elif 0 < unit < LARGEST_STEP:
        return 1.0 / float(unit)
    raise InputError(
        f"{unit!r} is not a unit", 'give "m", "cm", "mm", or the metres of one step: 1 / 256, not 256'
    )


def as_positions(value: Array, columns: int = 2) -> NDArray[np.float64]:
    """Rows of coordinates."""
    found = as_array(value, "the positions")
    if found.ndim == 1 and found.shape == (columns,):
        found = found[None]
    if found.ndim != 2 or found.shape[1] != columns:
        raise InputError(f"positions are rows of {columns} numbers, not {_shape(found)}")
    return np.ascontiguousarray(_numbers(found, "the positions"))


def as_size(value: Size, what: str) -> Size:
    """Width and height."""
    try:
        width, height = (operator.index(side) for side in value)
    except (TypeError, ValueError):
        raise InputError(f"`{what}` is {reprlib.repr(value)}, not (width, height) in whole pixels") from None
    if width < 1 or height < 1:
        raise InputError(f"`{what}` is {width}x{height}")
    return width, height


def as_count(value: int, what: str) -> int:
    """A whole number, 0 or above."""
    try:
        count = operator.index(value)
    except TypeError:
        count = -1
    if count < 0:
        raise InputError(f"`{what}` is {reprlib.repr(value)}, not a whole number from 0")
    return count


def _unmasked(values: NDArray[Any], missing: float) -> NDArray[Any]:
    """Replaces masked values by missing ones."""
    masked = isinstance(values, np.ma.MaskedArray)
    return cast("NDArray[Any]", cast(Any, values).filled(missing)) if masked else values


def _shape(values: NDArray[Any]) -> str:
    return str(values.shape)
