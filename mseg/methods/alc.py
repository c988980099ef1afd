"""Agglomerative lossy compression (ALC)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import FloatArray, IntArray
from mseg.clustering.lossy import coding_lengths, compress
from mseg.geometry.subspaces import project
from mseg.methods.complete_data import CompleteData, CompleteDataMethod

_LARGEST_OUTLIER_GROUP = 4


@dataclass(frozen=True)
class ALC(CompleteDataMethod):
    """Group trajectories so that coding them group by group takes fewest bits.

    1. The trajectory matrix in pixels is projected on its d leading left singular vectors: d = 5, or the
       least d >= 8 log2(2F / d) that preserves sparsity ("ALC_sp").
    2. For each distortion epsilon of a grid, groups merge greedily from single points while that shortens
       the code (`mseg.clustering.lossy`).
    3. A group of more than 4 points is a motion; the others together are outliers. Candidates are the
       distinct segmentations with exactly K motions. At every epsilon that did not end in one group, the
       candidate with the shortest code there gets a vote; most votes win, the first of equals.

    Where no segmentation has K motions, those with the nearest number stand in, the larger of two; surplus
    motions, the smallest, become outliers. This is ours (the authors' code returns about N groups then) and
    is reported as ``exact_count: False``.

    Source: Rao, Tron, Vidal, Ma, "Motion segmentation in the presence of outlying, incomplete, or corrupted
    trajectories", TPAMI 2010; Ma, Derksen, Hong, Wright, TPAMI 2007. The grid, 101 distortions from 1e-5 to
    1e3, is that of the authors' code.
    Input: complete trajectories (gaps are completed; ``completion="rpca"`` also repairs gross errors).
    Number of motions: given; the authors' penalised length for an unknown number keeps tiny groups and is
    left out. Outliers: labelled 0. Cost: a grid of O(N^2 d^2 + N G d^3), G groups; O(N^2) memory.
    """

    deterministic: ClassVar[bool] = True

    dimension: int = option(0, "dimension d of the projection; 0 = sparsity-preserving", low=0)
    distortions: int = option(101, "number of distortions, evenly in their logarithm", low=1)
    smallest_distortion: float = option(1e-5, "least distortion, pixels", low=1e-12)
    largest_distortion: float = option(1e3, "greatest distortion, pixels", low=1e-12)

    def group(
        self, data: CompleteData, n_motions: int | None, rng: np.random.Generator
    ) -> tuple[IntArray, dict[str, Any]]:
        """Label the columns of the trajectory matrix."""
        assert n_motions is not None
        points = project(data.pixels, self.dimension or sparsity_preserving_dimension(len(data.pixels)))
        grid = np.geomspace(self.smallest_distortion, self.largest_distortion, self.distortions)
        found = [compress(points, float(distortion)) for distortion in grid]
        labels, report = elect(points, grid, found, n_motions)
        return labels, {"dimension": len(points), **report}


def sparsity_preserving_dimension(rows: int) -> int:
    """Return the least d >= 8 log2(rows / d): random sparse structure survives a projection to it."""
    return next(d for d in range(1, rows + 1) if d >= 8 * np.log2(rows / d))


def motions_and_outliers(groups: IntArray) -> IntArray:
    """Keep the labels of groups of more than 4 points; the others become 0."""
    large = int((np.bincount(groups)[1:] > _LARGEST_OUTLIER_GROUP).sum())
    return np.where(groups <= large, groups, 0)


def elect(
    points: FloatArray, grid: FloatArray, found: Sequence[IntArray], n_motions: int
) -> tuple[IntArray, dict[str, Any]]:
    """Choose among the segmentations of all distortions by votes; see `ALC`, step 3.

    Parameters
    ----------
    points : (d, N) float64
        Projected trajectories.
    grid : (E,) float64
        Distortions.
    found : sequence of E (N,) int64
        Groups 1, 2, ... found at each, the largest first.
    n_motions : int
        Number K of motions wanted.

    Returns
    -------
    labels : (N,) int64
        0 = outlier.
    report : dict
        Votes, number of candidates and whether they have K motions.
    """
    large = np.array([motions_and_outliers(groups) for groups in found])
    counts = large.max(axis=1)
    nearest = min(set(counts.tolist()), key=lambda count: (abs(count - n_motions), -count))
    candidates = np.unique(large[counts == nearest], axis=0)
    voters = grid[[groups.max() > 1 for groups in found]]
    lengths = np.array([coding_lengths(points, candidate, voters) for candidate in candidates])
    votes = np.bincount(lengths.argmin(axis=0), minlength=len(candidates))
    winner = candidates[votes.argmax()]
    labels = np.where(winner <= n_motions, winner, 0)
    return labels, {
        "candidates": len(candidates),
        "votes": int(votes.max()),
        "exact_count": bool(nearest == n_motions),
    }
