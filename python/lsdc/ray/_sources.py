"""Sources of frames.

A source names its files, lists the frames of a file (`index`, which reads as little as possible), and fetches the frames
of a reference (`frames`) on any machine. References are small, self-contained JSON.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, Protocol

from .._errors import InputError, ReadError
from .._files import Colmap
from ._frame import Frame, Inputs, as_depths, as_picture
from ._place import Place
from ._tables import Tables
from ._tars import Tars

IMAGES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp", ".ppm", ".pgm")
MODEL = ("cameras", "images", "points3D", "rigs", "frames")
MAPS = (".npy", ".png", ".pgm", ".tif", ".tiff")

Entry = tuple[str, Any]
"""The key of a frame, and where it is in its file, as JSON."""


class Source(Protocol):
    def files(self) -> Sequence[str]: ...
    def index(self, file: str) -> list[Entry]:
        """Lists the frames of a file, always in the same order."""
        ...

    def reference(self, file: str, entries: Sequence[Entry]) -> Any:
        """Returns the reference of consecutive frames of a file."""
        ...

    def frames(self, reference: Any) -> Iterator[Frame]:
        """Fetches frames, one after the other. Damage is detected when a frame is decoded; a store that does not answer
        raises OSError here."""
        ...


def opened(address: str, sparse: str | None, columns: Mapping[str, str]) -> Source:
    """Opens the source at an address: WebDataset tars, Parquet, or images with depths in the folder `sparse`, which may also
    be a COLMAP model. For a folder that contains `images` and `sparse`, `sparse` is not needed.

    Raises
    ------
    ReadError, InputError
        There is no source of these kinds.
    """
    place = Place(address)
    names = [""] if place.is_file() else place.files()
    if not names:
        raise ReadError(f"there are no files in `{place}`")
    for ending, source in ((".tar", Tars), (".parquet", Tables)):
        chosen = [name for name in names if (name or place.name).lower().endswith(ending)]
        if chosen and sparse is None:
            return source(place, chosen, columns)
    if columns:
        raise InputError("only tars and Parquet have columns", "leave `--column` out")
    depths = Place(sparse or "")
    if sparse is None:
        if not any(name.startswith("images/") for name in names):
            hint = "give tars, Parquet, a folder with `images` and `sparse` in it, or `--sparse FOLDER`"
            raise InputError(f"`{place}` says nothing of depths", hint)
        place, depths = place.child("images"), place.child("sparse")
    for model in (depths, depths.child("0")):
        if Models.is_at(model):
            return Models(place, model)
    return Folder(place, depths)


class Folder:
    """Images, and depth maps with the same names and another ending: npy, or 16-bit images."""

    def __init__(self, images: Place, maps: Place) -> None:
        self._images, self._maps = images, maps

    def files(self) -> Sequence[str]:
        return [""]

    def index(self, file: str) -> list[Entry]:
        maps: dict[str, str] = {}
        for name in self._maps.files():
            stem, ending = _split(name)
            if ending in MAPS:
                if stem in maps:
                    raise InputError(f"`{maps[stem]}` and `{name}` in `{self._maps}` are depths of one image")
                maps[stem] = name
        names = ((name, *_split(name)) for name in self._images.files())
        entries = [(stem, [name, maps.get(stem)]) for name, stem, ending in names if ending in IMAGES]
        if not any(found for _, (_, found) in entries):
            raise InputError(f"no map in `{self._maps}` is called as an image in `{self._images}`")
        return entries

    def reference(self, file: str, entries: Sequence[Entry]) -> Any:
        return list(entries)

    def frames(self, reference: Any) -> Iterator[Frame]:
        for key, (image, depths) in reference:
            yield _of_files(key, self._images, image, self._maps, depths)


def _of_files(key: str, images: Place, image: str, maps: Place, depths: str | None) -> Frame:
    found = [_fetched(images, image), None if depths is None else _fetched(maps, depths)]

    def decode() -> Inputs:
        if depths is None:
            raise ReadError(f"`{maps}` has no depths for it")
        for data in found:
            if isinstance(data, ReadError):
                raise data
        return Inputs(as_picture(found[0]), as_depths(found[1]))

    return Frame(key, decode)


def _fetched(place: Place, name: str) -> bytes | ReadError:
    try:
        return place.read(name)
    except ReadError as missing:
        return missing


class Models:
    """Images, and the points that they see in a COLMAP model, which every worker reads when it begins."""

    def __init__(self, images: Place, model: Place) -> None:
        self._images, self._place = images, model

    def __reduce__(self) -> tuple[Any, ...]:
        return Models, (self._images, self._place)

    @staticmethod
    def is_at(place: Place) -> bool:
        return any(place.is_file(f"cameras.{ending}") for ending in ("bin", "txt"))

    @cached_property
    def _model(self) -> Colmap:
        names = [f"{part}.{ending}" for part in MODEL for ending in ("bin", "txt")]
        files = {name: self._place.read(name) for name in names if self._place.is_file(name)}
        return Colmap(str(self._place), files=files)

    def files(self) -> Sequence[str]:
        return [""]

    def index(self, file: str) -> list[Entry]:
        return [(_split(name)[0], name) for name in self._model.images]

    def reference(self, file: str, entries: Sequence[Entry]) -> Any:
        return list(entries)

    def frames(self, reference: Any) -> Iterator[Frame]:
        for key, name in reference:
            yield self._frame(key, name, _fetched(self._images, name))

    def _frame(self, key: str, name: str, data: bytes | ReadError) -> Frame:
        def decode() -> Inputs:
            from PIL import Image

            if isinstance(data, ReadError):
                raise data
            with Image.open(io.BytesIO(data)) as image:
                size, exif = image.size, image.getexif().get(0x0112, 1)
            points, counts, _ = self._model._seen(name, size, exif if exif in range(1, 9) else 1)
            left_out: dict[str, int] = dict(zip(("unusable", "outside", "hidden"), counts, strict=True))
            return Inputs(as_picture(data), points, left_out=left_out)

        return Frame(key, decode)


def _split(name: str) -> tuple[str, str]:
    """Returns a name without its ending, and the ending in lower case."""
    stem, dot, ending = name.rpartition(".")
    return (stem, f".{ending.lower()}") if dot and "/" not in ending else (name, "")
