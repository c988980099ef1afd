"""The best one-to-one assignment of predicted groups to true motions."""

from __future__ import annotations

import math
from functools import cache
from itertools import permutations

import numpy as np

from kt3dmoseg.types import FloatArray, IntArray

_MAX_SEARCH = 1000


def best_assignment(counts: IntArray) -> IntArray:
    """Choose a different group for each motion so that most trajectories agree.

    Solves the rectangular assignment problem max sum_i counts[i, a(i)] over one-to-one maps a
    (Kuhn 1955). For as many groups as motions this is the search over all permutations of the
    Hopkins155 code, at cubic instead of factorial cost. Among equally good assignments the one
    with the larger sum of intersections over unions is taken.

    Parameters
    ----------
    counts : (M, G) int64
        Trajectories of motion i in group j; M and G may differ.

    Returns
    -------
    (M,) int64
        Column chosen for each row; -1 where a motion gets no group or shares nothing with it.

    Examples
    --------
    Motion 1 has 3 + 2 trajectories, motion 2 has 4 + 0. Group 0 for motion 1 would agree on
    3 + 0, group 1 for motion 1 on 2 + 4.

    >>> best_assignment(np.array([[3, 2], [4, 0]])).tolist()
    [1, 0]
    """
    union = counts.sum(axis=1, keepdims=True) + counts.sum(axis=0, keepdims=True) - counts
    overlap = counts / np.maximum(union, 1)
    # Each overlap is at most 1, so all of them together weigh less than one trajectory.
    return assign(counts + overlap / (2 * max(1, min(counts.shape))))


def assign(gain: FloatArray) -> IntArray:
    """Maximise the sum of gains over one-to-one choices of a column per row.

    Parameters
    ----------
    gain : (M, G) float64
        Non-negative gains.

    Returns
    -------
    (M,) int64
        The columns; -1 where a row is left without one or gains nothing.
    """
    chosen = np.full(len(gain), -1, dtype=np.int64)
    if not gain.size:
        return chosen
    # A fixed order of the columns makes the choice independent of how groups are numbered.
    order = np.lexsort(gain)
    rows, columns = _solve(gain[:, order])
    chosen[rows] = order[columns]
    chosen[gain[np.arange(len(gain)), chosen] <= 0] = -1
    return chosen


def _solve(gain: FloatArray) -> tuple[IntArray, IntArray]:
    """Find the best one-to-one choice: by search when it is small, else with scipy.

    The search spares the import of scipy.optimize, which takes longer than scoring a benchmark.
    """
    few, many = sorted(gain.shape)
    if math.perm(many, few) > _MAX_SEARCH:
        from scipy.optimize import linear_sum_assignment

        rows, columns = linear_sum_assignment(gain, maximize=True)
        return rows, columns
    wide = gain if len(gain) == few else gain.T
    choices = _choices(many, few)
    best = choices[np.argmax(wide[np.arange(few), choices].sum(axis=1))]
    return (np.arange(few), best) if len(gain) == few else (best, np.arange(few))


@cache
def _choices(many: int, few: int) -> IntArray:
    """Every ordered choice of `few` out of `many`, (P, few)."""
    return np.array(list(permutations(range(many), few)), dtype=np.int64)
