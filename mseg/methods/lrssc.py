"""Low-rank sparse subspace clustering (LRSSC)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from kt3dmoseg.options import option
from mseg.clustering import count_by_eigengap, spectral_clustering
from mseg.clustering.self_expression import (
    low_rank_representation,
    low_rank_sparse_representation,
    sparse_affinity,
    sparse_representation,
)
from mseg.methods.complete_data import CompleteData, CompleteDataMethod
from mseg.types import Grouping


@dataclass(frozen=True)
class LRSSC(CompleteDataMethod):
    """Express trajectories by each other with coefficients that are low-rank and sparse.

    Variant "joint" (Wang, Xu, Leng): ``min |C|_* + lambda |C|_1 + mu/2 |X - X C|_F^2`` with zero diagonal,
    X in normalised coordinates with a row of ones. Variant "cascade", another method that goes by the same
    name in comparisons: the coefficients Z of LRR (without the row of ones) become the data of SSC.
    Both end as SSC does: largest coefficients, affinity, spectral clustering.

    Source: Wang, Xu, Leng, "Provable subspace clustering: when LRR meets SSC", NIPS 2013, equation 2. They
    publish no setting for trajectories; lambda was set on the public sequences, mu is that of SSC.
    Input: complete trajectories (gaps are completed). Number of motions: given, or the relative eigengap of
    the affinity's normalised Laplacian. Outliers: not handled. Cost: about 100 iterations of O(N^3); O(N^2)
    memory.
    """

    finds_n_motions: ClassVar[bool] = True

    variant: Literal["joint", "cascade"] = option("joint", "one programme, or LRR followed by SSC")
    sparsity: float = option(0.1, "weight lambda of the l1 norm (joint)", low=0)
    alpha: float = option(800.0, "weight of the fit, over the smallest coherence", low=0)
    weight: float = option(4.0, "weight of LRR's errors (cascade)", low=0)
    rho: float = option(0.7, "share of a column's l1 norm that is kept", low=0, high=1)
    max_iterations: int = option(400, "cap on ADMM iterations", low=1)
    restarts: int = option(20, "restarts of k-means", low=1)

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        """Label the columns of the trajectory matrix."""
        report: dict[str, Any] = {}
        cap = self.max_iterations
        if self.variant == "joint":
            solved = low_rank_sparse_representation(
                data.homogeneous, sparsity=self.sparsity, alpha=self.alpha, max_iterations=cap
            )
        else:
            low_rank = low_rank_representation(data.normalised, weight=self.weight)
            report = low_rank.convergence.report("low_rank_")
            solved = sparse_representation(low_rank.coefficients, alpha=self.alpha, max_iterations=cap)
        affinity = sparse_affinity(solved.coefficients, self.rho)
        count = n_motions or count_by_eigengap(affinity)
        labels = spectral_clustering(affinity, count, rng, n_restarts=self.restarts)
        return labels, {**report, **solved.convergence.report(), "n_motions": count}
