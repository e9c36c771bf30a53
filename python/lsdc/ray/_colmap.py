"""Sparse models of COLMAP (Schönberger and Frahm 2016), text and binary: what every image sees, at the depths that the
model gives. The points, their standard deviations and what is left out are those of the program."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .._errors import FitError, InputError, ReadError
from .._input import Size
from ._place import Place

Floats = NDArray[np.float64]
T = TypeVar("T")

# Names and numbers of parameters, in the order of the models' numbers (`src/colmap/sensor/models.h`).
CAMERAS = (
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
)
TWO_FOCAL_LENGTHS = ("PINHOLE", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV")

# Reprojection errors below this, in pixels, are luck: no corner is found more exactly.
LEAST_ERROR = 0.3
# A point is hidden if a surface in its pixel is nearer by this share of its depth, and by so many deviations.
NEARER, SURE = np.float32(0.05), np.float32(3.0)


@dataclass(frozen=True)
class View:
    """An image of a model, and the points that it sees."""

    name: str
    """The path of the image below the folder of images."""
    size: Size
    """Width and height in the model."""
    keypoints: Floats
    """Rows x, y, depth, sigma, from the centre of the first pixel as it is stored, in the unit of the model."""

    def points(self, stored: Size, exif: int = 1) -> Floats:
        """Rows x, y, depth, sigma in the upright image, whose file has these columns and rows, and this orientation by
        EXIF.

        Raises
        ------
        InputError, FitError
            An image of other proportions than those in the model; no point in the image.
        """
        upright = stored if exif < 5 else (stored[1], stored[0])
        as_stored = _same_shape(self.size, stored)
        if not as_stored and not _same_shape(self.size, upright):
            (width, height), (across, down) = self.size, stored
            what = f"`{self.name}` is {width}x{height} in the model, but the image is {across}x{down}"
            raise InputError(
                what, "give the images that the model was made of, neither cut nor undistorted"
            )
        shown = stored if as_stored else upright
        rows = self.keypoints.astype(np.float64)
        rows[:, :2] = (rows[:, :2] + 0.5) * (np.array(shown) / np.array(self.size)) - 0.5
        if as_stored:
            rows[:, :2] = _turned(rows[:, :2], upright, exif)
        kept = _visible(rows, upright)
        if not len(kept):
            raise FitError(f"none of the {len(rows)} points of `{self.name}` lies in the image")
        return kept


@dataclass(frozen=True)
class _Camera:
    size: Size
    focal: float


@dataclass(frozen=True)
class _Pose:
    rotation: tuple[float, ...]
    translation: tuple[float, ...]
    camera: int
    name: str
    keypoints: Floats
    """Rows x, y, as stored: the centre of the first pixel is 0.5."""
    seen: NDArray[np.int64]
    """Their points."""


@dataclass(frozen=True)
class _Landmarks:
    number: NDArray[np.int64]
    """Sorted."""
    place: Floats
    error: Floats
    track: Floats


class Model:
    """A sparse model: the folder that holds `cameras`, `images` and `points3D`, `.bin` or `.txt`.

    Raises
    ------
    ReadError
        Files that are missing or damaged, an image of an unknown camera.
    """

    def __init__(self, place: Place) -> None:
        cameras = _part(place, "cameras", _binary_cameras, _text_cameras)
        poses = _part(place, "images", _binary_poses, _text_poses)
        landmarks = _part(place, "points3D", _binary_landmarks, _text_landmarks)
        self.views: dict[str, View] = {}
        for pose in sorted(poses, key=lambda pose: pose.name):
            if pose.camera not in cameras:
                raise ReadError(f"image `{pose.name}` has no camera {pose.camera} in `{place}`")
            self.views[pose.name] = _view(pose, cameras[pose.camera], landmarks)

    @staticmethod
    def is_at(place: Place) -> bool:
        return any(place.is_file(f"cameras.{ending}") for ending in ("bin", "txt"))


def _view(pose: _Pose, camera: _Camera, landmarks: _Landmarks) -> View:
    where = np.minimum(np.searchsorted(landmarks.number, pose.seen), max(len(landmarks.number) - 1, 0))
    known = landmarks.number[where] == pose.seen if len(landmarks.number) else np.zeros(len(pose.seen), bool)
    where, rows = where[known], pose.keypoints[known] - 0.5
    # The third row of the rotation of a unit quaternion.
    w, x, y, z = np.array(pose.rotation) / max(float(np.sqrt(np.square(pose.rotation).sum())), 1e-300)
    axis = (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    place = landmarks.place[where]
    # Summed as in the program.
    depth = axis[0] * place[:, 0] + axis[1] * place[:, 1] + axis[2] * place[:, 2] + pose.translation[2]
    error = np.maximum(landmarks.error[where], LEAST_ERROR)
    track = np.maximum(landmarks.track[where], 2.0)
    # A reprojection error of so many pixels, seen from the distance, averaged over the images that see the point.
    sigma = depth * error / (max(camera.focal, 1.0) * np.sqrt(track - 1.0))
    before = (depth > 0) & np.isfinite(depth)
    return View(pose.name, camera.size, np.column_stack([rows, depth, sigma])[before])


def _same_shape(a: Size, b: Size) -> bool:
    """But for the rounding to whole pixels."""
    across, down = b[0] / a[0], b[1] / a[1]
    return abs(across / down - 1.0) * min(*a, *b) <= 1.0 + 1e-9


def _turned(places: Floats, upright: Size, exif: int) -> Floats:
    """Where places of the image as stored are in the upright image (EXIF 2.32, tag 0x0112)."""
    places = places[:, ::-1].copy() if exif >= 5 else places.copy()
    if exif in (2, 3, 6, 7):
        places[:, 0] = upright[0] - 1.0 - places[:, 0]
    if exif in (3, 4, 7, 8):
        places[:, 1] = upright[1] - 1.0 - places[:, 1]
    return places


def _visible(rows: Floats, size: Size) -> Floats:
    """Without points outside the image, without a usable depth or deviation, and behind a nearer surface in the same
    pixel."""
    with np.errstate(over="ignore", under="ignore"):
        depth, sigma = rows[:, 2].astype(np.float32), rows[:, 3].astype(np.float32)
    pixels = np.floor(rows[:, :2] + 0.5)
    sound = (depth > 0) & np.isfinite(depth) & (sigma > 0) & np.isfinite(sigma)
    inside = (pixels >= 0).all(axis=1) & (pixels < size).all(axis=1) & sound
    rows, depth, sigma, pixels = rows[inside], depth[inside], sigma[inside], pixels[inside].astype(np.int64)
    _, pixel = np.unique(pixels[:, 1] * size[0] + pixels[:, 0], return_inverse=True)
    front = np.full(len(rows), np.float32(np.inf))
    np.minimum.at(front, pixel, depth + SURE * sigma)
    behind = depth * (np.float32(1) - NEARER) - SURE * sigma > front[pixel]
    return rows[~behind]


def _part(place: Place, name: str, binary: Callable[[_Bytes], T], text: Callable[[list[str]], T]) -> T:
    for ending in ("bin", "txt"):
        file = f"{name}.{ending}"
        if not place.is_file(file):
            continue
        data = place.read(file)
        try:
            return binary(_Bytes(data)) if ending == "bin" else text(data.decode().splitlines())
        except (ValueError, IndexError, struct.error, OverflowError) as error:
            hint = "export the model again (`colmap model_converter`)"
            raise ReadError(f"`{place}/{file}` is damaged: {error}", hint) from error
    hint = "a sparse model of COLMAP is a folder such as sparse/0"
    raise ReadError(f"`{place}` holds no {name}.bin or {name}.txt", hint)


def _camera(model: str, size: Size, parameters: tuple[float, ...]) -> _Camera:
    expected = dict(CAMERAS).get(model)
    if expected is not None and expected != len(parameters):
        raise ValueError(f"a camera {model} has {len(parameters)} parameters, expected {expected}")
    focal = parameters[: 2 if model in TWO_FOCAL_LENGTHS else 1]
    if not all(value > 0 and np.isfinite(value) for value in focal) or not focal or min(size) < 1:
        raise ValueError(f"a camera {model} has no focal length or no pixels")
    return _Camera(size, sum(focal) / len(focal))


class _Bytes:
    """A file in binary form: little-endian, as COLMAP's `reconstruction_io` writes it."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def take(self, form: str) -> tuple[Any, ...]:
        values = struct.unpack_from(f"<{form}", self._data, self._at)
        self._at += struct.calcsize(f"<{form}")
        return values

    def count(self, size: int) -> int:
        """A number of things of so many bytes at least, which must be there."""
        (count,) = self.take("Q")
        left = (len(self._data) - self._at) // size
        if count > left:
            raise ValueError(f"it promises {count} entries where {left} have room")
        return int(count)

    def name(self) -> str:
        end = self._data.index(b"\0", self._at)
        name = self._data[self._at : end].decode(errors="replace")
        self._at = end + 1
        return name

    def table(self, form: str, count: int) -> NDArray[Any]:
        kind = np.dtype(form)
        values = np.frombuffer(self._data, kind, count, self._at)
        self._at += kind.itemsize * count
        return values

    def skip(self, count: int) -> None:
        self._at += count


