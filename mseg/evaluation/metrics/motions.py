"""Metrics per motion, under the assignment that gives the classification error."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import FloatArray
from mseg.evaluation.contingency import Contingency


def precision_per_motion(table: Contingency) -> FloatArray:
    """Share of the assigned group that belongs to the motion, (M,); 0 without a group.

    Examples
    --------
    Group 2 holds one of motion 1 and both of motion 2.

    >>> from mseg.evaluation.contingency import contingency
    >>> precision_per_motion(contingency([1, 1, 2, 2], [1, 2, 2, 2])).round(4).tolist()
    [1.0, 0.6667]
    """
    return table.matched / np.maximum(table.group_sizes, 1)


def recall_per_motion(table: Contingency) -> FloatArray:
    """Share of the motion that is in its assigned group, (M,).

    Examples
    --------
    >>> from mseg.evaluation.contingency import contingency
    >>> recall_per_motion(contingency([1, 1, 2, 2], [1, 2, 2, 2])).tolist()
    [0.5, 1.0]
    """
    return table.matched / table.sizes


def f_per_motion(table: Contingency) -> FloatArray:
    """Harmonic mean of precision and recall, (M,): 2 |m & g| / (|m| + |g|).

    Examples
    --------
    2 * 1 / (2 + 1) and 2 * 2 / (2 + 3).

    >>> from mseg.evaluation.contingency import contingency
    >>> f_per_motion(contingency([1, 1, 2, 2], [1, 2, 2, 2])).round(4).tolist()
    [0.6667, 0.8]
    """
    return 2 * table.matched / (table.sizes + table.group_sizes)


def iou_per_motion(table: Contingency) -> FloatArray:
    """Intersection over union of each motion and its assigned group, (M,).

    Examples
    --------
    1 of 2 and 2 of 3.

    >>> from mseg.evaluation.contingency import contingency
    >>> iou_per_motion(contingency([1, 1, 2, 2], [1, 2, 2, 2])).round(4).tolist()
    [0.5, 0.6667]
    """
    return table.matched / (table.sizes + table.group_sizes - table.matched)


def precision(table: Contingency) -> float:
    """Precision averaged over motions.

    Examples
    --------
    >>> from mseg.evaluation.contingency import contingency
    >>> round(precision(contingency([1, 1, 2, 2], [1, 2, 2, 2])), 4)
    0.8333
    """
    return float(precision_per_motion(table).mean())


def recall(table: Contingency) -> float:
    """Recall averaged over motions.

    Examples
    --------
    >>> from mseg.evaluation.contingency import contingency
    >>> recall(contingency([1, 1, 2, 2], [1, 2, 2, 2]))
    0.75
    """
    return float(recall_per_motion(table).mean())


def f_measure(table: Contingency) -> float:
    """F-measure averaged over motions.

    Examples
    --------
    >>> from mseg.evaluation.contingency import contingency
    >>> round(f_measure(contingency([1, 1, 2, 2], [1, 2, 2, 2])), 4)
    0.7333
    """
    return float(f_per_motion(table).mean())


def iou(table: Contingency) -> float:
    """Intersection over union averaged over motions.

    Examples
    --------
    >>> from mseg.evaluation.contingency import contingency
    >>> round(iou(contingency([1, 1, 2, 2], [1, 2, 2, 2])), 4)
    0.5833
    """
    return float(iou_per_motion(table).mean())


def moving_error(table: Contingency) -> float:
    """Fraction of trajectories wrong when only background and moving are told apart.

    The group assigned to the background is "background", every other group and label 0 is
    "moving". Without a known background, the largest motion takes its place.

    Examples
    --------
    Background 1, objects 2 and 3 swapped in part: that is no error here, the lost background is.

    >>> from mseg.evaluation.contingency import contingency
    >>> moving_error(contingency([1, 1, 1, 1, 2, 3], [1, 1, 1, 2, 2, 2], background=1)).__round__(4)
    0.1667
    """
    _, false, missed = _moving(table)
    return (false + missed) / table.n


def moving_f(table: Contingency) -> float:
    """F-measure of "moving" against "background", see `moving_error`.

    Examples
    --------
    Three are called moving, two of them are, none is missed: 2 * 2 / (2 * 2 + 1).

    >>> from mseg.evaluation.contingency import contingency
    >>> moving_f(contingency([1, 1, 1, 1, 2, 3], [1, 1, 1, 2, 2, 2], background=1))
    0.8
    """
    hit, false, missed = _moving(table)
    return 2 * hit / (2 * hit + false + missed) if hit + false + missed else 1.0


def _moving(table: Contingency) -> tuple[int, int, int]:
    """Count moving called moving, background called moving, moving called background."""
    row = table.static
    called = int(table.group_sizes[row])
    kept = int(table.matched[row])
    false = int(table.sizes[row]) - kept
    missed = called - kept
    return table.n - int(table.sizes[row]) - missed, false, missed
