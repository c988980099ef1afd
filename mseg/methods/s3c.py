"""Structured sparse subspace clustering (S3C)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import IntArray
from mseg.clustering import count_by_eigengap, spectral_clustering
from mseg.clustering.self_expression import Representation, sparse_affinity, sparse_representation
from mseg.methods.complete_data import CompleteData, CompleteDataMethod
from mseg.types import Grouping


@dataclass(frozen=True)
class S3C(CompleteDataMethod):
    """Alternate sparse representation and segmentation, each guiding the other.

    The first pass is SSC. Pass t then weighs the absolute coefficients by

        w_ij = 1 / nu_t + nu_t gamma (1 - Theta_ij),   nu_t = growth^(t - 1),

    Theta_ij = 1 where the last segmentation puts i and j together (all ones at first), starts ADMM from the
    last coefficients, and segments again; until the segmentation repeats itself.

    Source: Li and Vidal, "Structured sparse subspace clustering: a unified optimization framework", CVPR
    2015, equations 6-11 and algorithm 2 (hard version); gamma = 0.1, nu = 1, growth 1.2 and at most 10 passes
    are those of the authors' code. Their motion settings of the SSC part are not published; those of SSC are
    used.
    Input: complete trajectories (gaps are completed). Number of motions: given, or the relative eigengap
    after the first pass. Outliers: not handled. Cost: that of SSC times the number of passes, usually 2.
    """

    finds_n_motions: ClassVar[bool] = True

    alpha: float = option(800.0, "weight of the fit, over the smallest coherence", low=0)
    rho: float = option(0.7, "share of a column's l1 norm that is kept", low=0, high=1)
    gamma: float = option(0.1, "weight of coefficients across groups", low=0)
    growth: float = option(1.2, "factor by which structure gains weight each pass", low=1)
    max_passes: int = option(10, "cap on passes", low=1)
    tolerance: float = option(2e-4, "largest residual of the constraints at convergence of a pass", low=0)
    max_iterations: int = option(400, "cap on ADMM iterations of a pass", low=1)
    restarts: int = option(20, "restarts of k-means", low=1)

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        """Label the columns of the trajectory matrix."""
        solved: Representation | None = None
        labels: IntArray | None = None
        count, passes, stable, nu = n_motions, 0, False, 1.0
        while passes < self.max_passes and not stable:
            apart = 0.0 if labels is None else labels[:, None] != labels
            solved = sparse_representation(
                data.normalised,
                alpha=self.alpha,
                weights=1 / nu + nu * self.gamma * np.asarray(apart, dtype=np.float64),
                start=None if solved is None else solved.coefficients,
                tolerance=self.tolerance,
                max_iterations=self.max_iterations,
            )
            affinity = sparse_affinity(solved.coefficients, self.rho)
            count = count or count_by_eigengap(affinity)
            before, labels = labels, spectral_clustering(affinity, count, rng, n_restarts=self.restarts)
            if before is not None:
                stable = np.array_equal(labels[:, None] == labels, before[:, None] == before)
            passes, nu = passes + 1, nu * self.growth
        assert solved is not None
        assert labels is not None
        report = solved.convergence.report() | {"passes": passes, "n_motions": count}
        return labels, report | {"converged": stable and solved.convergence.converged}
