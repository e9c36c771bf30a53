"""The exceptions of this package."""

from __future__ import annotations


class Error(Exception):
    """Any error of this package.

    The message says what is wrong and where; `hint` says what to do, if that is known. Tracebacks show both (from
    Python 3.11 on).

    >>> import lsdc
    >>> try:
    ...     lsdc.Completer("huge")
    ... except lsdc.Error as error:
    ...     print(error, "|", error.hint)
    there are no weights `huge` | give "default", "small", "anything", "none", or the path of a weights file
    """

    hint: str | None

    def __init__(self, message: str = "", hint: str | None = None) -> None:
        super().__init__(message)
        self.hint = hint
        if hint is not None and hasattr(self, "add_note"):
            self.add_note(f"hint: {hint}")


class InputError(Error, ValueError):
    """An array has an unusable shape, type or content."""


class SettingsError(Error, ValueError):
    """A setting is unknown or out of range."""


class WeightsError(Error, ValueError):
    """Weights are damaged, or do not belong to their network."""


class FitError(Error, ValueError):
    """The fit has no solution: for example, no depth can be used."""


class ReadError(Error, OSError):
    """A file cannot be read."""
