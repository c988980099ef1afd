"""What can be wrong with a submission, as data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong, and what to do about it.

    Parameters
    ----------
    code : str
        Stable short name, for scripts.
    file : str
        File inside the submission; empty when it is about the whole.
    clip : str
        Clip concerned; empty when it is about the whole.
    expected, found, fix : str
        What was expected, what is there, how to repair it.
    """

    code: str
    file: str = ""
    clip: str = ""
    expected: str = ""
    found: str = ""
    fix: str = ""

    def __str__(self) -> str:
        """Give the problem in one line."""
        place = ", ".join(part for part in (self.file, self.clip and f"clip {self.clip}") if part)
        parts = [
            f"expected {self.expected}" if self.expected else "",
            f"found {self.found}" if self.found else "",
        ]
        text = ", ".join(part for part in parts if part)
        line = f"[{self.code}] {place or 'submission'}: {text}"
        return " ".join((f"{line}; {self.fix}" if self.fix else line).split())

    def as_dict(self) -> dict[str, str]:
        """Give the fields as a plain mapping."""
        return asdict(self)


def numbered(problems: Sequence[Problem]) -> str:
    """Lay problems out as a numbered list, one line each."""
    width = len(str(len(problems)))
    return "\n".join(f"{i:>{width}}. {problem}" for i, problem in enumerate(problems, start=1))


def first_few(items: Sequence[object], limit: int = 5) -> str:
    """Name the first few items and the number of the others."""
    shown = ", ".join(str(item) for item in items[:limit])
    return shown if len(items) <= limit else f"{shown} and {len(items) - limit} more"
