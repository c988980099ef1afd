"""Kernel addition: the sum of the views' kernels, clustered."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import Clip, FloatArray
from mseg.clustering import WeightedSum, smallest_eigenvectors, unit_rows
from mseg.methods.views import KINDS, ViewKernels, ViewMethod
from mseg.types import Segmentation


@dataclass(frozen=True)
class KerAdd(ViewMethod):
    """Add the kernels of the affine, homography and fundamental views.

    Source: Xu, Cheong, Li, "Motion segmentation by exploiting complementary geometric models", CVPR
    2018, section 3.2 (row "KerAdd"). The equation there adds normalised Laplacians, the released code
    adds kernels and normalises the sum; the latter made the published figures and is the default.
    Input: gaps allowed. Number of motions: given. Cost: that of the three views.
    """

    add: Literal["kernels", "laplacians"] = option("kernels", "what is summed over the views")

    def segment(self, clip: Clip, *, n_motions: int | None, rng: np.random.Generator) -> Segmentation:
        """Segment the evaluated trajectories of `clip`; see `mseg.types.Method.segment`."""
        views, count, kmeans_rng = self.prepare(clip, n_motions, KINDS, rng)
        embedding = self._embedding(views, count)
        return self.cluster(views, unit_rows(embedding), count, kmeans_rng, {"views": list(KINDS)})

    def _embedding(self, views: ViewKernels, count: int) -> FloatArray:
        if self.add == "laplacians":
            terms = ((1.0, self.laplacian(kernel)) for kernel in views.kernels)
            return smallest_eigenvectors(WeightedSum(*terms), count)
        affine, homography, fundamental = views.kernels
        return smallest_eigenvectors(self.laplacian(affine + homography + fundamental), count)
