"""The metrics: pure functions of a contingency table, each with a worked example.

`evaluate` computes all of them. A third party's metric is a `Metric` behind an entry point of the
group ``mseg.metrics``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from typing import Literal

import numpy as np

from kt3dmoseg.types import FloatArray, IntArray
from mseg.evaluation.contingency import Contingency, assign, contingency  # noqa: F401  # in the examples

_OBJECT_F = 0.75


@dataclass(frozen=True)
class Metric:
    """A metric with what a table must know about it."""

    function: Callable[[Contingency], float]  # from a contingency table to a number; never NaN
    title: str  # head of its column
    better: Literal["lower", "higher"]
    worst: Callable[[int], float]  # value of a failed or missing clip, from the number of its motions
    percent: bool = True  # it is a fraction, which tables print in per cent

    @property
    def scale(self) -> int:
        """Factor of printed values: 100 for fractions, which are printed in per cent."""
        return 100 if self.percent else 1

    def __call__(self, table: Contingency) -> float:
        """Compute the metric."""
        return self.function(table)

    def allows(self, value: float) -> bool:
        """Whether a clip's value is possible: of a fraction, between the worst and 1; else not negative."""
        return min(0.0, self.worst(1)) - 1e-9 <= value <= (1 + 1e-9 if self.percent else np.inf)

    def show(self, value: float) -> str:
        """Give a value as tables print it."""
        return f"{self.scale * value:.2f}"


# --- the two partitions as wholes -------------------------------------------------------------


def classification_error(table: Contingency) -> float:
    """Fraction of trajectories that are wrong under the best one-to-one assignment.

    The error of the Hopkins155 benchmark (Tron and Vidal 2007) and of Table 1 of Xu, Cheong and
    Li (2018): 1 - sum_i n[i, a(i)] / n. Groups beyond the number of motions are wrong as a whole,
    motions without a group likewise, and so are trajectories predicted 0.

    Examples
    --------
    Motions of 3 and 3 trajectories; group 1 holds two of the first, group 2 one of the first and
    two of the second, one of the second is an outlier: wrong are 1 + 1 of 6.

    >>> round(classification_error(contingency([1, 1, 1, 2, 2, 2], [1, 1, 2, 2, 2, 0])), 4)
    0.3333
    """
    return (table.n - int(table.shared(table.assignment)[0].sum())) / table.n


def adjusted_rand(table: Contingency) -> float:
    """Measure agreement on pairs of trajectories, 0 by chance, 1 when perfect.

    The adjusted Rand index (A - E) / (m - E) with A the pairs together in both partitions, m the
    mean number of pairs together in one, and E = (pairs in truth)(pairs in prediction) / (all
    pairs) (Hubert and Arabie 1985). Trajectories predicted 0 form one group.

    Examples
    --------
    A = 1 (first two), pairs in truth 1 + 1 = 2, in prediction 1, all 6: E = 1/3, m = 1.5,
    (1 - 1/3) / (1.5 - 1/3) = 4/7.

    >>> round(adjusted_rand(contingency([1, 1, 2, 2], [1, 1, 2, 3])), 4)
    0.5714
    """
    counts = table.with_outliers.astype(np.float64)
    together = _pairs(counts)
    truth, pred = _pairs(counts.sum(axis=1)), _pairs(counts.sum(axis=0))
    every = _pairs(np.array([counts.sum()]))
    if truth == pred == together:
        return 1.0
    expected = truth * pred / every
    return float((together - expected) / ((truth + pred) / 2 - expected))


def normalised_mutual_information(table: Contingency) -> float:
    """Mutual information over the arithmetic mean of the two entropies, 0..1.

    2 I(T; P) / (H(T) + H(P)) (Strehl and Ghosh 2002, with the arithmetic mean). Trajectories
    predicted 0 form one group. Two one-group partitions agree: 1.

    Examples
    --------
    H(T) = log 2; P splits the second motion: H(P) = 1.5 log 2; I = log 2; 2 / 2.5 = 0.8.

    >>> round(normalised_mutual_information(contingency([1, 1, 2, 2], [1, 1, 2, 3])), 4)
    0.8
    """
    joint = table.with_outliers / table.n
    truth, pred = _entropy(joint.sum(axis=1)), _entropy(joint.sum(axis=0))
    if truth + pred == 0:
        return 1.0
    shared = max(0.0, truth + pred - _entropy(joint.ravel()))
    return float(min(1.0, 2 * shared / (truth + pred)))


