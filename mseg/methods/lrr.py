"""Low-rank representation (LRR)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import FloatArray
from mseg.clustering import count_by_eigengap, kmeans, spectral_embedding, unit_rows
from mseg.clustering.self_expression import low_rank_representation
from mseg.methods.complete_data import CompleteData, CompleteDataMethod
from mseg.types import Grouping

# Smaller singular values of Z are noise.
_RELATIVE_RANK = 1e-4


@dataclass(frozen=True)
class LRR(CompleteDataMethod):
    """Express all trajectories by each other with coefficients of lowest rank.

    1. ``min |Z|_* + lambda |E|_{2,1}`` subject to ``X = X Z + E``, X in normalised coordinates with a row of
       ones, by the inexact augmented Lagrangian in the row space of X.
    2. ``Z = U S V^T``; affinity of the rows of ``U sqrt(S)`` at unit length: inner product to the 4th power.
    3. Spectral embedding by the generalised problem ``(D - W) v = t D v`` (Shi and Malik), k-means on its
       rows as they are.

    Source: Liu, Lin, Yan, Sun, Yu, Ma, "Robust recovery of subspace structures by low-rank representation",
    TPAMI 2013, equation 7, algorithms 1 and 2; lambda = 4, the row of ones and the exponent are those of the
    authors' motion script.
    Input: complete trajectories (gaps are completed). Number of motions: given, or the relative eigengap of
    the affinity's normalised Laplacian. Outliers: bad trajectories are absorbed by E, but labelled.
    Cost: some 400 iterations of O(N F^2), then O(N^3); O(N^2) memory.
    """

    finds_n_motions: ClassVar[bool] = True

    weight: float = option(4.0, "weight lambda of the errors", low=0)
    power: int = option(4, "exponent of the affinity", low=1)
    tolerance: float = option(1e-8, "largest residual of the constraints at convergence", low=0)
    max_iterations: int = option(1000, "cap on iterations", low=1)
    restarts: int = option(20, "restarts of k-means", low=1)

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        """Label the columns of the trajectory matrix."""
        solved = low_rank_representation(
            data.homogeneous,
            weight=self.weight,
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
        )
        affinity = _affinity(solved.coefficients, self.power)
        count = n_motions or count_by_eigengap(affinity)
        # Eigenvectors of the random walk: von Luxburg, "A tutorial on spectral clustering", proposition 3.
        degree = affinity.sum(axis=1, keepdims=True)
        embedding = spectral_embedding(affinity, count) / np.sqrt(np.where(degree > 0, degree, 1))
        labels = kmeans(embedding, count, rng, n_restarts=self.restarts).labels
        return labels + 1, {**solved.convergence.report(), "n_motions": count}


def _affinity(coefficients: FloatArray, power: int = 4) -> FloatArray:
    left, values, _ = np.linalg.svd(coefficients)
    kept = values > _RELATIVE_RANK * values[0]
    rows = unit_rows(left[:, kept] * np.sqrt(values[kept]))
    return np.asarray(np.minimum(np.abs(rows @ rows.T), 1) ** power)
