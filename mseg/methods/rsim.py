"""Robust shape interaction matrix (RSIM)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.linalg import eigvalsh

from kt3dmoseg.options import option
from kt3dmoseg.types import FloatArray, IntArray
from mseg.clustering import unit_rows
from mseg.clustering.coefficient_affinity import relative_eigengaps
from mseg.clustering.discretise import discretise, offset_ncut_embedding
from mseg.geometry.subspaces import leading_row_space
from mseg.methods.complete_data import CompleteData, CompleteDataMethod

_NEGLIGIBLE = 1e-6


@dataclass(frozen=True)
class RSIM(CompleteDataMethod):
    """Shape interaction matrix, row-normalised, raised to a power, at the rank that cuts best.

    For every rank r = K..4K: rows of the r leading right singular vectors of X (normalised coordinates with
    ones) at unit length, ``Z = V V^T``, affinity ``W = max(Z, 0)^power``, normalised cuts into K groups. The
    rank wins whose segmentation has the least

        score_r = sum_k cut(group k, rest) / (lambda_K - lambda_{K+1}),

    lambda the eigenvalues of ``D^-1 W``, largest first.

    Source: Ji, Salzmann, Li, "Shape interaction matrix revisited and robustified", ICCV 2015, algorithm 1
    and equation 12; power 3.5 and the ranks are those of the authors' code. Deviation: their discretisation
    starts from one random row, so that single sequences flip with the seed; here the best of several starts
    counts.
    Input: complete trajectories (gaps are completed; the authors use GROUSE there). Number of motions:
    given, or by relative eigengaps averaged over the ranks (ours). Outliers:
    not handled. Cost: O(K N^3); O(N^2) memory.
    """

    finds_n_motions: ClassVar[bool] = True

    power: float = option(3.5, "exponent of the affinity", low=1)
    starts: int = option(10, "starts of the discretisation", low=1)

    def group(
        self, data: CompleteData, n_motions: int | None, rng: np.random.Generator
    ) -> tuple[IntArray, dict[str, Any]]:
        """Label the columns of the trajectory matrix."""
        matrix = homogeneous_in_every_frame(data)
        k = n_motions or count_motions(matrix, self.power)
        space = leading_row_space(matrix, 4 * k)
        ranks = range(min(k, space.shape[1]), space.shape[1] + 1)
        found, scores = [], []
        for rank in ranks:
            affinity = shape_interaction_affinity(space[:, :rank], self.power)
            found.append(discretise(offset_ncut_embedding(affinity, k), rng, n_starts=self.starts))
            scores.append(cut_over_gap(affinity, found[-1].labels, k))
        best = int(np.argmin(scores))
        report = {"rank": ranks[best], "score": scores[best], "n_motions": k}
        return found[best].labels + 1, report | found[best].convergence.report()


def homogeneous_in_every_frame(data: CompleteData) -> FloatArray:
    """Return (2F + 1, N) with the row space of all homogeneous positions: F rows of ones as one."""
    frames = data.normalised.shape[0] // 2
    return np.vstack([data.normalised, np.full(data.n_points, np.sqrt(frames))])


def shape_interaction_affinity(space: FloatArray, power: float) -> FloatArray:
    """Affinity (N, N) of the rows of an orthonormal basis (N, r); entries under 1e-6 are dropped."""
    rows = unit_rows(space)
    affinity = np.maximum(rows @ rows.T, 0) ** power
    return np.where(affinity < _NEGLIGIBLE, 0.0, affinity)


def count_motions(matrix: FloatArray, power: float, largest: int = 6) -> int:
    """Find the k in 2..`largest` whose relative eigengap, averaged over the ranks k..4k, is widest."""
    space = leading_row_space(matrix, 4 * largest)
    ranks = range(1, space.shape[1] + 1)
    gaps = [relative_eigengaps(shape_interaction_affinity(space[:, :r], power), largest) for r in ranks]
    widest = [np.mean([g[k - 1] for g in gaps[k - 1 : 4 * k]] or 0) for k in range(2, len(gaps[0]) + 1)]
    return int(np.argmax(widest)) + 2 if widest else 1


def cut_over_gap(affinity: FloatArray, labels: IntArray, n_clusters: int) -> float:
    """Weight between groups over the eigengap of the random walk: small where the cut is clear."""
    n, degree = len(labels), affinity.sum(axis=1)
    cut = float(affinity[labels[:, None] != labels].sum())
    if n_clusters >= n:
        return cut
    scale = 1 / np.sqrt(np.where(degree > 0, degree, 1))
    walk = affinity * scale[:, None] * scale
    values = eigvalsh(walk, subset_by_index=(n - n_clusters - 1, n - 1), check_finite=False)
    gap = float(values[1] - values[0])
    return cut / gap if gap > 0 else np.inf
