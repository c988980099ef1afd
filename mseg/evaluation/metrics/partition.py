"""Metrics that compare the two partitions as wholes."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import FloatArray
from mseg.evaluation.contingency import Contingency


def classification_error(table: Contingency) -> float:
    """Fraction of trajectories that are wrong under the best one-to-one assignment.

    The error of the Hopkins155 benchmark (Tron and Vidal 2007) and of Table 1 of Xu, Cheong and
    Li (2018): 1 - sum_i n[i, a(i)] / n. Groups beyond the number of motions are wrong as a whole,
    motions without a group likewise, and so are trajectories predicted 0.

    Examples
    --------
    Motions of 3 and 3 trajectories; group 1 holds two of the first, group 2 one of the first and
    two of the second, one of the second is an outlier: wrong are 1 + 1 of 6.

    >>> from mseg.evaluation.contingency import contingency
    >>> round(classification_error(contingency([1, 1, 1, 2, 2, 2], [1, 1, 2, 2, 2, 0])), 4)
    0.3333
    """
    return (table.n - int(table.matched.sum())) / table.n


def adjusted_rand(table: Contingency) -> float:
    """Measure agreement on pairs of trajectories, 0 by chance, 1 when perfect.

    The adjusted Rand index (A - E) / (m - E) with A the pairs together in both partitions, m the
    mean number of pairs together in one, and E = (pairs in truth)(pairs in prediction) / (all
    pairs) (Hubert and Arabie 1985). Trajectories predicted 0 form one group.

    Examples
    --------
    A = 1 (first two), pairs in truth 1 + 1 = 2, in prediction 1, all 6: E = 1/3, m = 1.5,
    (1 - 1/3) / (1.5 - 1/3) = 4/7.

    >>> from mseg.evaluation.contingency import contingency
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

    >>> from mseg.evaluation.contingency import contingency
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

    >>> from mseg.evaluation.contingency import contingency
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

    >>> from mseg.evaluation.contingency import contingency
    >>> under_segmentation(contingency([1, 1, 1, 2], [1, 1, 1, 1]))
    0.25
    """
    return (table.n - int(table.with_outliers.max(axis=0).sum())) / table.n


def motion_count_error(table: Contingency) -> float:
    """Absolute difference between the number of groups found and the number of motions.

    Trajectories predicted 0 are no group.

    Examples
    --------
    >>> from mseg.evaluation.contingency import contingency
    >>> motion_count_error(contingency([1, 1, 2, 2], [1, 2, 3, 4]))
    2.0
    """
    return float(abs(len(table.groups) - len(table.motions)))


def _pairs(counts: FloatArray) -> float:
    return float((counts * (counts - 1) / 2).sum())


def _entropy(share: FloatArray) -> float:
    positive = share[share > 0]
    return float(-(positive * np.log(positive)).sum())
