"""The six methods of the paper, from hypotheses to labels.

Xu, Cheong, Li, "Motion segmentation by exploiting complementary geometric models", CVPR 2018: three views
of a clip (affine maps, homographies, fundamental matrices between frames), alone or fused.

1. Hypotheses: models through random minimal samples of the points of every frame pair.
2. Ordered residual kernel: how often two trajectories prefer the same hypotheses.
3. Sparsification: every trajectory keeps the neighbours of an entropy-based neighbourhood, and weak ties to
   those of a wider one (ours; a number for `alpha` gives the paper's single neighbourhood).
4. Embedding of each view's graph, or one that the views agree on.
5. Read-out: k-means on the embedding.

Rules for bad input, the same for all of them:

* A frame pair in which fewer points are visible than a minimal sample (3 affine, 4 homography, 8
  fundamental) is left out of that view. When no pair is left, or all samples
  are degenerate (collinear or coinciding points), the clip cannot be segmented: `SegmentationError`.
* A trajectory that meets no hypothesis of any view (never visible, or never in two frames of a
  pair) takes no part; at the end it joins the largest motion, the best guess without evidence.
* Fewer remaining trajectories than motions is an error. A motion of one point is possible.
* Duplicated points are points like others: they prefer the same hypotheses and stay together.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from scipy.sparse import csr_array

from kt3dmoseg.options import option
from kt3dmoseg.types import BoolArray, Clip, Float32Array, FloatArray, Trajectories
from mseg.clustering.counting import Count, Criterion, count_clusters
from mseg.clustering.fusion import Fusion, WeightedSum, constrain_subsets, coregularise, lower_cut
from mseg.clustering.kmeans import kmeans
from mseg.clustering.spectral import GraphLaplacian, smallest_eigenvectors, unit_rows
from mseg.errors import TooFewPointsError
from mseg.geometry.models import MODELS
from mseg.kernels import GUARD, covisible_frames, sample_hypotheses, shared, sparsify, view_kernel
from mseg.types import Grouping, ModelKind, Segmentation

KINDS: tuple[ModelKind, ...] = ("affine", "homography", "fundamental")
# Cuts that differ by less say nothing about which partition is better; seeds move them as far.
_MARGIN = 1.1
_MOST_MOTIONS = 7  # that code length compares


@dataclass(frozen=True)
class OneMotion:
    """Put all evaluated trajectories into one motion.

    Its error is one minus the share of the largest motion, the prevalence row of the paper's table
    ("all trajectories assigned to the dominant motion"). It looks at no label to do so: with a
    one-to-one match of groups to motions the only group always meets the largest motion.

    Source: Xu, Cheong, Li, "Motion segmentation by exploiting complementary geometric models", CVPR
    2018, section 4.2. Input: any. Number of motions: ignored. Cost: none.
    """

    deterministic: ClassVar[bool] = True

    def segment(self, clip: Clip, *, n_motions: int | None, rng: np.random.Generator) -> Segmentation:
        """Label every evaluated trajectory 1; see `mseg.types.Method.segment`."""
        return Segmentation(np.ones(len(clip.evaluated), dtype=np.int64))


@dataclass(frozen=True)
class ViewMethod(ABC):
    """Steps 1 to 3 and the read-out; subclasses embed the graphs of the views (step 4)."""

    kinds: ClassVar[tuple[ModelKind, ...]] = KINDS
    """The views that the method uses."""

    alpha: float | None = option(
        None, "power of the kernel before neighbours are chosen; none = close neighbours and weak ties", low=0
    )
    hypotheses: int = option(500, "hypotheses per frame pair and view", low=1)
    gap: int = option(1, "frames from the first to the second of a pair", low=1)
    sample_from: Literal["evaluated", "all"] = option(
        "evaluated", "draw samples from the evaluated trajectories, or from all (dense) ones"
    )
    distance: Literal["sampson", "transfer"] = option(
        "sampson", "residual: Sampson, or symmetric transfer for affine and homography"
    )
    fraction: float = option(0.1, "part of a pair's hypotheses that a point prefers", low=0, high=1)
    # The authors add 2e-16 to every entry, too little to keep a few points that hang on no others from
    # taking eigenvectors for themselves; see docs/methods.md.
    uniform: float = option(
        0.003, "weight spread over all pairs of points, as a fraction of the mean degree", low=0
    )
    restarts: int = option(100, "restarts of k-means", low=1)
    count: Literal["code_length", "eigengap", "self_tuning", "vote"] = option(
        "code_length",
        "how the number of motions is found when none is given: by the rigid bodies of multibody among "
        "partitions into 1 to 7, or by mseg.clustering.counting",
    )

    def segment(self, clip: Clip, *, n_motions: int | None, rng: np.random.Generator) -> Segmentation:
        """Segment the evaluated trajectories of `clip`; see `mseg.types.Method.segment`.

        Each view draws from a stream of its own, so with one seed a view has the same kernel in every method.
        """
        *streams, kmeans_rng = rng.spawn(len(KINDS) + 1)
        views, used = self.views(clip, streams, n_motions or 1)
        points = clip.evaluated_trajectories.select(used)
        counted, groupings = Count(n_motions or 0, {}), dict[int, Grouping]()
        if n_motions is None:
            counted = self.count_motions(points, views, kmeans_rng, groupings)
        labels, report = groupings.get(counted.number) or self.group(views, counted.number, kmeans_rng)
        report |= {"n_motions": counted.number}
        if n_motions is None:
            report |= {"count_scores": dict(counted.scores), "runners_up": counted.runners_up}
        return Segmentation.of_part(labels, used, report)

    def views(
        self, clip: Clip, streams: Sequence[np.random.Generator], least: int
    ) -> tuple[list[csr_array], BoolArray]:
        """Sparsified kernels (m, m) of the m >= `least` trajectories that take part; which (n,) those are."""
        points = clip.evaluated_trajectories
        # One view after the other, so that only one dense kernel is held at a time.
        views = []
        for kind in self.kinds:
            kernel = self.rescale(self._kernel(clip, points, kind, streams[KINDS.index(kind)]), points)
            views.append(csr_array(sparsify(kernel, self.alpha)))
        used = np.logical_or.reduce([view.diagonal() > 0 for view in views])
        if used.sum() < least:
            raise TooFewPointsError(
                clip.name, expected=f"at least {least} usable trajectories", found=str(int(used.sum()))
            )
        return [view[used][:, used] for view in views], used

    def _kernel(
        self, clip: Clip, points: Trajectories, kind: ModelKind, rng: np.random.Generator
    ) -> Float32Array:
        """Kernel (n, n) of `points` in one view, out of the cache in force if it is there."""
        sampled = points if self.sample_from == "evaluated" else clip.dense

        def make() -> dict[str, Float32Array]:
            hypotheses = sample_hypotheses(sampled, kind, rng, per_pair=self.hypotheses, gap=self.gap)
            if not len(hypotheses.models):
                raise TooFewPointsError(
                    f"{clip.name}, {kind} view",
                    expected=f"a frame pair with {MODELS[kind].minimal} points in general position",
                    found="none",
                )
            return {"kernel": view_kernel(points, hypotheses, fraction=self.fraction, distance=self.distance)}

        depends_on = {
            "points": [points.xy, points.visible],
            "sampled": [sampled.xy, sampled.visible],
            "options": [kind, self.hypotheses, self.gap, self.distance, self.fraction],
            "random state": rng.bit_generator.state,
        }
        return shared(depends_on, make)["kernel"]

    def rescale(self, kernel: Float32Array, points: Trajectories) -> Float32Array:
        """Change what a kernel (n, n) of `points` is divided by, in methods that differ from the paper there.

        The cache keeps the kernel of `mseg.kernels.view_kernel`, so that all methods share it.
        """
        del points
        return kernel

    def count_motions(
        self,
        points: Trajectories,
        views: Sequence[csr_array],
        rng: np.random.Generator,
        groupings: dict[int, Grouping],
    ) -> Count:
        """Find the number of motions of the trajectories that take part; `rng` is left as it is.

        By code length, or where no group is large enough for that by self-tuning, in the mean of the
        Laplacians of the views. What `group` gives for numbers that are compared goes into `groupings`.
        """
        criterion: Criterion = "self_tuning" if self.count == "code_length" else self.count
        if self.count == "code_length":
            from mseg.methods.multibody import code_lengths  # which imports this module

            most = min(_MOST_MOTIONS, len(points))
            groupings |= {k: self.group(views, k, deepcopy(rng)) for k in range(1, most + 1)}
            groups = {k: labels for k, (labels, _) in groupings.items()}
            if costs := code_lengths(points, views, groups, deepcopy(rng)):
                return Count(min(costs, key=lambda k: costs[k]), {k: -cost for k, cost in costs.items()})
        mean = WeightedSum(*((1 / len(views), self.laplacian(view)) for view in views))
        return count_clusters(mean, criterion, deepcopy(rng))

    @abstractmethod
    def group(self, views: Sequence[csr_array], n_motions: int, rng: np.random.Generator) -> Grouping:
        """Return labels (m,), 1..K, of the trajectories that take part, and what there is to report.

        `views` are the sparsified kernels (m, m) float32 of `kinds`, `rng` is the randomness of k-means.
        """

    def laplacian(self, view: csr_array) -> GraphLaplacian:
        """Normalised Laplacian of a view's graph."""
        return GraphLaplacian(view, uniform=self.uniform)

    def read_out(self, embedding: FloatArray, n_motions: int, rng: np.random.Generator) -> Grouping:
        """Run k-means on an embedding (m, d), its rows at unit length; see `group`."""
        found = kmeans(embedding, n_motions, rng, n_restarts=self.restarts)
        return found.labels + 1, {"inertia": found.inertia}


