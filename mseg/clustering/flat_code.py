"""How short a code describes points that lie, group by group, near flats."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import BoolArray, FloatArray, IntArray
from mseg.iteration import Convergence, iterate

# Pixels: no spread under this is told from none.
_PRECISION = 0.1


def code_length(points: FloatArray, labels: IntArray, flat: int) -> float:
    """Nats that describe points, each group as a Gaussian along and across its own flat.

    A group of n of the N points, with principal variances ``s_1 >= s_2 >= ...``, takes

        n (1/2 sum_{i <= flat} log s_i + 1/2 log sum_{i > flat} s_i - log(n / N))

    up to a constant: coordinates along the flat, distance from it, name of the group. To the variances 0.01
    square pixels are added. A group too small to leave its flat (n < flat + 2) takes nothing.

    Parameters
    ----------
    points : (N, D) float64
        Points as rows, pixels.
    labels : (N,) int64
        Groups 1, 2, ...; 0 takes no part.
    flat : int
        Dimension of the flats.
    """
    groups = [points[labels == k] for k in range(1, int(labels.max(initial=0)) + 1)]
    return sum(_nats(group, flat, len(points)) for group in groups)


def reassign_by_code(
    points: FloatArray, labels: IntArray, flat: int, sweeps: int
) -> tuple[IntArray, Convergence]:
    """Give every point to the group whose code for it is shortest, again and again until nothing changes.

    Parameters
    ----------
    points : (N, D) float64
        Points as rows, pixels.
    labels : (N,) int64
        Groups 1..K, 0 of points without one. Groups of fewer than ``flat + 2`` points receive none.
    flat : int
        Dimension of the flats.
    sweeps : int
        Cap on repetitions.

    Returns
    -------
    labels : (N,) int64
        Labels 1..K; as given where no group is large enough.
    convergence : Convergence
        Of the share of points that moved.
    """
    groups = int(labels.max(initial=0))

    def step() -> float:
        nonlocal labels
        length = np.array([_lengths(points, labels == k, flat) for k in range(1, groups + 1)])
        if not np.isfinite(length).any():
            return 0.0
        before, labels = labels, length.argmin(axis=0) + 1
        return float((before != labels).mean())

    convergence = iterate(step, tolerance=0.0, max_iterations=sweeps)
    return labels, convergence


def _lengths(points: FloatArray, members: BoolArray, flat: int) -> FloatArray:
    """Nats (N,) of every point as a member of a group."""
    group = points[members]
    if len(group) < flat + 2:
        return np.full(len(points), np.inf)
    along, across, axes = _spreads(group, flat)
    squares = ((points - group.mean(axis=0)) @ axes) ** 2
    nats = (squares[:, :flat] / along + np.log(along)).sum(axis=1)
    nats += squares[:, flat:].sum(axis=1) / across + np.log(across)
    return np.asarray(nats / 2 - np.log(len(group) / len(points)))


def _nats(group: FloatArray, flat: int, total: int) -> float:
    n = len(group)
    if n < flat + 2:
        return 0.0
    along, across, _ = _spreads(group, flat)
    return n * float((np.log(along).sum() + np.log(across)) / 2 - np.log(n / total))


def _spreads(group: FloatArray, flat: int) -> tuple[FloatArray, float, FloatArray]:
    """Variances (flat,) along and across a group's flat, and its axes (D, D) as columns, the widest first."""
    variances, axes = np.linalg.eigh(np.atleast_2d(np.cov(group.T, bias=True)))
    variances = np.maximum(variances[::-1], 0)
    precision = _PRECISION**2
    return variances[:flat] + precision, float(variances[flat:].sum()) + precision, axes[:, ::-1]
