"""Warnings about assumptions and omissions, at the line of the caller."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable


class InputWarning(UserWarning):
    """An assumption about an argument, or an omission, that should be checked."""


class FileWarning(InputWarning):
    """An assumption about a file, or an omission, that should be checked."""


# The program's options, with the arguments of this package.
ARGUMENTS = {"--depth-unit": "`unit`", "--depth-kind": "`kind`", "--camera": "`camera`"}


def warn(what: str, remarks: Iterable[str], category: type[InputWarning]) -> None:
    """Issues a warning for each remark about `what`."""
    for remark in remarks:
        for option, argument in ARGUMENTS.items():
            remark = remark.replace(option, argument)
        warnings.warn(f"{what}: {remark}", category, stacklevel=_depth())


def _depth() -> int:
    """Returns the stack level of the call into this package, at which warnings are reported."""
    depth, frame = 0, sys._getframe(1)
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).split(".")[0] == __package__:
        depth, frame = depth + 1, frame.f_back
    return depth + 1