@dataclass(frozen=True)
class SingleView(ViewMethod):
    """Spectral clustering of the graph of one view."""

    def group(self, views: Sequence[csr_array], n_motions: int, rng: np.random.Generator) -> Grouping:
        embedding = smallest_eigenvectors(self.laplacian(views[0]), n_motions)
        return self.read_out(unit_rows(embedding), n_motions, rng)


@dataclass(frozen=True)
class Affine(SingleView):
    """Affine maps between frames: the motion of planes and distant or shallow objects.

    Source: Xu, Cheong, Li, "Motion segmentation by exploiting complementary geometric models", CVPR
    2018, section 3.1 (row "A view"). Input: gaps allowed. Number of motions: given or found. Cost: O(F N^2 M)
    for M hypotheses per pair, O(N^2) memory.
    """

    kinds = ("affine",)


@dataclass(frozen=True)
class Homography(SingleView):
    """Homographies between frames: planes under perspective, and the virtual planar slices of a scene.

    Source: Xu, Cheong, Li, CVPR 2018, section 3.1 (row "H view"). Input: gaps allowed. Number of
    motions: given or found. Cost: O(F N^2 M) for M hypotheses per pair, O(N^2) memory.
    """

    kinds = ("homography",)


@dataclass(frozen=True)
class Fundamental(SingleView):
    """Fundamental matrices between frames: any rigid motion with translation and depth.

    Source: Xu, Cheong, Li, CVPR 2018, section 3.1 (row "F view"). Input: gaps allowed. Number of
    motions: given or found. Cost: O(F N^2 M) for M hypotheses per pair, O(N^2) memory.
    """

    kinds = ("fundamental",)