def _binary_cameras(data: _Bytes) -> dict[int, _Camera]:
    cameras: dict[int, _Camera] = {}
    for _ in range(data.count(24)):
        number, model, width, height = data.take("IIQQ")
        if model >= len(CAMERAS):
            raise ValueError(f"camera {number} is of an unknown model, {model}")
        name, count = CAMERAS[model]
        cameras[number] = _camera(name, (width, height), data.take(f"{count}d"))
    return cameras


def _binary_poses(data: _Bytes) -> list[_Pose]:
    poses: list[_Pose] = []
    for _ in range(data.count(73)):
        _, *numbers = data.take("I7d")
        (camera,) = data.take("I")
        name = data.name()
        table = data.table("<f8,<f8,<i8", data.count(24))
        # -1 where a keypoint has no point.
        table = table[table["f2"] >= 0]
        places = np.column_stack([table["f0"], table["f1"]])
        poses.append(_Pose(tuple(numbers[:4]), tuple(numbers[4:]), camera, name, places, table["f2"]))
    return poses


def _binary_landmarks(data: _Bytes) -> _Landmarks:
    def rows() -> Iterator[tuple[float, ...]]:
        for _ in range(data.count(51)):
            number, *place, _, _, _, error = data.take("Q3d3Bd")
            track = data.count(8)
            data.skip(8 * track)
            yield number, *place, error, track

    return _landmarks(rows())


