"""What cannot leave its process says so, and what to send instead."""

from __future__ import annotations

from typing import Any, ClassVar, NoReturn, TypeVar

from ._errors import Error



class PicklingError(Error, TypeError):
    """What `pickle` raises, as an error of this package."""


Own = TypeVar("Own", bound="Unpicklable")


class Unpicklable:
    """An object that refuses to be pickled with advice. Nothing of it changes, so that it is its own copy."""

    _instead: ClassVar[str]

    def __reduce__(self) -> NoReturn:
        raise PicklingError(f"a {type(self).__name__} cannot be pickled: it belongs to this process", self._instead)

    def __copy__(self: Own) -> Own:
        return self

    def __deepcopy__(self: Own, memo: dict[int, Any]) -> Own:
        return self
