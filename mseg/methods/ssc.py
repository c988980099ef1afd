"""Sparse subspace clustering (SSC)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kt3dmoseg.options import option
from mseg.clustering import count_by_eigengap, spectral_clustering
from mseg.clustering.self_expression import sparse_affinity, sparse_representation
from mseg.geometry.subspaces import project
from mseg.methods.complete_data import CompleteData, CompleteDataMethod
from mseg.types import Grouping


@dataclass(frozen=True)
class SSC(CompleteDataMethod):
    """Express every trajectory by few others; those it uses move with it.

    1. ``min |C|_1 + mu/2 |X - X C|_F^2`` with zero diagonal and columns that sum to one, X in normalised
       coordinates, ``mu = alpha / min_j max_{i != j} |x_i . x_j|``, by ADMM.
    2. Of each column the largest coefficients that make up a share rho of its l1 norm are kept, the
       column is scaled to a maximum of one, and ``W = |C| + |C|^T``.
    3. Spectral clustering.

    Source: Elhamifar and Vidal, "Sparse subspace clustering: algorithm, theory and applications", TPAMI
    2013, equation 13, algorithm 2 and section 7.1; alpha = 800, affine, rho = 0.7, no projection are the
    published choices for motion ("2F-dimensional data").
    Input: complete trajectories (gaps are completed). Number of motions: given, or the relative eigengap of
    W's normalised Laplacian. Outliers: not handled. Cost: O(N^2 F) per iteration, 100-200 iterations, O(N^3)
    for the spectral step; O(N^2) memory.
    """

    finds_n_motions: ClassVar[bool] = True

    alpha: float = option(800.0, "weight of the fit, over the smallest coherence", low=0)
    rho: float = option(0.7, "share of a column's l1 norm that is kept", low=0, high=1)
    affine: bool = option(True, "affine combinations: coefficients of a column sum to one")
    dimension: int = option(0, "project to this many dimensions first; 0 = no projection", low=0)
    tolerance: float = option(2e-4, "largest residual of the constraints at convergence", low=0)
    max_iterations: int = option(400, "cap on ADMM iterations", low=1)
    restarts: int = option(20, "restarts of k-means", low=1)

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        """Label the columns of the trajectory matrix."""
        x = project(data.normalised, self.dimension) if self.dimension else data.normalised
        solved = sparse_representation(
            x,
            alpha=self.alpha,
            affine=self.affine,
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
        )
        affinity = sparse_affinity(solved.coefficients, self.rho)
        count = n_motions or count_by_eigengap(affinity)
        labels = spectral_clustering(affinity, count, rng, n_restarts=self.restarts)
        return labels, {**solved.convergence.report(), "n_motions": count}