def _landmarks(rows: Iterator[tuple[float, ...]]) -> _Landmarks:
    found = {int(number): others for number, *others in rows}
    numbers = np.array(sorted(found), np.int64)
    table = np.array([found[number] for number in numbers.tolist()], np.float64).reshape(-1, 5)
    return _Landmarks(numbers, table[:, :3], table[:, 3], table[:, 4])


def _lines(lines: list[str]) -> Iterator[str]:
    return (line for line in lines if not line.startswith("#"))


def _text_cameras(lines: list[str]) -> dict[int, _Camera]:
    cameras: dict[int, _Camera] = {}
    for line in filter(str.strip, _lines(lines)):
        number, model, width, height, *parameters = line.split()
        cameras[int(number)] = _camera(model, (int(width), int(height)), tuple(map(float, parameters)))
    return cameras


def _text_poses(lines: list[str]) -> list[_Pose]:
    """Two lines to an image, of which the second may be empty."""
    poses: list[_Pose] = []
    left = _lines(lines)
    for line in left:
        if not line.strip():
            continue
        # Names may have blanks.
        *numbers, camera, name = line.strip().split(maxsplit=9)[1:]
        pose = tuple(map(float, numbers))
        fields = next(left, "").split()
        if len(fields) % 3:
            raise ValueError(f"the observations of `{name}` are cut off")
        places = np.array([fields[0::3], fields[1::3]], np.float64).T
        seen = np.array(list(map(int, fields[2::3])), np.int64)
        poses.append(_Pose(pose[:4], pose[4:], int(camera), name, places[seen >= 0], seen[seen >= 0]))
    return poses


def _text_landmarks(lines: list[str]) -> _Landmarks:
    def rows() -> Iterator[tuple[float, ...]]:
        for line in filter(str.strip, _lines(lines)):
            number, x, y, z, _, _, _, error, *track = line.split()
            yield int(number), float(x), float(y), float(z), float(error), len(track) // 2

    return _landmarks(rows())
