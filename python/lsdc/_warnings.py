"""What was assumed or left out, as warnings at the line of the caller."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable


class InputWarning(UserWarning):
    """What was assumed of an argument, or left out, and should be checked."""


class FileWarning(InputWarning):
    """The same of a file."""


# What the program calls the arguments of this package.
ARGUMENTS = {"--depth-unit": "`unit`", "--depth-kind": "`kind`", "--camera": "`camera`"}


def warn(what: str, remarks: Iterable[str], category: type[InputWarning]) -> None:
    """Warns of each remark about what is named so."""
    for remark in remarks:
        for option, argument in ARGUMENTS.items():
            remark = remark.replace(option, argument)
        warnings.warn(f"{what}: {remark}", category, stacklevel=_depth())


def _depth() -> int:
    """Of the calls within this package, of which a warning tells the first."""
    depth, frame = 0, sys._getframe(1)
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).split(".")[0] == __package__:
        depth, frame = depth + 1, frame.f_back
    return depth + 1
