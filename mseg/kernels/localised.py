"""Random subsets of neighbours: near points more often belong to one motion."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import FloatArray, IntArray


def draw_near_subsets(
    points: FloatArray, count: int, size: int, rng: np.random.Generator, *, reach: float = 0.25
) -> IntArray:
    """Draw subsets whose members lie near their first one.

    The first members run through all points in turn; the others are drawn one by one, without
    replacement, with probability proportional to ``exp(-d^2 / sigma^2)``, d the distance to the first and
    sigma a part of the largest distance between points.

    Parameters
    ----------
    points : (N, D) float64
        Points as rows.
    count, size : int
        Number M of subsets and their size p <= N.
    rng : numpy.random.Generator
        Randomness.
    reach : float
        sigma over the largest distance.

    Returns
    -------
    (M, p) int64

    References
    ----------
    Toldo and Fusiello, "Robust multiple structures estimation with J-linkage", ECCV 2008, section 2.1.
    Drawing without replacement by the largest perturbed logarithms: Vieira, "Gumbel-max trick and
    weighted reservoir sampling", 2014.
    """
    squares = (points**2).sum(axis=1)
    distance = np.maximum(squares[:, None] + squares - 2 * (points @ points.T), 0)
    widest = reach**2 * float(distance.max())
    logarithm = -distance / widest if widest > 0 else np.zeros_like(distance)
    np.fill_diagonal(logarithm, np.inf)
    first = np.arange(count) % len(points)
    subsets = np.empty((count, size), dtype=np.int64)
    # One turn through the points at a time bounds the memory to N^2.
    for start in range(0, count, len(points)):
        part = first[start : start + len(points)]
        keys = logarithm[part] + rng.gumbel(size=(len(part), len(points)))
        others = np.argpartition(-keys, size - 1, axis=1)[:, :size]
        subsets[start : start + len(part)] = _first_in_front(others, part)
    return subsets


def _first_in_front(members: IntArray, first: IntArray) -> IntArray:
    place = (members == first[:, None]).argmax(axis=1)
    rows = np.arange(len(members))
    members[rows, place] = members[:, 0]
    members[:, 0] = first
    return members
