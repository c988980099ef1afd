"""What co-regularisation and the subset constraint share: fused embeddings, read out as one partition."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import Clip
from mseg.clustering import Cut, Fusion, GraphLaplacian, kmeans, lower_cut
from mseg.methods.leftover import join_largest
from mseg.methods.views import KINDS, ViewMethod
from mseg.types import Segmentation


@dataclass(frozen=True)
class FusedViews(ViewMethod, ABC):
    """Embed the three views so that they agree, then find one partition for all of them.

    The paper runs k-means on the three embeddings side by side (``view="joint"``), where two views that
    are wrong outvote one that is right. The relaxed problem that the embeddings solve is one of
    normalised cuts; so by default k-means proposes, from that embedding and from each view's own, and
    the cuts of the proposals in the three graphs decide (`mseg.clustering.lower_cut`).
    """

    view: Literal["least_cut", "joint", "affine", "homography", "fundamental"] = option(
        "least_cut",
        "embedding that k-means sees: joint = all views side by side, as in the paper; one view after "
        "fusion; least_cut = each of these four, then the partition of least normalised cuts",
    )

    def segment(self, clip: Clip, *, n_motions: int | None, rng: np.random.Generator) -> Segmentation:
        """Segment the evaluated trajectories of `clip`; see `mseg.types.Method.segment`."""
        views, count, kmeans_rng = self.prepare(clip, n_motions, KINDS, rng)
        laplacians = [self.laplacian(kernel) for kernel in views.kernels]
        fusion = self.fuse(laplacians, count)
        report = {
            "views": list(KINDS),
            "objectives": list(fusion.objectives),
            "sweeps": len(fusion.objectives),
            "converged": fusion.converged,
        }
        if self.view != "least_cut":
            points = fusion.joint() if self.view == "joint" else fusion.view(KINDS.index(self.view))
            return self.cluster(views, points, count, kmeans_rng, report)
        cuts = self.cuts(fusion, laplacians, count, kmeans_rng)
        chosen = min(cuts, key=lambda name: cuts[name].value)
        report |= {
            "chosen": chosen,
            "cuts": {name: cut.value for name, cut in cuts.items()},
            "trajectories_left_out": int((~views.used).sum()),
        }
        return Segmentation(join_largest(cuts[chosen].labels + 1, views.used), report)

    def cuts(
        self, fusion: Fusion, graphs: list[GraphLaplacian], count: int, rng: np.random.Generator
    ) -> dict[str, Cut]:
        """Let every embedding propose a partition and lower its cuts; the restarts are shared."""
        embeddings = {"joint": fusion.joint()} | {k: fusion.view(v) for v, k in enumerate(KINDS)}
        restarts = -(-self.restarts // len(embeddings))
        found = {name: kmeans(x, count, rng, n_restarts=restarts).labels for name, x in embeddings.items()}
        return {name: lower_cut(graphs, labels, count) for name, labels in found.items()}

    @abstractmethod
    def fuse(self, laplacians: list[GraphLaplacian], n_motions: int) -> Fusion:
        """Make the embeddings of the views agree."""
