"""Labels for trajectories that took no part."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import BoolArray, IntArray


def join_largest(labels: IntArray, used: BoolArray) -> IntArray:
    """Labels of all trajectories; those that took no part join the largest motion.

    Without evidence that is the best guess.

    Parameters
    ----------
    labels : (m,) int64
        Labels of the trajectories that took part, 0 = outlier.
    used : (n,) bool
        Which m of the n trajectories those are.

    Returns
    -------
    (n,) int64
        Where all m are outliers, so are the others.
    """
    sizes = np.bincount(labels)
    largest = int(sizes[1:].argmax()) + 1 if len(sizes) > 1 else 0
    everywhere = np.full(len(used), largest, dtype=np.int64)
    everywhere[used] = labels
    return everywhere
