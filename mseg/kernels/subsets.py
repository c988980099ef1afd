"""Uniform random subsets of a given size, many at once."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import IntArray


def draw_subsets(sizes: IntArray, count: int, rng: np.random.Generator) -> IntArray:
    """Draw one uniform subset of 0..size-1 per given size, without replacement.

    Parameters
    ----------
    sizes : (K,) int64
        Sizes of the K populations, each at least `count`.
    count : int
        Size p of the subsets.
    rng : numpy.random.Generator
        Randomness; K * p numbers are drawn, whatever happens.

    Returns
    -------
    (K, p) int64
        Distinct members in each row.

    References
    ----------
    Floyd's algorithm, in Bentley and Floyd, "A sample of brilliance", CACM 1987.
    """
    draws = rng.random((len(sizes), count))
    chosen = np.empty((len(sizes), count), dtype=np.int64)
    for k in range(count):
        last = sizes - count + k
        candidate = np.minimum((draws[:, k] * (last + 1)).astype(np.int64), last)
        taken = (chosen[:, :k] == candidate[:, None]).any(axis=1)
        chosen[:, k] = np.where(taken, last, candidate)
    return chosen
