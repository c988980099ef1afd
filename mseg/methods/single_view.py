"""Spectral clustering of one geometric model's kernel: the paper's single views."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kt3dmoseg.types import Clip
from mseg.clustering import smallest_eigenvectors, unit_rows
from mseg.methods.views import ViewMethod
from mseg.types import ModelKind, Segmentation


@dataclass(frozen=True)
class SingleView(ViewMethod):
    """Ordered residual kernel of one kind of model, sparsified, then spectral clustering."""

    kind: ClassVar[ModelKind]

    def segment(self, clip: Clip, *, n_motions: int | None, rng: np.random.Generator) -> Segmentation:
        """Segment the evaluated trajectories of `clip`; see `mseg.types.Method.segment`."""
        views, count, kmeans_rng = self.prepare(clip, n_motions, [self.kind], rng)
        embedding = smallest_eigenvectors(self.laplacian(views.kernels[0]), count)
        return self.cluster(views, unit_rows(embedding), count, kmeans_rng, {})


@dataclass(frozen=True)
class Affine(SingleView):
    """Affine maps between frames: the motion of planes and distant or shallow objects.

    Source: Xu, Cheong, Li, "Motion segmentation by exploiting complementary geometric models", CVPR
    2018, section 3.1 (row "A view"). Input: gaps allowed. Number of motions: given. Cost: O(F N^2 M)
    for M hypotheses per pair, O(N^2) memory.
    """

    kind = "affine"


@dataclass(frozen=True)
class Homography(SingleView):
    """Homographies between frames: planes under perspective, and the virtual planar slices of a scene.

    Source: Xu, Cheong, Li, CVPR 2018, section 3.1 (row "H view"). Input: gaps allowed. Number of
    motions: given. Cost: O(F N^2 M) for M hypotheses per pair, O(N^2) memory.
    """

    kind = "homography"


@dataclass(frozen=True)
class Fundamental(SingleView):
    """Fundamental matrices between frames: any rigid motion with translation and depth.

    Source: Xu, Cheong, Li, CVPR 2018, section 3.1 (row "F view"). Input: gaps allowed. Number of
    motions: given. Cost: O(F N^2 M) for M hypotheses per pair, O(N^2) memory.
    """

    kind = "fundamental"
