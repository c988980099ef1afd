"""Two perspective views, collaboratively clustered (TPV)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import Clip, FloatArray, IntArray, Trajectories
from mseg.clustering import spectral_clustering
from mseg.clustering.coefficient_affinity import count_by_eigengap, sparse_affinity
from mseg.clustering.collaborative import collaborative_representation
from mseg.clustering.hyperplanes import EpipolarGroups
from mseg.errors import SegmentationError, TooFewPointsError
from mseg.geometry import hartley
from mseg.iteration import Convergence
from mseg.types import Segmentation

_PIECES = (4, 6, 8, 12)
# Three times the points that fix a fundamental matrix; of fewer, any will fit.
_POINTS_PER_PIECE = 24
_MOST_SWEEPS = 100


@dataclass(frozen=True)
class TPV:
    """Express every correspondence by few others, the same ones in all pairs of frames.

    1. In a pair of frames a correspondence is ``w = vec(x' x^T)`` in R^9, x and x' homogeneous in Hartley's
       coordinates, at unit length. Those of one rigid motion satisfy ``f . w = 0``: a hyperplane.
    2. ``min sum_k alpha/2 |W_k - W_k C_k|^2 + sum_ij |(C_1(i, j), ..., C_P(i, j))|_2`` with zero diagonals;
       a trajectory not seen in pair k takes no part there.
    3. Affinity of ``sum_k |C_k|``, of each column the largest 70 per cent, scaled to a maximum of one
       (as in SSC); spectral clustering into K, 4, 6, 8 and 12 groups, of 24 trajectories or more on
       average. Sparse coefficients join near points: they hardly cross from one motion to another, yet tie
       the far ends of a large motion even less.
    4. Groups merge, two at a time, until K are left, by a cost of distances from each group's fundamental
       matrices and of the affinity that is cut (`mseg.clustering.hyperplanes.EpipolarGroups`);
       trajectories move to the group whose matrices fit them best until none moves. Of the five
       segmentations the cheapest stays.

    Trajectories that no pair sees join the largest motion.

    Source: Li, Guo, Cheong, Zhou, "Perspective motion segmentation via collaborative clustering", ICCV 2013.
    No code of it is public, and the paper was not at hand: it too over-segments and merges, but which pairs,
    alpha, the stopping rule, the scaling of the affinity and all of step 4 are ours.
    Input: gaps allowed. Number of motions: given, or the relative eigengap of the affinity (ours). Outliers:
    not handled. Cost: P pairs, O(P N^2) per iteration, up to 400, O(N^3) for the spectral step; O(N^2)
    memory.
    """

    pairs: int = option(8, "most pairs of frames in the length of a trajectory", low=1)
    gap: float = option(
        0.25, "frames from the first to the second of a pair, as part of a trajectory", low=0, high=1
    )
    alpha: float = option(8000.0, "weight of the fit", low=1e-9)
    penalty: float = option(50.0, "penalty of ADMM's splitting", low=1e-9)
    rho: float = option(0.7, "share of a column's l1 norm that is kept", low=0, high=1)
    tolerance: float = option(2e-3, "largest residual of the constraint and step at convergence", low=0)
    max_iterations: int = option(400, "cap on ADMM iterations", low=1)
    merge: bool = option(True, "cluster into more groups than motions too, and merge (step 4)")
    noise: float = option(0.005, "least distance that tells, with points sqrt 2 from their centre", low=1e-9)
    cut: float = option(6.0, "weight of the normalised cut beside nats per trajectory and pair", low=0)
    restarts: int = option(20, "restarts of k-means", low=1)

    def segment(self, clip: Clip, *, n_motions: int | None, rng: np.random.Generator) -> Segmentation:
        """Segment the evaluated trajectories of `clip`; see `mseg.types.Method.segment`."""
        views = epipolar_views(clip.evaluated_trajectories, self.pairs, self.gap)
        used = np.any([view.any(axis=0) for view in views], axis=0) if views else np.zeros(1, dtype=np.bool_)
        fewest = max(n_motions or 2, 2)
        if used.sum() < fewest:
            expected = f"at least {fewest} trajectories seen in a pair of frames"
            raise TooFewPointsError(clip.name, expected=expected, found=str(int(used.sum())))
        views = [view[:, used] for view in views]
        if all(np.ptp(view, axis=1).max() == 0 for view in views):
            raise SegmentationError(clip.name, expected="trajectories that differ", found="one, repeated")
        solved = collaborative_representation(
            views,
            alpha=self.alpha,
            penalty=self.penalty,
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
        )
        affinity = sparse_affinity(solved.coefficients, self.rho)
        count = n_motions or count_by_eigengap(affinity)
        found, refined = self._grouped(np.stack(views), affinity, count, rng)
        report = {"pairs": len(views), "n_motions": count, "trajectories_left_out": int((~used).sum())}
        report |= {**solved.convergence.report(), **refined.report("reassignment_")}
        return Segmentation.of_part(found, used, report)

    def _grouped(
        self, views: FloatArray, affinity: FloatArray, count: int, rng: np.random.Generator
    ) -> tuple[IntArray, Convergence]:
        """Labels 1..count by steps 3 and 4."""
        whole = spectral_clustering(affinity, count, rng, n_restarts=self.restarts)
        if not self.merge:
            return whole, Convergence(True, 0, 0.0)
        epipolar = EpipolarGroups(views, affinity, self.noise, self.cut)
        candidates = [epipolar.reassign(whole, _MOST_SWEEPS)]
        for pieces in (p for p in _PIECES if count < p <= len(affinity) // _POINTS_PER_PIECE):
            groups = spectral_clustering(affinity, pieces, rng, n_restarts=self.restarts)
            candidates.append(epipolar.reassign(epipolar.merge(groups, count), _MOST_SWEEPS))
        return min(candidates, key=lambda candidate: epipolar.cost(candidate[0]))


def epipolar_views(trajectories: Trajectories, most: int, gap: float) -> list[FloatArray]:
    """Products of homogeneous coordinates in pairs of frames.

    Parameters
    ----------
    trajectories : Trajectories
        N trajectories over F frames.
    most : int
        Largest number of pairs over as many frames as the median trajectory that is seen twice is seen in;
        more where the clip is longer.
    gap : float
        Distance of the two frames as part of that number less one; at least one frame.

    Returns
    -------
    list of (9, N) float64
        Unit columns ``vec(x' x^T)``, zero for trajectories that the pair does not see. Pairs that see
        fewer than two are left out.
    """
    lengths = trajectories.lengths[trajectories.lengths > 1]
    if not len(lengths):
        return []
    length = float(np.median(lengths))
    apart = max(1, round(gap * (length - 1)))
    last = trajectories.n_frames - 1 - apart
    wanted = round(most * trajectories.n_frames / length)
    chosen = np.unique(np.linspace(0, last, wanted).round().astype(int))
    views = []
    for first in chosen.tolist():
        seen, x1, x2 = trajectories.pair(first, first + apart)
        if len(seen) > 1:
            view = np.zeros((9, len(trajectories)))
            view[:, seen] = _products(x1, x2).T
            views.append(view)
    return views


def _products(x1: FloatArray, x2: FloatArray) -> FloatArray:
    ones = np.ones((len(x1), 1))
    first, second = (np.hstack([hartley.normalise(x)[0], ones]) for x in (x1, x2))
    products = (second[:, :, None] * first[:, None, :]).reshape(len(x1), 9)
    return np.asarray(products / np.linalg.norm(products, axis=1, keepdims=True))