@dataclass(frozen=True)
class MSSC(SingleView):
    """Accumulate which homographies trajectories share, keep the informative neighbours, cut the graph.

    1. Homographies are fitted to random minimal samples of every two consecutive frames. Two trajectories
       correlate in a frame pair by the share of common hypotheses among the best ones of each.
    2. Correlations are summed over all frame pairs. The sum is not divided by the number of frames in which
       both are seen, as the paper of 2018 does: long common histories weigh more.
    3. A trajectory keeps the neighbours whose share of the row's distances has a logarithm under the row's
       mean (negative entropy), after correlations are raised to the power alpha (`mseg.kernels.sparsify`).
    4. Spectral clustering.

    Source: Lai, Wang, Yan, Chin, Zhao, "Motion segmentation via a sparsity constraint", IEEE T-ITS 18(4),
    2017. No code of it is public; steps 1 to 3 follow its description in Xu, Cheong, Li, CVPR 2018 (section
    3.1 and 4), whose H view differs by the division. Numbers of hypotheses, of preferred ones and restarts
    are those of 2018. Its segment-and-merge search for the number of motions is not described there and is
    left out. The power is that of Jiang et al., AAAI 2021, for the same kernel and rule: without it (alpha =
    1) rows keep so many neighbours that a small motion has most of its weight in others, and the largest
    motion is cut in two instead.
    Input: gaps allowed. Number of motions: given, or found as in the paper's methods. Outliers: not handled.
    Cost: O(F N^2 M) for M hypotheses per pair, O(N^2) memory.
    """

    kinds = ("homography",)

    alpha: float = option(3.0, "power of the kernel before neighbours are chosen", low=0)

    def rescale(self, kernel: Float32Array, points: Trajectories) -> Float32Array:
        """Undo the division."""
        return np.asarray(kernel * (covisible_frames(points) + np.float32(GUARD)), dtype=np.float32)


@dataclass(frozen=True)
class KerAdd(ViewMethod):
    """Add the kernels of the affine, homography and fundamental views.

    Source: Xu, Cheong, Li, "Motion segmentation by exploiting complementary geometric models", CVPR
    2018, section 3.2 (row "KerAdd"). The equation there adds normalised Laplacians, the released code
    adds kernels and normalises the sum; the latter made the published figures and is the default.
    Input: gaps allowed. Number of motions: given or found. Cost: that of the three views.
    """

    add: Literal["kernels", "laplacians"] = option("kernels", "what is summed over the views")

    def group(self, views: Sequence[csr_array], n_motions: int, rng: np.random.Generator) -> Grouping:
        affine, homography, fundamental = views
        if self.add == "kernels":
            total: Any = self.laplacian(affine + homography + fundamental)
        else:
            total = WeightedSum(*((1.0, self.laplacian(view)) for view in views))
        embedding = smallest_eigenvectors(total, n_motions)
        labels, report = self.read_out(unit_rows(embedding), n_motions, rng)
        return labels, {"views": list(KINDS)} | report


