"""Folders on a disk or an object store that every machine can open by address."""

from __future__ import annotations

import os
import re
import uuid
from functools import cached_property
from typing import Any

import pyarrow as pa
import pyarrow.fs as pafs

from .._errors import ReadError, SettingsError

SCRATCH = "tmp"
"""The folder of files that are being written, and of notes on what is being made."""


class Place:
    """A folder or a file: a path, `s3://bucket/folder`, `gs://...`, or any other address that pyarrow or fsspec supports.
    Only the address is pickled; the connection is opened on first use."""

    def __init__(self, address: str) -> None:
        self.address = address

    def __reduce__(self) -> tuple[type[Place], tuple[str]]:
        return Place, (self.address,)

    def __repr__(self) -> str:
        """The address without logins and options."""
        return re.sub("//[^/@]*@", "//", self.address.partition("?")[0])

    def child(self, name: str) -> Place:
        """Returns a subfolder."""
        path, question, options = self.address.partition("?")
        return Place(f"{path.rstrip('/')}/{name}{question}{options}")

    @property
    def name(self) -> str:
        """The last part of the path."""
        return self._opened[1].rpartition("/")[2]

    @cached_property
    def _opened(self) -> tuple[Any, str]:
        """The file system, and the path in it."""
        if "://" not in self.address:
            return pafs.LocalFileSystem(), os.path.abspath(self.address)
        try:
            system, path = pafs.FileSystem.from_uri(self.address)
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
            system, path = _by_fsspec(self.address)
        return system, path.rstrip("/")

    @property
    def _is_local(self) -> bool:
        return isinstance(self._opened[0], pafs.LocalFileSystem)

    def _at(self, name: str) -> str:
        path = self._opened[1]
        return f"{path}/{name}" if name else path

    def _info(self, name: str) -> Any:
        return self._opened[0].get_file_info(self._at(name))

    def is_file(self, name: str = "") -> bool:
        return bool(self._info(name).type == pafs.FileType.File)

    def is_folder(self, name: str = "") -> bool:
        return bool(self._info(name).type == pafs.FileType.Directory)

    def files(self, name: str = "") -> list[str]:
        """Returns the files below a folder, sorted, relative to this place; none if there is no such folder. Files whose name
        begins with a dot are left out."""
        system, path = self._opened
        selector = pafs.FileSelector(self._at(name), recursive=True, allow_not_found=True)
        found = (info.path for info in system.get_file_info(selector) if info.type == pafs.FileType.File)
        below = (os.path.relpath(file, path).replace(os.sep, "/") for file in found)
        return sorted(file for file in below if not any(part.startswith(".") for part in file.split("/")))

    def open(self, name: str = "") -> Any:
        """Opens a file for reading at any position."""
        try:
            return self._opened[0].open_input_file(self._at(name))
        except FileNotFoundError:
            raise ReadError(f"there is no `{self._at(name)}`") from None

    def read(self, name: str = "") -> bytes:
        with self.open(name) as file:
            return bytes(file.read())

    def write(self, name: str, data: bytes) -> None:
        """Writes a file atomically: on a disk, under a temporary name first; in a store, objects appear only when they are
        complete."""
        system, path = self._opened
        if not self._is_local:
            with system.open_output_stream(self._at(name)) as stream:
                stream.write(data)
            return
        target = self._at(name)
        scratch = os.path.join(path, SCRATCH)
        for folder in (scratch, os.path.dirname(target)):
            os.makedirs(folder, exist_ok=True)
        temporary = os.path.join(scratch, f"{os.path.basename(target)}.{uuid.uuid4().hex}")
        with open(temporary, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
        _sync_folder(os.path.dirname(target))

    def clean(self) -> None:
        """Removes incomplete files and records of attempts."""
        if self.is_folder(SCRATCH):
            self._opened[0].delete_dir(self._at(SCRATCH))


def _sync_folder(folder: str) -> None:
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _by_fsspec(address: str) -> tuple[Any, str]:
    try:
        import fsspec

        system, path = fsspec.core.url_to_fs(address)
    except (ImportError, ValueError) as error:
        hint = "give a path, s3://..., gs://..., or install the file system of fsspec for it"
        raise SettingsError(f"`{Place(address)}` cannot be opened: {error}", hint) from error
    return pafs.PyFileSystem(pafs.FSSpecHandler(system)), path
