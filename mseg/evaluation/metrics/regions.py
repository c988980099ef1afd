"""Precision, recall and F-measure over regions, as the FBMS-59 benchmark counts them.

Every true motion is a region; groups are assigned one-to-one so that the sum of F-measures is
largest, not the sum of trajectories, so that small objects weigh as much as large ones (Ochs,
Malik and Brox, PAMI 2014, section 5; here over trajectories instead of pixels).
"""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import FloatArray
from mseg.evaluation.assignment import assign
from mseg.evaluation.contingency import Contingency

OBJECT_F = 0.75


def region_f_per_motion(table: Contingency) -> FloatArray:
    """F-measure of each motion with the group that serves the regions best, (M,).

    Examples
    --------
    F of (motion, group): (1, 1) 4/5, (1, 2) 2/5, (2, 1) 0, (2, 2) 2/3; the sum is largest for 1-1, 2-2.

    >>> from mseg.evaluation.contingency import contingency
    >>> region_f_per_motion(contingency([1, 1, 1, 2], [1, 1, 2, 2])).round(4).tolist()
    [0.8, 0.6667]
    """
    return _regions(table)[2]


def region_precision(table: Contingency) -> float:
    """Precision averaged over the true regions; a region without a group has 0.

    Examples
    --------
    Group 1 is pure, group 2 is half motion 2: (1 + 1/2) / 2.

    >>> from mseg.evaluation.contingency import contingency
    >>> region_precision(contingency([1, 1, 1, 2], [1, 1, 2, 2]))
    0.75
    """
    return float(_regions(table)[0].mean())


def region_recall(table: Contingency) -> float:
    """Recall averaged over the true regions.

    Examples
    --------
    (2/3 + 1) / 2.

    >>> from mseg.evaluation.contingency import contingency
    >>> round(region_recall(contingency([1, 1, 1, 2], [1, 1, 2, 2])), 4)
    0.8333
    """
    return float(_regions(table)[1].mean())


def region_f(table: Contingency) -> float:
    """Harmonic mean of `region_precision` and `region_recall`.

    Examples
    --------
    2 * 0.75 * 0.8333 / (0.75 + 0.8333).

    >>> from mseg.evaluation.contingency import contingency
    >>> round(region_f(contingency([1, 1, 1, 2], [1, 1, 2, 2])), 4)
    0.7895
    """
    p, r = region_precision(table), region_recall(table)
    return 2 * p * r / (p + r) if p + r else 0.0


def objects_found(table: Contingency) -> float:
    """Count the moving objects (motions but the background) whose F-measure is at least 0.75.

    Without a known background, the largest motion takes its place.

    Examples
    --------
    Motion 2 has F = 1, motion 3 has F = 2/3: one object.

    >>> from mseg.evaluation.contingency import contingency
    >>> objects_found(contingency([1, 1, 1, 2, 3, 3], [1, 1, 1, 2, 3, 0], background=1))
    1.0
    """
    return float((np.delete(region_f_per_motion(table), table.static) >= OBJECT_F).sum())


def _regions(table: Contingency) -> tuple[FloatArray, FloatArray, FloatArray]:
    group_sizes = table.counts.sum(axis=0)
    f = 2 * table.counts / (table.sizes[:, None] + group_sizes[None, :])
    chosen = assign(f)
    shared = np.zeros(len(table.motions))
    size = np.ones(len(table.motions))
    rows = np.flatnonzero(chosen >= 0)
    shared[rows] = table.counts[rows, chosen[rows]]
    size[rows] = group_sizes[chosen[rows]]
    f_best = np.zeros(len(table.motions))
    f_best[rows] = f[rows, chosen[rows]]
    return shared / size, shared / table.sizes, f_best