@dataclass(frozen=True)
class FusedViews(ViewMethod):
    """Embed the three views so that they agree, then find one partition for all of them.

    The paper runs k-means on the three embeddings side by side (``view="joint"``), where two views that
    are wrong outvote one that is right. The relaxed problem that the embeddings solve is one of
    normalised cuts; so by default k-means proposes, from that embedding and from each view's own, and
    the cuts of the proposals in the three graphs decide (`mseg.clustering.fusion.lower_cut`).
    """

    view: Literal["least_cut", "joint", "affine", "homography", "fundamental"] = option(
        "least_cut",
        "embedding that k-means sees: joint = all views side by side, as in the paper; one view after "
        "fusion; least_cut = joint, unless the partition of another cuts less by a tenth",
    )

    def group(self, views: Sequence[csr_array], n_motions: int, rng: np.random.Generator) -> Grouping:
        """Make the embeddings agree and read one partition out of them."""
        graphs = [self.laplacian(view) for view in views]
        fusion = self.fuse(graphs, n_motions)
        embeddings = {"joint": fusion.joint()} | {kind: fusion.view(v) for v, kind in enumerate(KINDS)}
        report: dict[str, Any] = {
            "views": list(KINDS),
            "objectives": list(fusion.objectives),
            "sweeps": len(fusion.objectives),
            "converged": fusion.converged,
        }
        if self.view != "least_cut":
            labels, inertia = self.read_out(embeddings[self.view], n_motions, rng)
            return labels, report | inertia
        # Every embedding proposes a partition and lowers its cuts; they share the restarts.
        restarts = -(-self.restarts // len(embeddings))
        proposed = {
            name: kmeans(embedding, n_motions, rng, n_restarts=restarts).labels
            for name, embedding in embeddings.items()
        }
        cuts = {name: lower_cut(graphs, labels, n_motions) for name, labels in proposed.items()}
        chosen = min(cuts, key=lambda name: cuts[name].value)
        labels = cuts[chosen].labels
        if cuts["joint"].value <= _MARGIN * cuts[chosen].value:
            chosen, labels = "joint", proposed["joint"]
        report |= {"chosen": chosen, "cuts": {name: cut.value for name, cut in cuts.items()}}
        return labels + 1, report

    @abstractmethod
    def fuse(self, graphs: Sequence[GraphLaplacian], n_motions: int) -> Fusion:
        """Make the embeddings of the views agree."""


@dataclass(frozen=True)
class CoReg(FusedViews):
    """Spectral embeddings of the three views that are rewarded for agreeing with each other.

    Source: Xu, Cheong, Li, "Motion segmentation by exploiting complementary geometric models", CVPR
    2018, section 3.2 (row "CoReg"), after Kumar, Rai, Daume, NIPS 2011; lambda = 0.01. Input: gaps
    allowed. Number of motions: given or found. Cost: the three views and up to 16 sweeps of three
    eigenproblems.
    """

    lam: float = option(0.01, "lambda, weight of agreement between views", low=0)
    tolerance: float = option(1e-6, "stop when the objective changes by less", low=0)
    max_sweeps: int = option(16, "most sweeps over the views", low=1)

    def fuse(self, graphs: Sequence[GraphLaplacian], n_motions: int) -> Fusion:
        return coregularise(
            graphs, n_motions, weight=self.lam, tolerance=self.tolerance, max_sweeps=self.max_sweeps
        )


@dataclass(frozen=True)
class Subset(FusedViews):
    """Spectral embeddings of the three views that respect the nesting of their models.

    Source: Xu, Cheong, Li, "Motion segmentation by exploiting complementary geometric models", CVPR
    2018, section 3.2 (row "Subset"); gamma = 0.01. Input: gaps allowed. Number of motions: given or found.
    Cost: the three views and up to 21 sweeps of three eigenproblems.
    """

    gamma: float = option(0.01, "gamma, weight of the constraint; the paper advises at most 0.01", low=0)
    tolerance: float = option(1e-8, "stop when the objective changes by less", low=0)
    max_sweeps: int = option(21, "most sweeps over the views", low=1)

    def fuse(self, graphs: Sequence[GraphLaplacian], n_motions: int) -> Fusion:
        return constrain_subsets(
            graphs, n_motions, weight=self.gamma, tolerance=self.tolerance, max_sweeps=self.max_sweeps
        )
