"""Polygons as in CVAT, LabelMe and COCO, where (0, 0) is the corner of the top-left pixel, not its centre."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from kt3dmoseg.annotate.model import Polygon, polygon_from
from kt3dmoseg.types import FloatArray

_HALF = 0.5
_DECIMALS = 2


def to_corner(polygon: FloatArray) -> list[list[float]]:
    """Return the points of a (P, 2) polygon in those tools' coordinates, to 1/100 pixel."""
    points: list[list[float]] = np.round(polygon + _HALF, _DECIMALS).tolist()
    return points


def from_corner(points: Iterable[Sequence[float]], where: str) -> Polygon:
    """Return a polygon of such a tool in our coordinates, to 1/100 pixel.

    Raises
    ------
    InvalidValueError
        When it is none; `where` names it.
    """
    checked = polygon_from(list(points), where)
    return tuple((round(x - _HALF, _DECIMALS), round(y - _HALF, _DECIMALS)) for x, y in checked)
