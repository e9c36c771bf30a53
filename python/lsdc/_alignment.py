"""Whether points lie where the images show them."""

from __future__ import annotations

from typing import NamedTuple

from . import _native
from ._pickling import Unpicklable


class Shift(NamedTuple):
    """The shift of the points at which they fit the images best."""

    u: float
    """To the right, in pixels of the image."""
    v: float
    """Down, in pixels of the image."""
    error: float
    """Mean leave-one-out error of the points where they are, over their depth."""
    error_moved: float
    """The same of the moved points."""
    standard_errors: float
    """The gain in log-likelihood over its standard error."""
    frames: int
    """Frames that this is the evidence of."""
    is_clear: bool
    """Whether chance does not explain it: 6 standard errors in five frames or more, 9 in fewer, and 5 % of the error."""

    def __str__(self) -> str:
        return (
            f"the points fit the image better moved by ({self.u:+.0f}, {self.v:+.0f}) pixels: their leave-one-out error "
            f"falls from {100 * self.error:.1f} to {100 * self.error_moved:.1f} % of the depth"
        )


class Alignment(Unpicklable):
    """The evidence of frames for a shift between points and image, made by `Scene.alignment`; `Alignment()` is none.
    The sum of two is the evidence of both."""

    _instead = "send the completer, the image and the points, and make it there"

    def __init__(self, native: _native.Alignment | None = None) -> None:
        self._native = native

    @property
    def points(self) -> int:
        """The number of points that were compared, over all frames."""
        return 0 if self._native is None else self._native.points

    @property
    def shift(self) -> Shift | None:
        """The best of the shifts, clear or not; `None` without evidence."""
        found = None if self._native is None else self._native.shift()
        return None if found is None else Shift(*found)

    def __add__(self, other: Alignment) -> Alignment:
        if self._native is None or other._native is None:
            return Alignment(other._native if self._native is None else self._native)
        return Alignment(self._native.with_(other._native))

    def __repr__(self) -> str:
        return f"<lsdc.Alignment of {self.points} points>"
