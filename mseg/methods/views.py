"""What the six methods of the paper share: kernels of the views, and the rules for bad input.

Rules, the same for all of them:

* A frame pair in which fewer points are visible than a minimal sample (3 affine, 4 homography, 8
  fundamental) says nothing in that view and is left out of it. When no pair is left, or all samples
  are degenerate (collinear or coinciding points), the clip cannot be segmented: `SegmentationError`.
* A trajectory that meets no hypothesis of any view (never visible, or never in two frames of a
  pair) takes no part; at the end it joins the largest motion, the best guess without evidence.
* Fewer remaining trajectories than motions is an error. A motion of one point is possible.
* Duplicated points are points like others: they prefer the same hypotheses and stay together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.sparse import csr_array

from kt3dmoseg.files import sha256_arrays
from kt3dmoseg.options import option
from kt3dmoseg.types import BoolArray, Clip, Float32Array, FloatArray, Trajectories
from mseg.clustering import GraphLaplacian, kmeans
from mseg.errors import TooFewPointsError
from mseg.geometry import MODELS
from mseg.kernels import sample_hypotheses, sparsify, view_kernel
from mseg.methods.kernel_cache import remembered
from mseg.methods.leftover import join_largest
from mseg.methods.motion_count import told
from mseg.types import ModelKind, Segmentation

KINDS: tuple[ModelKind, ...] = ("affine", "homography", "fundamental")


@dataclass(frozen=True, eq=False)
class ViewKernels:
    """Kernels of the trajectories of a clip that take part.

    Parameters
    ----------
    kernels : tuple of (m, m) float32, sparse
        Sparsified kernels, one per view.
    used : (n,) bool
        Which of the clip's evaluated trajectories the m rows are.
    """

    kernels: tuple[csr_array, ...]
    used: BoolArray


@dataclass(frozen=True)
class ViewMethod:
    """Options of hypotheses, kernels and k-means; the base of the six methods of the paper."""

    alpha: float = option(8.0, "power of the kernel before neighbours are chosen", low=0)
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
    # taking eigenvectors for themselves; see docs/reproduction.md.
    uniform: float = option(
        0.003, "weight spread over all pairs of points, as a fraction of the mean degree", low=0
    )
    restarts: int = option(100, "restarts of k-means", low=1)

    def prepare(
        self, clip: Clip, n_motions: int | None, kinds: Sequence[ModelKind], rng: np.random.Generator
    ) -> tuple[ViewKernels, int, np.random.Generator]:
        """Make the kernels of the views and the randomness of k-means.

        Each view draws from a stream of its own, so with one seed a view has the same kernel in
        every method.

        Raises
        ------
        InvalidValueError
            When `n_motions` is None.
        TooFewPointsError
            When a view has no hypothesis, or there are fewer usable trajectories than motions.
        """
        count = told(n_motions, self)
        *streams, last = rng.spawn(len(KINDS) + 1)
        points = clip.evaluated_trajectories
        source = points if self.sample_from == "evaluated" else clip.dense
        # One view after the other, so that only one dense kernel is held at a time.
        kernels = []
        for kind in kinds:
            kernel = self._kernel(clip.name, points, source, kind, streams[KINDS.index(kind)])
            kernels.append(csr_array(sparsify(self.divided_anew(kernel, points), self.alpha)))
        used = np.logical_or.reduce([kernel.diagonal() > 0 for kernel in kernels])
        if used.sum() < count:
            raise TooFewPointsError(
                clip.name, expected=f"at least {count} usable trajectories", found=str(int(used.sum()))
            )
        parts = kernels if used.all() else [kernel[used][:, used] for kernel in kernels]
        return ViewKernels(tuple(parts), used), count, last

    def divided_anew(self, kernel: Float32Array, points: Trajectories) -> Float32Array:
        """Change what a kernel (N, N) of `points` is divided by, in methods that differ from the paper there.

        What is kept in the cache is the kernel of `view_kernel`, so that they share it.
        """
        del points
        return kernel

    def laplacian(self, kernel: csr_array) -> GraphLaplacian:
        """Normalised Laplacian of a kernel."""
        return GraphLaplacian(kernel, uniform=self.uniform)

    def cluster(
        self,
        views: ViewKernels,
        points: FloatArray,
        n_motions: int,
        rng: np.random.Generator,
        report: dict[str, Any],
    ) -> Segmentation:
        """Run k-means on an embedding and label every evaluated trajectory."""
        found = kmeans(points, n_motions, rng, n_restarts=self.restarts)
        report |= {"inertia": found.inertia, "trajectories_left_out": int((~views.used).sum())}
        return Segmentation(join_largest(found.labels + 1, views.used), report)

    def _kernel(
        self,
        clip: str,
        points: Trajectories,
        source: Trajectories,
        kind: ModelKind,
        rng: np.random.Generator,
    ) -> Float32Array:
        content = sha256_arrays(points.xy, points.visible, source.xy, source.visible)
        options = (self.hypotheses, self.gap, self.distance, self.fraction)

        def make() -> Float32Array:
            sampled = sample_hypotheses(source, kind, rng, per_pair=self.hypotheses, gap=self.gap)
            if not len(sampled.models):
                raise TooFewPointsError(
                    f"{clip}, {kind} view",
                    expected=f"a frame pair with {MODELS[kind].minimal} points in general position",
                    found="none",
                )
            return view_kernel(points, sampled, fraction=self.fraction, distance=self.distance)

        return remembered((content, kind, options, rng.bit_generator.state), make)
