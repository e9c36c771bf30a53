"""Objects that cannot be pickled, with a hint at what to send instead."""

from __future__ import annotations

from typing import Any, ClassVar, NoReturn, TypeVar

from ._errors import Error



class PicklingError(Error, TypeError):
    """The error that `pickle` raises, as an error of this package."""


Own = TypeVar("Own", bound="Unpicklable")


class Unpicklable:
    """An object that refuses to be pickled, with a hint. It is immutable, so copies are the object itself."""

    _instead: ClassVar[str]

    def __reduce__(self) -> NoReturn:
        raise PicklingError(f"a {type(self).__name__} cannot be pickled: it belongs to this process", self._instead)

    def __copy__(self: Own) -> Own:
        return self

    def __deepcopy__(self: Own, memo: dict[int, Any]) -> Own:
        return self
