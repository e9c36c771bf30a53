"""What became of the points of other views."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class ViewsReport:
    """What became of the points of other views."""

    outcome: Literal["used", "rejected", "no points", "too few points of its own"]
    """"rejected" if the image's own points are not predicted clearly better with them."""
    considered: int
    """Other views."""
    used: int
    """Views whose points were carried over."""
    inconsistent: int
    """Views that contradict the image's own points, as with a wrong pose."""
    carried: int
    """Points that joined the fit."""
    occluded: int
    """Points behind the surface that the image sees."""
    contradicting: int
    """Points in front of it: something moved, or the pose is wrong."""
    doubled: int
    """Points that the image, or a closer view, measured too."""
    thinned: int
    """Points left out because there are many."""
    errors: tuple[float, float] | None
    """The mean relative leave-one-out error of the image's own points, without and with the others."""
