"""Texts at the seam: the clip's name from a file's name, and JSON in attributes."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kt3dmoseg.errors import FileFormatError, InvalidValueError

_ENDINGS = ("_Tracks", "_truth")
_LONGEST = 200
_NUMBER = re.compile(r"-?[0-9]{1,18}")


def clip_name(path: str | os.PathLike[str]) -> str:
    """Return the clip's name: the file's stem without ``_Tracks`` or ``_truth``.

    >>> clip_name("release/Seq028_clip03_Tracks.mat"), clip_name("cars1_truth.mat")
    ('Seq028_clip03', 'cars1')
    """
    stem = Path(path).stem
    for ending in _ENDINGS:
        stem = stem.removesuffix(ending)
    return stem


def json_text(values: Mapping[str, Any], what: str) -> str:
    """Return JSON with sorted keys, so that equal values give equal bytes.

    Raises
    ------
    InvalidValueError
        When a value is none of JSON's.
    """
    try:
        return json.dumps(dict(values), sort_keys=True, ensure_ascii=False, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InvalidValueError(what, expected="JSON values", found=str(error)) from None


def json_object(text: str, where: str) -> dict[str, Any]:
    """Parse a JSON object."""
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileFormatError(where, expected="JSON", found=str(error)) from None
    if not isinstance(values, dict):
        raise FileFormatError(where, expected="a JSON object", found=type(values).__name__)
    return values


def motion_names(text: str, where: str) -> dict[int, str]:
    """Parse a JSON object of the names of motions, its keys being their numbers."""
    values = json_object(text, where)
    odd = next((key for key in values if not _NUMBER.fullmatch(key)), None)
    if odd is not None:
        raise FileFormatError(where, expected="numbers of motions", found=repr(odd))
    return {int(key): str(name) for key, name in values.items()}


def check_name(name: str, where: str) -> None:
    """Refuse the name of a clip that could not be a file's, before anything is written under it.

    Raises
    ------
    InvalidValueError
        When the name is empty, too long, or leads elsewhere.
    """
    if not name.isprintable() or name in ("", ".", "..") or len(name) > _LONGEST or set(name) & set("/\\"):
        raise InvalidValueError(
            where, expected=f"a clip's name, at most {_LONGEST} characters without a slash", found=f"{name!r}"
        )