def over_segmentation(table: Contingency) -> float:
    """Fraction of trajectories outside their motion's largest group: motions cut in pieces.

    1 - sum_i max_j n[i, j] / n; trajectories predicted 0 form one group.

    Examples
    --------
    The second motion is cut 1 + 1, one of its two is outside the larger piece: 1 of 4.

    >>> over_segmentation(contingency([1, 1, 2, 2], [1, 1, 2, 3]))
    0.25
    """
    return (table.n - int(table.with_outliers.max(axis=1).sum())) / table.n


def under_segmentation(table: Contingency) -> float:
    """Fraction of trajectories outside their group's largest motion: motions merged.

    1 - sum_j max_i n[i, j] / n (one minus the purity); trajectories predicted 0 form one group.

    Examples
    --------
    One group for motions of 3 and 1: the one of the second is swallowed.

    >>> under_segmentation(contingency([1, 1, 1, 2], [1, 1, 1, 1]))
    0.25
    """
    return (table.n - int(table.with_outliers.max(axis=0).sum())) / table.n


def motion_count_error(table: Contingency) -> float:
    """Absolute difference between the number of groups found and the number of motions.

    Trajectories predicted 0 are no group.

    Examples
    --------
    >>> motion_count_error(contingency([1, 1, 2, 2], [1, 2, 3, 4]))
    2.0
    """
    return float(abs(len(table.groups) - len(table.motions)))


def _pairs(counts: FloatArray) -> float:
    return float((counts * (counts - 1) / 2).sum())


def _entropy(share: FloatArray) -> float:
    positive = share[share > 0]
    return float(-(positive * np.log(positive)).sum())


# --- motion by motion, under the assignment that gives the classification error ----------------


def per_motion(table: Contingency, assignment: IntArray | None = None) -> dict[str, FloatArray]:
    """Scores of each motion against its assigned group, (M,) each; 0 without a group.

    Precision is the share of the group that belongs to the motion, recall the share of the motion
    that is in the group, F their harmonic mean 2 |m & g| / (|m| + |g|), IoU |m & g| / |m or g|.

    Examples
    --------
    Group 2 holds one of motion 1 and both of motion 2.

    >>> scores = per_motion(contingency([1, 1, 2, 2], [1, 2, 2, 2]))
    >>> {name: values.round(4).tolist() for name, values in scores.items()}
    {'precision': [1.0, 0.6667], 'recall': [0.5, 1.0], 'f_measure': [0.6667, 0.8], 'iou': [0.5, 0.6667]}
    """
    shared, size = table.shared(table.assignment if assignment is None else assignment)
    both = table.sizes + size
    return {
        "precision": shared / np.maximum(size, 1),
        "recall": shared / table.sizes,
        "f_measure": 2 * shared / both,
        "iou": shared / (both - shared),
    }


def moving_error(table: Contingency) -> float:
    """Fraction of trajectories wrong when only background and moving are distinguished.

    The group assigned to the background is "background", every other group and label 0 is
    "moving". Without a known background, the largest motion takes its place.

    Examples
    --------
    Background 1, objects 2 and 3 swapped in part: that is no error here, the lost background is.

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

    >>> moving_f(contingency([1, 1, 1, 1, 2, 3], [1, 1, 1, 2, 2, 2], background=1))
    0.8
    """
    hit, false, missed = _moving(table)
    return 2 * hit / (2 * hit + false + missed) if hit + false + missed else 1.0


def _moving(table: Contingency) -> tuple[int, int, int]:
    """Count moving called moving, background called moving, moving called background."""
    row = table.static
    kept, called = (int(numbers[row]) for numbers in table.shared(table.assignment))
    size = int(table.sizes[row])
    return table.n - size - (called - kept), size - kept, called - kept


# --- regions, as the FBMS-59 benchmark counts them ---------------------------------------------


def region_scores(table: Contingency) -> dict[str, FloatArray]:
    """Precision, recall and F-measure of each motion as a region, (M,) each; 0 without a group.

    Groups are assigned one-to-one so that the sum of F-measures is largest, not the sum of
    trajectories, so that small objects weigh as much as large ones (Ochs, Malik and Brox, PAMI
    2014, section 5; here over trajectories instead of pixels).

    Examples
    --------
    F of (motion, group): (1, 1) 4/5, (1, 2) 2/5, (2, 1) 0, (2, 2) 2/3; the sum is largest for 1-1, 2-2.

    >>> scores = region_scores(contingency([1, 1, 1, 2], [1, 1, 2, 2]))
    >>> {name: values.round(4).tolist() for name, values in scores.items()}
    {'precision': [1.0, 0.5], 'recall': [0.6667, 1.0], 'f_measure': [0.8, 0.6667]}
    """
    f = 2 * table.counts / (table.sizes[:, None] + table.counts.sum(axis=0))
    scores = per_motion(table, assign(f))
    return {name: scores[name] for name in ("precision", "recall", "f_measure")}


