"""The metrics: pure functions of a contingency table, with worked examples.

`evaluate` computes all of them. A third party's metric is a `Metric` behind an entry point of the
group ``mseg.metrics``.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, lru_cache, wraps
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

import numpy as np

from kt3dmoseg.errors import InvalidValueError, KT3DMoSegError
from kt3dmoseg.registry import not_loaded
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

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and largest possible value of a clip."""
        return min(0.0, self.worst(1)), 1.0 if self.percent else np.inf

    def show(self, value: float) -> str:
        """Give a value as tables print it."""
        return f"{self.scale * value:.2f}"


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


@lru_cache(maxsize=1)
def partitions(table: Contingency) -> dict[str, float]:
    """Compare the two partitions as wholes; trajectories predicted 0 form one group.

    * The adjusted Rand index (A - E) / (m - E), with A the pairs together in both partitions, m the mean
      number of pairs together in one, and E = (pairs in truth)(pairs in prediction) / (all pairs) (Hubert
      and Arabie 1985): 0 by chance, 1 when perfect.
    * The normalised mutual information 2 I(T; P) / (H(T) + H(P)) (Strehl and Ghosh 2002, with the
      arithmetic mean). Two one-group partitions agree: 1.
    * Over-segmentation 1 - sum_i max_j n[i, j] / n: trajectories outside their motion's largest group.
    * Under-segmentation 1 - sum_j max_i n[i, j] / n (one minus the purity): motions merged.
    * The absolute difference between the numbers of groups and motions; here 0 is no group.

    Examples
    --------
    Rand: A = 1 (first two), pairs in truth 1 + 1 = 2, in prediction 1, all 6: E = 1/3, m = 1.5, (1 - 1/3) /
    (1.5 - 1/3) = 4/7. H(T) = log 2, P splits the second motion: H(P) = 1.5 log 2, I = log 2: 2 / 2.5 = 0.8.
    One of the second motion is outside its larger piece: 1 of 4.

    >>> scores = partitions(contingency([1, 1, 2, 2], [1, 1, 2, 3]))
    >>> {name: round(value, 4) for name, value in scores.items()}
    {'adjusted_rand': 0.5714, 'nmi': 0.8, 'over': 0.25, 'under': 0.0, 'count': 1.0}
    """
    counts, n = table.counts, table.n
    if table.unassigned.any():  # one more group
        counts = np.column_stack([counts, table.unassigned])
    motions, groups = counts.sum(axis=1), counts.sum(axis=0)
    together, truth, pred, every = (_pairs(each) for each in (counts, motions, groups, counts.sum()))
    expected = truth * pred / every if every else 0.0
    same = truth == pred == together
    rand = 1.0 if same else (together - expected) / ((truth + pred) / 2 - expected)
    joint = counts / n
    both = _entropy(joint.sum(axis=1)) + _entropy(joint.sum(axis=0))
    return {
        "adjusted_rand": float(rand),
        "nmi": float(min(1.0, 2 * max(0.0, both - _entropy(joint)) / both)) if both else 1.0,
        "over": (n - int(counts.max(axis=1).sum())) / n,
        "under": (n - int(counts.max(axis=0).sum())) / n,
        "count": float(abs(len(table.groups) - len(table.motions))),
    }


def _pairs(counts: IntArray) -> float:
    return float((counts * (counts - 1.0) / 2).sum())


def _entropy(share: FloatArray) -> float:
    positive = share[share > 0]
    return float(-(positive * np.log(positive)).sum())


@lru_cache(maxsize=1)
def per_motion(table: Contingency) -> dict[str, FloatArray]:
    """Scores of each motion against its assigned group, (M,) each; 0 without a group.

    Precision is the share of the group that belongs to the motion, recall the share of the motion
    that is in the group, F their harmonic mean ``2 |m & g| / (|m| + |g|)``, IoU ``|m & g| / |m or g|``.

    Examples
    --------
    Group 2 holds one of motion 1 and both of motion 2.

    >>> scores = per_motion(contingency([1, 1, 2, 2], [1, 2, 2, 2]))
    >>> {name: values.round(4).tolist() for name, values in scores.items()}
    {'precision': [1.0, 0.6667], 'recall': [0.5, 1.0], 'f_measure': [0.6667, 0.8], 'iou': [0.5, 0.6667]}
    """
    return _motion_scores(table, table.assignment)


def _motion_scores(table: Contingency, assignment: IntArray) -> dict[str, FloatArray]:
    shared, size = table.shared(assignment)
    both = table.sizes + size
    return {
        "precision": shared / np.maximum(size, 1),
        "recall": shared / table.sizes,
        "f_measure": 2 * shared / both,
        "iou": shared / (both - shared),
    }


def moving_scores(table: Contingency) -> dict[str, float]:
    """Distinguish background and moving only: fraction of wrong trajectories, F-measure of "moving".

    The group assigned to the background is "background", every other group and label 0 is
    "moving". Without a known background, the largest motion takes its place.

    Examples
    --------
    Objects 2 and 3 swapped in part are no error here, the lost background is: 1 of 6. Three are called
    moving, two of them are, none is missed: 2 * 2 / (2 * 2 + 1).

    >>> scores = moving_scores(contingency([1, 1, 1, 1, 2, 3], [1, 1, 1, 2, 2, 2], background=1))
    >>> {name: round(value, 4) for name, value in scores.items()}
    {'error': 0.1667, 'f': 0.8}
    """
    row = table.static
    kept, called = (int(numbers[row]) for numbers in table.shared(table.assignment))
    size = int(table.sizes[row])
    wrong, hit = (size - kept) + (called - kept), table.n - size - (called - kept)
    return {"error": wrong / table.n, "f": 2 * hit / (2 * hit + wrong) if hit + wrong else 1.0}


