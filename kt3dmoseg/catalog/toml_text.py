"""Texts in TOML files that we write; `tomllib` reads them back."""

from __future__ import annotations


def quoted(text: str) -> str:
    r"""Return a text as a basic string of TOML, on one line.

    >>> print(quoted('a 5" pipe'))
    "a 5\" pipe"
    """
    return '"' + "".join(map(_escaped, text)) + '"'


def _escaped(character: str) -> str:
    if character in '"\\':
        return "\\" + character
    return character if character.isprintable() else f"\\U{ord(character):08x}"