def region_f(table: Contingency) -> float:
    """Harmonic mean of the precision and the recall of regions, each averaged over the true regions.

    Examples
    --------
    Precisions 1 and 1/2, recalls 2/3 and 1: 2 * 0.75 * 0.8333 / (0.75 + 0.8333).

    >>> round(region_f(contingency([1, 1, 1, 2], [1, 1, 2, 2])), 4)
    0.7895
    """
    scores = region_scores(table)
    p, r = float(scores["precision"].mean()), float(scores["recall"].mean())
    return 2 * p * r / (p + r) if p + r else 0.0


def objects_found(table: Contingency) -> float:
    """Count the moving objects (motions but the background) whose F-measure as regions is at least 0.75.

    Without a known background, the largest motion takes its place.

    Examples
    --------
    Motion 2 has F = 1, motion 3 has F = 2/3: one object.

    >>> objects_found(contingency([1, 1, 1, 2, 3, 3], [1, 1, 1, 2, 3, 0], background=1))
    1.0
    """
    return float((np.delete(region_scores(table)["f_measure"], table.static) >= _OBJECT_F).sum())


# --- their names and what tables must know about them -------------------------------------------


def _mean(
    scores: Callable[[Contingency], Mapping[str, FloatArray]], name: str
) -> Callable[[Contingency], float]:
    """Average one of the scores of each motion over the motions."""

    def mean(table: Contingency) -> float:
        return float(scores(table)[name].mean())

    mean.__doc__ = scores.__doc__
    return mean


def _always(value: float) -> Callable[[int], float]:
    return lambda n_motions: value


_ONE, _ZERO = _always(1.0), _always(0.0)
_BELOW_CHANCE = _always(-0.5)  # the lower bound of the adjusted Rand index (Chacon and Rastrojo 2023)
METRICS = {
    "error": Metric(classification_error, "error", "lower", _ONE),
    "adjusted_rand": Metric(adjusted_rand, "adj. Rand", "higher", _BELOW_CHANCE),
    "nmi": Metric(normalised_mutual_information, "NMI", "higher", _ZERO),
    "precision": Metric(_mean(per_motion, "precision"), "precision", "higher", _ZERO),
    "recall": Metric(_mean(per_motion, "recall"), "recall", "higher", _ZERO),
    "f_measure": Metric(_mean(per_motion, "f_measure"), "F", "higher", _ZERO),
    "iou": Metric(_mean(per_motion, "iou"), "IoU", "higher", _ZERO),
    "moving_error": Metric(moving_error, "moving error", "lower", _ONE),
    "moving_f": Metric(moving_f, "moving F", "higher", _ZERO),
    "over_segmentation": Metric(over_segmentation, "over-seg.", "lower", _ONE),
    "under_segmentation": Metric(under_segmentation, "under-seg.", "lower", _ONE),
    "count_error": Metric(motion_count_error, "count error", "lower", float, percent=False),
    "region_precision": Metric(_mean(region_scores, "precision"), "region P", "higher", _ZERO),
    "region_recall": Metric(_mean(region_scores, "recall"), "region R", "higher", _ZERO),
    "region_f": Metric(region_f, "region F", "higher", _ZERO),
    "objects": Metric(objects_found, "objects F>=.75", "higher", _ZERO, percent=False),
}
"""Our own; a third party's is behind an entry point of the group ``mseg.metrics``."""


@cache
def all_metrics() -> dict[str, Metric]:
    """Every metric by name, third parties' included."""
    others = {each.name: each for each in entry_points(group="mseg.metrics")}
    return METRICS | {name: each.load() for name, each in others.items() if name not in METRICS}


def evaluate(table: Contingency) -> dict[str, float]:
    """Compute every metric of a clip, by name.

    Examples
    --------
    >>> evaluate(contingency([1, 1, 1, 2], [5, 5, 9, 9]))["error"]
    0.25
    """
    return {name: metric(table) for name, metric in all_metrics().items()}
