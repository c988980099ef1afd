"""Texts for people: short lists, counted things, tables for a terminal, values in TOML files."""

import json
from collections.abc import Iterable, Sequence
from numbers import Real


def several(items: Iterable[object], most: int = 3) -> str:
    """Name the first few items and the number of the others.

    >>> several("abcde")
    'a, b, c and 2 more'
    """
    names = [str(item) for item in items]
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def count(number: int, noun: str) -> str:
    """Count something: "1 clip", "2 clips"."""
    return f"{number} {noun}{'s' * (number != 1)}"


def toml_text(value: object) -> str:
    """Write a value as TOML does: numbers, texts and lists as JSON does, all else as a text."""
    if not isinstance(value, int) and isinstance(value, Real):  # numpy's, too
        value = float(value)
    known = value if isinstance(value, (bool, int, float, list, tuple)) else str(value)
    return json.dumps(known, ensure_ascii=False, default=str).replace("\x7f", "\\u007f")


def text_table(rows: Sequence[Sequence[str]], header: Sequence[str]) -> str:
    """Lay out cells in columns: the first to the left, numbers to the right."""
    cells = [header, *rows]
    widths = [max(len(row[k]) for row in cells) for k in range(len(header))]
    lines = ([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])] for row in cells)
    return "\n".join("  ".join(line).rstrip() for line in lines)
