"""Which labels of two labellings mean the same motion."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from kt3dmoseg.types import IntArray


def match_labels(a: IntArray, b: IntArray) -> dict[int, int]:
    """Match labels one to one so that most trajectories agree (Kuhn 1955).

    Parameters
    ----------
    a, b : (n,) int64
        Labels of the same trajectories; 0 matches nothing.

    Returns
    -------
    dict of int to int
        Label of `a` to label of `b`; only those that share a trajectory.

    Examples
    --------
    >>> match_labels(np.array([1, 1, 2, 0]), np.array([5, 5, 5, 7]))
    {1: 5}
    """
    names_a, names_b = (np.unique(labels[labels != 0]) for labels in (a, b))
    shared = ((a == names_a[:, None])[:, None] & (b == names_b[:, None])).sum(axis=2)
    pairs = zip(*linear_sum_assignment(shared, maximize=True), strict=True)
    return {int(names_a[i]): int(names_b[j]) for i, j in pairs if shared[i, j] > 0}
