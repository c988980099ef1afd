"""Consistent motion segmentation (ConsistentMoSeg)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from kt3dmoseg.options import option
from kt3dmoseg.types import Float32Array, IntArray, Trajectories
from mseg.clustering import smallest_eigenvectors, unit_rows
from mseg.clustering.coefficient_affinity import keep_largest
from mseg.clustering.consistent import consistent_affinity
from mseg.kernels import GUARD, covisible_frames
from mseg.methods.paper import KINDS, ViewMethod

_GUARD = 0.2
_NEGLIGIBLE = 1e-5


@dataclass(frozen=True)
class ConsistentMoSeg(ViewMethod):
    """One graph of K components that all three views share, and what each view adds to it.

    1. Kernels Z_v of the affine, homography and fundamental views, divided by the number of common frames
       plus 0.2, sparsified with alpha = 3, diagonals zero.
    2. ``min sum_v 1/2 |Z_v - C o D_v|^2 + l1/2 |D_v|^2 + l2 <Laplacian of C, W>`` over symmetric
       0 <= C <= 5, D_v >= 1e-4 and the relaxed projector W of trace K (`mseg.clustering.consistent`).
    3. Affinity: the sum of the symmetric parts of C o D_v, of each column the largest entries that make up
       90 per cent of its sum, then spectral clustering.

    Source: Jiang, Xu, Ma, Yang, Cao, Huang, "What to select: pursuing consistent motion segmentation from
    multiple geometric models", AAAI 2021, and its authors' code; l1 = 0.001, l2 = 0.015 are theirs for
    Hopkins155 and MTPV62 (0.005 and 0.05 for Hopkins12, 0.001 and 0.01 for KT3DMoSeg). Deviation: their
    affinity is left unsymmetric by the last step and goes into spectral clustering as such; here it is
    averaged with its transpose, and a small uniform weight is added as in the paper's views. The affinity
    itself equals that of their code (docs/baselines.md).
    Input: gaps allowed. Number of motions: given. Outliers: not handled. Cost: that of the three views and
    up to 500 sweeps of O(N^2 K); O(N^2) memory.
    """

    alpha: float = option(3.0, "power of the kernel before neighbours are chosen", low=0)
    specific_weight: float = option(0.001, "weight l1 of the view-specific parts", low=0)
    rank_weight: float = option(0.015, "weight l2 of the graph's K smallest eigenvalues", low=0)
    share: float = option(0.9, "share of a column's sum that is kept", low=0, high=1)
    tolerance: float = option(1e-3, "largest squared change at convergence", low=0)
    max_iterations: int = option(500, "cap on sweeps", low=1)

    def group(
        self, views: Sequence[csr_array], n_motions: int, rng: np.random.Generator
    ) -> tuple[IntArray, dict[str, Any]]:
        """Find the shared graph and cut it."""
        solved = consistent_affinity(
            [view.toarray() for view in views],
            n_motions,
            specific_weight=self.specific_weight,
            rank_weight=self.rank_weight,
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
        )
        affinity = solved.affinity()
        kept = keep_largest(np.where(affinity < _NEGLIGIBLE, 0.0, affinity), self.share)
        graph = self.laplacian(csr_array((kept + kept.T) / 2))
        labels, report = self.read_out(unit_rows(smallest_eigenvectors(graph, n_motions)), n_motions, rng)
        return labels, {"views": list(KINDS), **solved.convergence.report(), **report}

    def rescale(self, kernel: Float32Array, points: Trajectories) -> Float32Array:
        """Divide by the common frames plus 0.2 instead of the paper's 0.1."""
        together = covisible_frames(points)
        scale = (together + np.float32(GUARD)) / (together + np.float32(_GUARD))
        return np.asarray(kernel * scale, dtype=np.float32)
