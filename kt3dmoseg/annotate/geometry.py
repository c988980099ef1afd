"""Plane geometry of regions: distances to a boundary, resampling, blending."""

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from kt3dmoseg.annotate.model import Polygon
from kt3dmoseg.types import FloatArray

# Largest root mean square shift of corners, as a share of the outline's size, of one edited outline.
_SAME_CORNERS = 0.15
_SAMPLES = 72


def signed_distance(points: FloatArray, polygons: Sequence[FloatArray], reach: float = np.inf) -> FloatArray:
    """Distance (N,) of points (N, 2) to the boundary of a union of polygons, positive inside, in pixels.

    Where polygons overlap, the deepest counts; this underestimates the true depth in the union,
    which only matters closer to the boundary than the overlap is wide. Beyond `reach`, -inf.
    """
    best = np.full(len(points), -np.inf)
    for polygon in polygons:
        left, top, right, bottom = bounds([polygon])
        low, high = (left - reach, top - reach), (right + reach, bottom + reach)
        near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        # OpenCV rounds to float32, which is finest around 0.
        contour = (polygon - polygon[0]).astype(np.float32)[:, None]
        depths = [cv2.pointPolygonTest(contour, p, True) for p in (points[near] - polygon[0]).tolist()]
        best[near] = np.maximum(best[near], depths)
    best[best < -reach] = -np.inf
    return best


def arrays(polygons: Sequence[Polygon]) -> list[FloatArray]:
    """Polygons of the model as (P, 2) float64 arrays."""
    return [np.array(polygon, dtype=np.float64) for polygon in polygons]


def bounds(polygons: Sequence[FloatArray]) -> tuple[float, float, float, float]:
    """Bounding box (left, top, right, bottom) of at least one polygon, in pixels."""
    stacked = np.concatenate(list(polygons))
    low, high = stacked.min(axis=0), stacked.max(axis=0)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def area(polygon: FloatArray) -> float:
    """Signed area in square pixels (shoelace formula); positive when clockwise on the screen."""
    x, y = polygon.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def size(polygons: Sequence[FloatArray]) -> float:
    """Area of polygons together, in square pixels."""
    return sum(abs(area(polygon)) for polygon in polygons)


def without_specks(polygons: Sequence[Polygon]) -> list[Polygon]:
    """Leave out the polygons that are smaller than a tenth of the largest."""
    sizes = [size([polygon]) for polygon in arrays(polygons)]
    return [polygon for polygon, own in zip(polygons, sizes, strict=True) if own >= 0.1 * max(sizes)]


def median(values: FloatArray, axis: int) -> FloatArray:
    """Median without NaN; much faster than numpy's for short axes."""
    ordered = np.sort(values, axis=axis)
    count = np.isfinite(values).sum(axis=axis, keepdims=True)
    last = np.maximum(count - 1, 0)
    low, high = (np.take_along_axis(ordered, k, axis) for k in (last // 2, (last + 1) // 2))
    return np.asarray(np.squeeze((low + high) / 2, axis))


def resample(polygon: FloatArray, count: int) -> FloatArray:
    """Return `count` points at equal distances along the boundary, starting at the first vertex."""
    closed = np.concatenate([polygon, polygon[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    at = np.linspace(0.0, length[-1], count, endpoint=False)
    return np.stack([np.interp(at, length, closed[:, axis]) for axis in (0, 1)], axis=1)


def in_order_of(first: Sequence[Polygon], second: Sequence[Polygon]) -> list[Polygon]:
    """Order the polygons of `second` as those of `first`, as many, to which they are nearest (Kuhn 1955)."""
    ends = [np.array([np.mean(polygon, axis=0) for polygon in side]) for side in (first, second)]
    apart = np.linalg.norm(ends[0][:, None] - ends[1], axis=2)
    return [second[k] for k in linear_sum_assignment(apart)[1].tolist()]


def blend(first: Sequence[FloatArray], second: Sequence[FloatArray], weight: float) -> list[FloatArray]:
    """Blend two outlines of one region: 0 gives the first, 1 the second.

    Polygons with the same corners are blended vertex by vertex. Others are resampled, turned the
    same way round and shifted against each other until they fit best. Of several polygons those at
    the same place of the lists belong together. Regions of different numbers of polygons cannot be
    blended: the one of larger weight is taken.
    """
    if len(first) != len(second):
        return list(first if weight < 0.5 else second)
    return [(1 - weight) * a + weight * b for a, b in map(_matched, first, second)]


def _matched(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    if len(a) == len(b):
        gap = (a - a.mean(axis=0)) - (b - b.mean(axis=0))
        if np.sqrt((gap**2).sum(axis=1).mean()) <= _SAME_CORNERS * np.sqrt(abs(area(a)) + 1):
            return a, b  # vertex k of both is the same corner: one was edited from the other
    a, b = resample(a, _SAMPLES), resample(b, _SAMPLES)
    if area(a) * area(b) < 0:
        b = b[::-1]
    centred = (a - a.mean(axis=0)) @ (b - b.mean(axis=0)).T
    # The best cyclic shift maximises the sum of inner products along a wrapped diagonal.
    index = np.arange(_SAMPLES)
    fits = [centred[index, (index + shift) % _SAMPLES].sum() for shift in index]
    return a, np.roll(b, -int(np.argmax(fits)), axis=0)
