"""Checks of single fields of an annotation; each error names the field.

The bounds are those of what a person draws; they keep a hostile file from costing memory or time.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Literal, TypeAlias

from kt3dmoseg.errors import InvalidValueError

Point: TypeAlias = tuple[float, float]
Polygon: TypeAlias = tuple[Point, ...]
Motion: TypeAlias = int | Literal["reject"]

REJECT: Literal["reject"] = "reject"

MAX_FRAMES = 100_000
MAX_OBJECTS = 1_000
MAX_POLYGONS = 200
MAX_POINTS = 5_000
MAX_TEXT = 500
MAX_SIDE = 100_000
_HALVES = re.compile("[\ud800-\udfff]")


@contextmanager
def within(path: str) -> Iterator[None]:
    """Put `path` before the field that a validation error names."""
    try:
        yield
    except InvalidValueError as error:
        joint = "" if error.where.startswith("[") else "."
        raise InvalidValueError(
            f"{path}{joint}{error.where}", expected=error.expected, found=error.found, fix=error.fix
        ) from None


def polygons_from(polygons: Sequence[Sequence[Sequence[float]]]) -> tuple[Polygon, ...]:
    """Check a list of polygons and return it as tuples of floats."""
    if len(polygons) > MAX_POLYGONS:
        raise InvalidValueError("polygons", expected=f"at most {MAX_POLYGONS}", found=str(len(polygons)))
    return tuple(polygon_from(polygon, f"polygons[{i}]") for i, polygon in enumerate(polygons))


def polygon_from(polygon: Sequence[Sequence[float]], where: str) -> Polygon:
    """Check one polygon and return it as a tuple of pairs of floats."""
    if not 3 <= len(polygon) <= MAX_POINTS:
        raise InvalidValueError(where, expected=f"3 to {MAX_POINTS} points", found=str(len(polygon)))
    return tuple(_point(point, f"{where}[{i}]") for i, point in enumerate(polygon))


def check_motion(motion: Motion) -> None:
    """Check a motion number.

    Raises
    ------
    InvalidValueError
        Unless it is ``"reject"`` or a whole number of at least 0.
    """
    if motion == REJECT:
        return
    if isinstance(motion, bool) or not isinstance(motion, int) or not 0 <= motion <= MAX_OBJECTS:
        expected = f"a whole number in 0..{MAX_OBJECTS} or 'reject'"
        raise InvalidValueError("motion", expected=expected, found=repr(motion))


def whole(name: str, value: object, low: int, high: int) -> int:
    """Return `value` when it is a whole number in low..high; else name the field."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise InvalidValueError(name, expected=f"a whole number in {low}..{high}", found=repr(value)[:80])
    return value


def text(name: str, value: object, *, empty: bool = False) -> str:
    """Return `value` when it is a text of sensible length that a file can hold; else name the field."""
    if not isinstance(value, str) or len(value) > MAX_TEXT or not (value.strip() or empty):
        expected = f"a text of {0 if empty else 1} to {MAX_TEXT} characters"
        raise InvalidValueError(name, expected=expected, found=repr(value)[:80])
    if _HALVES.search(value):
        raise InvalidValueError(name, expected="whole characters", found=repr(value)[:80])
    return value


def _point(point: Sequence[float], where: str) -> Point:
    numbers = all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in point)
    if len(point) != 2 or not numbers or not all(math.isfinite(v) and abs(v) <= MAX_SIDE for v in point):
        raise InvalidValueError(where, expected="[x, y] in pixels", found=repr(point)[:80])
    return float(point[0]), float(point[1])
