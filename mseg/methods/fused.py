"""What co-regularisation and the subset constraint share: fused embeddings, read out by k-means."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import Clip
from mseg.clustering import Fusion, GraphLaplacian
from mseg.methods.views import KINDS, ViewMethod
from mseg.types import Segmentation


@dataclass(frozen=True)
class FusedViews(ViewMethod, ABC):
    """Embed the three views so that they agree, then cluster them together or one of them."""

    view: Literal["joint", "affine", "homography", "fundamental"] = option(
        "joint", "embedding that k-means sees: all views side by side, or one view after fusion"
    )

    def segment(self, clip: Clip, *, n_motions: int | None, rng: np.random.Generator) -> Segmentation:
        """Segment the evaluated trajectories of `clip`; see `mseg.types.Method.segment`."""
        views, count, kmeans_rng = self.prepare(clip, n_motions, KINDS, rng)
        fusion = self.fuse([self.laplacian(kernel) for kernel in views.kernels], count)
        points = fusion.joint() if self.view == "joint" else fusion.view(KINDS.index(self.view))
        report = {
            "views": list(KINDS),
            "objectives": list(fusion.objectives),
            "sweeps": len(fusion.objectives),
            "converged": fusion.converged,
        }
        return self.cluster(views, points, count, kmeans_rng, report)

    @abstractmethod
    def fuse(self, laplacians: list[GraphLaplacian], n_motions: int) -> Fusion:
        """Make the embeddings of the views agree."""
