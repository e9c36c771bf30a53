"""Settings of the fit, under the names of the program's configuration."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Literal, TypedDict, Union

from ._errors import SettingsError

Loss = Literal["irls", "huber", "cauchy", "gm", "tukey", "auto"]


class RobustSettings(TypedDict, total=False):
    """Settings of a robust fit, which limits the influence of outliers. Missing settings have the default of the loss."""

    loss: Loss
    """"auto" weights each point by its probability of being an inlier, judged by the others."""
    threshold: float
    """For "irls": residuals below this fraction of the median depth have equal weight."""
    tuning: float | None
    """The scale of the other losses in standard deviations of the noise; None for the classic constant."""
    neighbours: int
    """Residuals are compared with the median residual of this many nearest points; 0 for no comparison."""
    iterations: int
    """The largest number of solves after the first."""
    tolerance: float
    """Stops when no residual changes by more than this fraction of the largest depth."""


class JointSettings(TypedDict, total=False):
    """Settings of the joint fit of basis functions and a field that is smooth except across edges."""

    data: float
    """Weight of a point relative to an affinity of 1 between neighbouring pixels."""
    ridge: float
    """Penalty on the square of each weight, if there is no prior over the weights."""
    level: float
    """Penalty on the square of the field at each pixel."""
    cosines: float
    """Highest frequency of the cosine basis that is part of the field; 0 for none."""
    bending: float
    """Penalty on the square of a cosine's weight at low frequencies."""


# `lambda` is a Python keyword.
FitSettings = TypedDict(
    "FitSettings",
    {
        "method": Literal["lse", "field", "joint"],
        "joint": JointSettings,
        "rcond": float,
        "ridge": float,
        "prior": Literal["none", "flat", "learned"],
        "lambda": Union[Literal["evidence", "gcv"], float, "list[tuple[float, float]]"],
        "robust": Loss | RobustSettings | None,
    },
    total=False,
)
"""Settings of the fit; missing settings are those stored with the weights.

- `method`: the model of depth: only basis functions ("lse", as in the paper), only a "field", or both ("joint")
- `joint`: `JointSettings`
- `rcond`: singular values below this fraction of the largest are truncated
- `ridge`: added to the diagonal of the normal equations, as a fraction of their mean diagonal
- `prior`: over the weights of the basis functions: "none", "flat" or "learned"
- `lambda`: the strength of the prior: "evidence", "gcv", a number, or three pairs of a number of points and a strength
- `robust`: the name of a loss, `RobustSettings`, or None
"""

Robust = Union[Loss, Literal["none"], RobustSettings, None]
"""The name of a loss, its settings, or "none" for a plain fit. None means the default."""


def as_json(settings: object) -> str:
    """Converts settings for the extension module."""
    if not (settings is None or isinstance(settings, (str, Mapping))):
        raise SettingsError(f"{settings!r} is neither a name nor a dict of settings")
    try:
        return json.dumps(settings, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise SettingsError(f"settings are names and finite numbers: {error}") from None