@lru_cache(maxsize=1)
def region_scores(table: Contingency) -> dict[str, float]:
    """Precision and recall over the true motions as regions, their harmonic mean, and the objects found.

    Groups are assigned one-to-one so that the sum of F-measures is largest, not the sum of
    trajectories, so that small objects weigh as much as large ones (Ochs, Malik and Brox, PAMI
    2014, section 5; here over trajectories instead of pixels). An object is a motion but the background
    (without a known one, the largest); it is found when its F-measure is at least 0.75.

    Examples
    --------
    F of (motion, group): (1, 1) 4/5, (1, 2) 2/5, (2, 1) 0, (2, 2) 2/3; the sum is largest for 1-1, 2-2.
    Precisions 1 and 1/2, recalls 2/3 and 1: 2 * 0.75 * 0.8333 / (0.75 + 0.8333).

    >>> scores = region_scores(contingency([1, 1, 1, 2], [1, 1, 2, 2]))
    >>> {name: round(value, 4) for name, value in scores.items()}
    {'precision': 0.75, 'recall': 0.8333, 'f': 0.7895, 'objects': 0.0}
    """
    gain = 2 * table.counts / (table.sizes[:, None] + table.counts.sum(axis=0))
    scores = _motion_scores(table, assign(gain))
    precision, recall = float(scores["precision"].mean()), float(scores["recall"].mean())
    return {
        "precision": precision,
        "recall": recall,
        "f": 2 * precision * recall / (precision + recall) if precision + recall else 0.0,
        "objects": float((np.delete(scores["f_measure"], table.static) >= _OBJECT_F).sum()),
    }


def _part(
    scores: Callable[[Contingency], Mapping[str, FloatArray | float]], name: str
) -> Callable[[Contingency], float]:
    """One of several scores; of those of each motion, the mean over motions."""

    def part(table: Contingency) -> float:
        return float(np.mean(scores(table)[name]))

    part.__doc__ = scores.__doc__
    return part


def _always(value: float) -> Callable[[int], float]:
    return lambda n_motions: value


_ONE, _ZERO = _always(1.0), _always(0.0)
_BELOW = _always(-0.5)  # the lower bound of the adjusted Rand index (Chacon and Rastrojo 2023)
METRICS = {
    "error": Metric(classification_error, "error", "lower", _ONE),
    "adjusted_rand": Metric(_part(partitions, "adjusted_rand"), "adj. Rand", "higher", _BELOW),
    "nmi": Metric(_part(partitions, "nmi"), "NMI", "higher", _ZERO),
    "precision": Metric(_part(per_motion, "precision"), "precision", "higher", _ZERO),
    "recall": Metric(_part(per_motion, "recall"), "recall", "higher", _ZERO),
    "f_measure": Metric(_part(per_motion, "f_measure"), "F", "higher", _ZERO),
    "iou": Metric(_part(per_motion, "iou"), "IoU", "higher", _ZERO),
    "moving_error": Metric(_part(moving_scores, "error"), "moving error", "lower", _ONE),
    "moving_f": Metric(_part(moving_scores, "f"), "moving F", "higher", _ZERO),
    "over_segmentation": Metric(_part(partitions, "over"), "over-seg.", "lower", _ONE),
    "under_segmentation": Metric(_part(partitions, "under"), "under-seg.", "lower", _ONE),
    "count_error": Metric(_part(partitions, "count"), "count error", "lower", float, percent=False),
    "region_precision": Metric(_part(region_scores, "precision"), "region P", "higher", _ZERO),
    "region_recall": Metric(_part(region_scores, "recall"), "region R", "higher", _ZERO),
    "region_f": Metric(_part(region_scores, "f"), "region F", "higher", _ZERO),
    "objects": Metric(_part(region_scores, "objects"), "objects F>=.75", "higher", _ZERO, percent=False),
}
"""Our own; a third party's is behind an entry point of the group ``mseg.metrics``."""


@cache
def all_metrics() -> dict[str, Metric]:
    """Every metric by name, third parties' included; a KT3DMoSegError for one of them that is of no use."""
    others = {each.name: each for each in entry_points(group="mseg.metrics")}
    return METRICS | {name: _load(each) for name, each in others.items() if name not in METRICS}


def _load(point: EntryPoint) -> Metric:
    """Import a third party's metric; whatever it raises when it is computed names it and its package."""
    where = f"metric {point.name!r} of the package {point.dist.name if point.dist else 'unknown'}"
    try:
        metric = point.load()
    except Exception as error:  # a third party's module may raise anything
        raise not_loaded(where, point.value, error) from error
    if not isinstance(metric, Metric):
        found, fix = f"{metric!r:.200}", "repair or uninstall the package"
        raise InvalidValueError(where, expected="a mseg.evaluation.metrics.Metric", found=found, fix=fix)
    function, worst = (_guarded(call, where) for call in (metric.function, metric.worst))
    return replace(metric, function=function, worst=worst)


def _guarded(call: Callable[[Any], float], where: str) -> Callable[[Any], float]:
    @wraps(call)
    def guarded(given: Any) -> float:  # noqa: ANN401
        try:
            return float(call(given))
        except Exception as error:
            found, fix = f"{type(error).__name__}: {error}", "repair or uninstall the package"
            raise KT3DMoSegError(where, expected="a number", found=found, fix=fix) from error

    return guarded


def evaluate(table: Contingency) -> dict[str, float]:
    """Compute every metric of a clip, by name.

    Examples
    --------
    >>> evaluate(contingency([1, 1, 1, 2], [5, 5, 9, 9]))["error"]
    0.25
    """
    return {name: metric(table) for name, metric in all_metrics().items()}
