"""Pairwise co-regularisation of the three views."""

from __future__ import annotations

from dataclasses import dataclass

from kt3dmoseg.options import option
from mseg.clustering import Fusion, GraphLaplacian, coregularise
from mseg.methods.fused import FusedViews


@dataclass(frozen=True)
class CoReg(FusedViews):
    """Spectral embeddings of the three views that are rewarded for agreeing with each other.

    Source: Xu, Cheong, Li, "Motion segmentation by exploiting complementary geometric models", CVPR
    2018, section 3.2 (row "CoReg"), after Kumar, Rai, Daume, NIPS 2011; lambda = 0.01. Input: gaps
    allowed. Number of motions: given. Cost: the three views and up to 16 sweeps of three
    eigenproblems.
    """

    lam: float = option(0.01, "lambda, weight of agreement between views", low=0)
    tolerance: float = option(1e-6, "stop when the objective changes by less", low=0)
    max_sweeps: int = option(16, "most sweeps over the views", low=1)

    def fuse(self, laplacians: list[GraphLaplacian], n_motions: int) -> Fusion:
        """Co-regularise."""
        return coregularise(
            laplacians, n_motions, weight=self.lam, tolerance=self.tolerance, max_sweeps=self.max_sweeps
        )
