"""The subset constraint: affine inliers within homography inliers within fundamental ones."""

from __future__ import annotations

from dataclasses import dataclass

from kt3dmoseg.options import option
from mseg.clustering import Fusion, GraphLaplacian, constrain_subsets
from mseg.methods.fused import FusedViews


@dataclass(frozen=True)
class Subset(FusedViews):
    """Spectral embeddings of the three views that respect the nesting of their models.

    Source: Xu, Cheong, Li, "Motion segmentation by exploiting complementary geometric models", CVPR
    2018, section 3.2 (row "Subset"); gamma = 0.01. Input: gaps allowed. Number of motions: given.
    Cost: the three views and up to 21 sweeps of three eigenproblems.
    """

    gamma: float = option(0.01, "gamma, weight of the constraint; the paper advises at most 0.01", low=0)
    tolerance: float = option(1e-8, "stop when the objective changes by less", low=0)
    max_sweeps: int = option(21, "most sweeps over the views", low=1)

    def fuse(self, laplacians: list[GraphLaplacian], n_motions: int) -> Fusion:
        """Impose the subset constraint."""
        return constrain_subsets(
            laplacians, n_motions, weight=self.gamma, tolerance=self.tolerance, max_sweeps=self.max_sweeps
        )
