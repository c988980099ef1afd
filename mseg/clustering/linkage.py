"""T-linkage: points join while they still prefer a model together."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import BoolArray, FloatArray, IntArray
from mseg.clustering.preference import tanimoto_distance

_ORTHOGONAL = 1 - 1e-9


def tanimoto_linkage(preferences: FloatArray) -> IntArray:
    """Merge the two clusters of least Tanimoto distance until all are orthogonal.

    The preference of a cluster for a hypothesis is the least of its members'. Clusters at distance one
    have no hypothesis that all their members like.

    Parameters
    ----------
    preferences : (N, M) float64
        Preferences in [0, 1] of points for hypotheses.

    Returns
    -------
    (N,) int64
        Clusters 1, 2, ..., the largest first (of equals the one with the earlier point).

    Notes
    -----
    A merge costs one product of N x M; O(N^2 M) altogether, O(N M + N^2) memory.

    References
    ----------
    Magri and Fusiello, "T-Linkage: a continuous relaxation of J-Linkage for multi-model fitting", CVPR
    2014, algorithm 1.
    """
    n = len(preferences)
    cluster = np.arange(n)
    taste, owner = preferences.copy(), np.arange(n)
    squares = np.einsum("nm,nm->n", taste, taste)
    distance = tanimoto_distance(taste)
    np.fill_diagonal(distance, np.inf)
    alive = np.ones(n, dtype=bool)
    while n > 1:
        i, j = divmod(int(distance.argmin()), len(distance))
        if not distance[i, j] < _ORTHOGONAL:
            break
        cluster[cluster == owner[j]] = owner[i]
        np.minimum(taste[i], taste[j], out=taste[i])
        alive[j] = False
        squares[i] = taste[i] @ taste[i]
        distance[i] = distance[:, i] = _row(taste, squares, alive, i)
        distance[j] = distance[:, j] = np.inf
        if 2 * alive.sum() < len(alive):
            taste, owner, squares = taste[alive], owner[alive], squares[alive]
            distance = np.ascontiguousarray(distance[np.ix_(alive, alive)])
            alive = np.ones(len(owner), dtype=bool)
    return by_size(cluster)


def by_size(cluster: IntArray) -> IntArray:
    """Rename clusters to 1, 2, ... by decreasing size, of equal sizes the one that appears first."""
    _, first, inverse, counts = np.unique(cluster, return_index=True, return_inverse=True, return_counts=True)
    rank = np.empty(len(counts), dtype=np.int64)
    rank[np.lexsort((first, -counts))] = np.arange(1, len(counts) + 1)
    return np.asarray(rank[inverse])


def _row(taste: FloatArray, squares: FloatArray, alive: BoolArray, i: int) -> FloatArray:
    inner = taste @ taste[i]
    union = squares + squares[i] - inner
    alike = np.divide(inner, union, out=np.zeros_like(inner), where=union > 0)
    alike[~alive], alike[i] = -np.inf, -np.inf
    return np.asarray(1 - alike)
