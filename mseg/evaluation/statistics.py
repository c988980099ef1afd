"""Statistics over clips and seeds: bootstrap intervals, paired tests, correction for many tests."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from kt3dmoseg.types import FloatArray, IntArray

_RESAMPLES = 4000


class Interval(NamedTuple):
    """A confidence interval."""

    low: float
    high: float


@dataclass(frozen=True)
class Summary:
    """One metric over the clips of a group; mean and median are of the means over seeds."""

    mean: float
    median: float
    pooled: float  # mean weighted by scored trajectories; of the error: that of all trajectories together
    seed_sd: float | None  # standard deviation over seeds of the mean over clips; None with one seed
    interval: Interval  # 95 % bootstrap interval of the mean over clips


def summarise(values: FloatArray, weights: Sequence[int] | None = None) -> Summary:
    """Summarise a metric (clips, seeds); `pooled` is the mean weighted by trajectories of each clip."""
    means = values.mean(axis=1)
    return Summary(
        float(means.mean()),
        float(np.median(means)),
        float(np.average(means, weights=weights)),
        standard_deviation(values.mean(axis=0)),
        bootstrap_mean(means),
    )


def bootstrap_mean(values: FloatArray) -> Interval:
    """95 % percentile bootstrap interval of the mean of (n,) values (Efron 1979), always the same.

    >>> bootstrap_mean(np.array([0.2, 0.2, 0.2]))
    Interval(low=0.2, high=0.2)
    """
    means = values[_resamples(len(values))].mean(axis=1)
    low, high = np.quantile(means, [(1 - 0.95) / 2, (1 + 0.95) / 2])
    return Interval(round(float(low), 12), round(float(high), 12))


@lru_cache(maxsize=4)
def _resamples(n: int) -> IntArray:
    return np.random.default_rng(0).integers(0, n, size=(_RESAMPLES, n))


def signed_ranks(differences: FloatArray) -> IntArray:
    """Twice the rank of each difference by size, with its sign; equal sizes share their mean rank.

    Differences of zero are dropped.
    """
    nonzero = np.round(differences, 12)
    nonzero = nonzero[nonzero != 0]
    _, place, counts = np.unique(np.abs(nonzero), return_inverse=True, return_counts=True)
    ranks = (2 * np.cumsum(counts) - counts + 1)[place]  # twice the mean rank: whole numbers
    return np.where(nonzero > 0, ranks, -ranks)


def wilcoxon_p(differences: FloatArray) -> float:
    """Two-sided p-value of the Wilcoxon signed-rank test on paired differences (n,).

    Differences of zero are dropped; without any other, p = 1. The distribution is exact, given the
    ranks: every pattern of signs is as likely, equal sizes share their mean rank (Wilcoxon 1945).
    Of five differences of one sign, 2 of the 32 patterns of signs are as extreme:

    >>> wilcoxon_p(np.array([1.0, 2.0, 3.0, 4.0, 5.0]))
    0.0625
    """
    signed, share = signed_ranks(differences), np.ones(1)
    for rank in np.abs(signed):  # distribution of the sum of the positive ranks, one sign after the other
        share = np.pad(share / 2, (0, rank)) + np.pad(share / 2, (rank, 0))
    tail = min(int(signed[signed > 0].sum()), -int(signed[signed < 0].sum()))
    return float(min(1.0, 2 * share[: tail + 1].sum()))


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjust p-values for several tests (Holm 1979).

    The k-th smallest of m is multiplied by m - k + 1, and never falls below the one before: here 0.01 * 3,
    0.02 * 2, and 0.03 * 1 lifted to 0.04.

    >>> [round(p, 4) for p in holm([0.03, 0.01, 0.02])]
    [0.04, 0.03, 0.04]
    """
    p = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(p, kind="stable")
    scaled = np.minimum(1.0, p[order] * np.arange(len(p), 0, -1))
    adjusted = np.maximum.accumulate(scaled)[np.argsort(order)]
    return [float(value) for value in adjusted]


def standard_deviation(values: FloatArray) -> float | None:
    """Sample standard deviation; None for fewer than two values."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else None
