"""WebDataset tars: the members of a frame are consecutive and share their name up to the first dot."""

from __future__ import annotations

import tarfile
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from .._errors import InputError, ReadError
from ._frame import Frame, Inputs, as_depths, as_picture
from ._place import Place

# Endings of members, in order of preference.
FIELDS: dict[str, tuple[str, ...]] = {
    "image": ("jpg", "jpeg", "png", "webp", "image.png", "rgb.png"),
    "sparse": ("sparse.npy", "sparse.png", "depth.npy", "depth.png", "npy"),
    "sigma": ("sigma.npy",),
    "guide": ("guide.npy",),
}


class Tars:
    def __init__(self, place: Place, files: Sequence[str], columns: Mapping[str, str]) -> None:
        if unknown := set(columns) - set(FIELDS):
            raise InputError(f"`{min(unknown)}` is no part of a frame", f"parts are {', '.join(FIELDS)}")
        self._place, self._files = place, list(files)
        self._fields = FIELDS | {name: (ending,) for name, ending in columns.items()}

    def files(self) -> Sequence[str]:
        return self._files

    def index(self, file: str) -> list[tuple[str, int]]:
        """Lists keys and the offsets of their first members; reads only the headers."""
        entries: list[tuple[str, int]] = []
        with self._place.open(file) as stream:
            try:
                with tarfile.open(fileobj=stream, mode="r:") as tar:
                    for member in tar:
                        key = _key(member)
                        if key is not None and (not entries or entries[-1][0] != key):
                            entries.append((key, member.offset))
            except tarfile.TarError as error:
                raise ReadError(f"`{self._place}/{file}` is no sound tar: {error}") from error
        return entries

    def reference(self, file: str, entries: Sequence[tuple[str, int]]) -> Any:
        return [file, entries[0][1], len(entries)]

    def frames(self, reference: Any) -> Iterator[Frame]:
        file, start, count = reference
        with self._place.open(file) as stream:
            stream.seek(start)
            members: dict[str, bytes] = {}
            last: str | None = None
            with tarfile.open(fileobj=stream, mode="r|") as tar:
                for member in tar:
                    key = _key(member)
                    if key is None:
                        continue
                    if last is not None and key != last:
                        yield self._frame(last, members)
                        count -= 1
                        members = {}
                    if not count:
                        return
                    last = key
                    content = tar.extractfile(member)
                    if content is not None:
                        members[_ending(member.name)] = content.read()
            if last is not None:
                yield self._frame(last, members)

    def _frame(self, key: str, members: dict[str, bytes]) -> Frame:
        def part(name: str) -> bytes | None:
            return next((members[ending] for ending in self._fields[name] if ending in members), None)

        def decode() -> Inputs:
            image, sparse = part("image"), part("sparse")
            if image is None or sparse is None:
                what = "image" if image is None else "sparse depths"
                hint = "`--column` says under which ending"
                raise ReadError(f"it has no {what}, only {', '.join(sorted(members))}", hint)
            others = [as_depths(value) if (value := part(name)) else None for name in ("sigma", "guide")]
            return Inputs(as_picture(image), as_depths(sparse), *others)

        return Frame(key, decode)


def _key(member: tarfile.TarInfo) -> str | None:
    """Returns the key of a member; None if it belongs to no frame."""
    folder, slash, name = member.name.rpartition("/")
    if not member.isfile() or name.startswith((".", "__")):
        return None
    return folder + slash + name.split(".", 1)[0]


def _ending(name: str) -> str:
    return name.rpartition("/")[2].partition(".")[2].lower()
