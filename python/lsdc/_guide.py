"""A dense depth prediction from another source."""

from __future__ import annotations

from typing import Literal

from . import _native
from ._input import Array, as_guide
from ._pickling import Unpicklable

GuideKind = Literal["depth", "disparity", "log"]


class DepthGuide(Unpicklable):
    """A dense depth prediction for an image, from any other network or program.

    It may have any size, and its unit, scale and shift need not be known: the fit estimates them, and from the points also
    the trust in the guide (`report["guide_trust"]`).

    Parameters
    ----------
    values : array (H, W)
        NaN at pixels without a prediction; for depths, also 0.
    kind : "depth", "disparity" or "log"
        Quantity of the values, up to scale and shift: depths; inverse depths (larger is nearer), as from MiDaS and
        Depth Anything; or logarithms of depths.

    >>> import numpy as np
    >>> guide = lsdc.DepthGuide(np.array([[0.9, 0.8], [np.nan, 0.4]]), kind="disparity")
    >>> guide.size, guide.missing
    ((2, 2), 1)
    """

    _instead = "send its values, and make the guide there"

    def __init__(self, values: Array, kind: GuideKind = "depth") -> None:
        self._native = _native.DepthGuide(as_guide(values), kind)
        self.kind: GuideKind = kind

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self._native.width, self._native.height

    @property
    def missing(self) -> int:
        """Number of pixels without a usable value, which are filled from their neighbours."""
        return self._native.missing

    def __repr__(self) -> str:
        width, height = self.size
        return f"<lsdc.DepthGuide {width}x{height}, {self.kind}>"
