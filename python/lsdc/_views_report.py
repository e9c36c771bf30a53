"""Report on the points of other views."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class ViewsReport:
    """Report on the points of other views."""

    outcome: Literal["used", "rejected", "no points", "too few points of its own"]
    """"rejected" if they do not clearly improve the predictions of the image's own points."""
    considered: int
    """Number of other views."""
    used: int
    """Number of views whose points were transferred."""
    inconsistent: int
    """Number of views that contradict the image's own points, as with a wrong pose."""
    carried: int
    """Number of points added to the fit."""
    occluded: int
    """Number of points behind the surface that the image sees."""
    contradicting: int
    """Number of points in front of it: something moved, or the pose is wrong."""
    doubled: int
    """Number of points that the image, or a closer view, measured as well."""
    thinned: int
    """Number of points left out because there are too many."""
    errors: tuple[float, float] | None
    """Mean relative leave-one-out error of the image's own points, without and with the others."""
