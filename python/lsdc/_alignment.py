"""Alignment of points with images."""

from __future__ import annotations

from typing import NamedTuple

from . import _native
from ._pickling import Unpicklable


class Shift(NamedTuple):
    """The shift at which the points fit the images best."""

    u: float
    """To the right, in pixels of the image."""
    v: float
    """Down, in pixels of the image."""
    error: float
    """Mean leave-one-out error of the unshifted points, relative to their depth."""
    error_moved: float
    """The same error of the shifted points."""
    standard_errors: float
    """The gain in log-likelihood, divided by its standard error."""
    frames: int
    """Number of frames with evidence."""
    is_clear: bool
    """Whether chance does not explain it: a gain of 6 standard errors in five frames or more, 9 in fewer; error 5 % lower."""

    def __str__(self) -> str:
        return (
            f"the points fit the image better moved by ({self.u:+.0f}, {self.v:+.0f}) pixels: their leave-one-out error "
            f"falls from {100 * self.error:.1f} to {100 * self.error_moved:.1f} % of the depth"
        )


class Alignment(Unpicklable):
    """Evidence from frames of a shift between points and image, from `Scene.alignment`. `Alignment()` has no evidence; sums
    combine evidence."""

    _instead = "send the completer, the image and the points, and make it there"

    def __init__(self, native: _native.Alignment | None = None) -> None:
        self._native = native

    @property
    def points(self) -> int:
        """Number of points compared in all frames."""
        return 0 if self._native is None else self._native.points

    @property
    def shift(self) -> Shift | None:
        """The best shift, whether it is clear or not; `None` without evidence."""
        found = None if self._native is None else self._native.shift()
        return None if found is None else Shift(*found)

    def __add__(self, other: Alignment) -> Alignment:
        if self._native is None or other._native is None:
            return Alignment(other._native if self._native is None else self._native)
        return Alignment(self._native.with_(other._native))

    def __repr__(self) -> str:
        return f"<lsdc.Alignment of {self.points} points>"
