"""The one family of errors that a user of kt3dmoseg or mseg can meet.

Every message is one line: where, what was expected, what was found and what to do.
"""

from functools import partial
from importlib import import_module
from typing import Any

_LONGEST = 1000


class KT3DMoSegError(Exception):
    """Root of all errors raised on purpose by kt3dmoseg and mseg.

    Parameters
    ----------
    where : str
        The file, field or argument at fault; or the whole message when nothing else is given.
    expected, found, fix : str, optional
        What was expected there, what was found instead, and what the user can do about it.
    """

    exit_code = 2

    def __init__(self, where: str, *, expected: str = "", found: str = "", fix: str = "") -> None:
        found = found if len(found) <= _LONGEST else f"{found[:_LONGEST]} ..."  # what a damaged file holds
        self.where, self.expected, self.found, self.fix = where, expected, found, fix
        parts = [f"expected {expected}"] * bool(expected) + [f"found {found}"] * bool(found)
        message = ": ".join(part for part in (where, ", ".join(parts)) if part)
        super().__init__(" ".join(f"{message}; {fix}".split()) if fix else " ".join(message.split()))

    def __reduce__(self) -> tuple[object, ...]:
        """Cross process boundaries intact: rebuild from the four parts, not from the message."""
        return partial(type(self), expected=self.expected, found=self.found, fix=self.fix), (self.where,)


class InvalidValueError(KT3DMoSegError, ValueError):
    """An argument, option or array has a value that makes no sense."""


class UnknownNameError(KT3DMoSegError, LookupError):
    """A method, flow, metric, option or clip of that name does not exist."""


class FileFormatError(KT3DMoSegError, ValueError):
    """A file exists but does not hold what its format promises."""


class InputFileError(KT3DMoSegError, OSError):
    """A file or folder is missing, unreadable or unwritable."""

    def __str__(self) -> str:
        """Give the one-line message; OSError would print its argument tuple."""
        return str(self.args[0])


class MissingDependencyError(KT3DMoSegError, ImportError):
    """An optional package or its data is not installed."""


def optional(module: str, need: str, extra: str) -> Any:  # noqa: ANN401
    """Import a module of an extra for a `need`, as ``"plots need"``; raises MissingDependencyError."""
    try:
        return import_module(module)
    except ImportError as error:
        where = f"{need} {module.partition('.')[0]}"
        raise MissingDependencyError(where, fix=f"pip install 'kt3dmoseg[{extra}]'") from error
