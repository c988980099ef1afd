"""Structured sparse subspace clustering (S3C)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import IntArray
from mseg.clustering import count_by_eigengap, spectral_clustering
from mseg.clustering.self_expression import Representation, sparse_affinity, sparse_representation
from mseg.methods.complete_data import CompleteData, CompleteDataMethod


@dataclass(frozen=True)
class S3C(CompleteDataMethod):
    """Alternate sparse representation and segmentation, each with the other in mind.

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

    def group(
        self, data: CompleteData, n_motions: int | None, rng: np.random.Generator
    ) -> tuple[IntArray, dict[str, Any]]:
        """Label the columns of the trajectory matrix."""
        solved = self._represent(data, None, None, 1.0)
        affinity = sparse_affinity(solved.coefficients, self.rho)
        count = n_motions or count_by_eigengap(affinity)
        labels = spectral_clustering(affinity, count, rng, n_restarts=self.restarts)
        passes, stable, nu = 1, False, self.growth
        while passes < self.max_passes and not stable:
            solved = self._represent(data, solved, labels, nu)
            affinity = sparse_affinity(solved.coefficients, self.rho)
            before = labels
            labels = spectral_clustering(affinity, count, rng, n_restarts=self.restarts)
            stable = bool(np.array_equal(_together(labels), _together(before)))
            passes, nu = passes + 1, nu * self.growth
        report = solved.convergence.report() | {"passes": passes, "n_motions": count}
        return labels, report | {"converged": stable and solved.convergence.converged}

    def _represent(
        self, data: CompleteData, last: Representation | None, labels: IntArray | None, nu: float
    ) -> Representation:
        apart = 0.0 if labels is None else ~_together(labels)
        return sparse_representation(
            data.normalised,
            alpha=self.alpha,
            weights=1 / nu + nu * self.gamma * np.asarray(apart, dtype=np.float64),
            start=None if last is None else last.coefficients,
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
        )


def _together(labels: IntArray) -> np.ndarray[Any, np.dtype[np.bool_]]:
    return np.asarray(labels[:, None] == labels)
