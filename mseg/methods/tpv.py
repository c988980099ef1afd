"""Two perspective views, collaboratively clustered (TPV).

Pairs of frames are views (V, 9, N): unit columns ``w = vec(x' x^T)``, x and x' homogeneous in Hartley's
coordinates, zero for trajectories that the pair does not see. ``f . w = 0`` is a hyperplane of R^9, and f,
row by row, the fundamental matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import BoolArray, Clip, Float32Array, FloatArray, IntArray, Trajectories
from mseg.clustering import count_by_eigengap, spectral_clustering
from mseg.errors import SegmentationError, TooFewPointsError
from mseg.geometry import hartley
from mseg.iteration import Convergence, iterate
from mseg.methods.self_expression import Representation, sparse_affinity
from mseg.types import Segmentation

_PIECES = (4, 6, 8, 12)
# Three times the points that fix a fundamental matrix; of fewer, any will fit.
_POINTS_PER_PIECE = 24
_MOST_SWEEPS = 100
# Points whose coefficients are sought together: their state stays in the processor's cache.
_BLOCK = 32
_LARGEST = float(np.finfo(np.float64).max)


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
       matrices and of the affinity that is cut,
       ``sum_g (1/T sum_v n_gv/2 log(d_gv + noise^2) + weight cut(g) / degree(g))`` with d_gv the mean squared
       Sampson distance of the n_gv trajectories of g that pair v sees, T the sum of all n_gv. (Distances
       alone let K geometries per pair explain wrong groups as well; the cut alone parts the largest motion.)
       Then trajectories move to the group whose matrices fit them best until none moves. Of the five
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
    noise: float = option(0.005, "least distance that counts, with points sqrt 2 from their centre", low=1e-9)
    cut: float = option(6.0, "weight of the normalised cut against nats per trajectory and pair", low=0)
    restarts: int = option(20, "restarts of k-means", low=1)

    def segment(self, clip: Clip, *, n_motions: int | None, rng: np.random.Generator) -> Segmentation:
        """Segment the evaluated trajectories of `clip`; see `mseg.types.Method.segment`."""
        views = _epipolar_views(clip.evaluated_trajectories, self.pairs, self.gap)
        used = np.asarray(views.any(axis=(0, 1)))
        fewest = max(n_motions or 2, 2)
        if used.sum() < fewest:
            expected = f"at least {fewest} trajectories seen in a pair of frames"
            raise TooFewPointsError(clip.name, expected=expected, found=str(int(used.sum())))
        views = views[:, :, used]
        if np.ptp(views, axis=2).max() == 0:
            raise SegmentationError(clip.name, expected="trajectories that differ", found="one, repeated")
        solved = _collaborative_representation(
            views, self.alpha, self.penalty, self.tolerance, self.max_iterations
        )
        affinity = sparse_affinity(solved.coefficients, self.rho)
        count = n_motions or count_by_eigengap(affinity)
        labels, refined = self._grouped(views, affinity, count, rng)
        report = {"pairs": len(views), "n_motions": count, "trajectories_left_out": int((~used).sum())}
        report |= {**solved.convergence.report(), **refined.report("reassignment_")}
        return Segmentation.of_part(labels, used, report)

    def _grouped(
        self, views: FloatArray, affinity: FloatArray, count: int, rng: np.random.Generator
    ) -> tuple[IntArray, Convergence]:
        """Labels 1..count by steps 3 and 4."""
        direct = spectral_clustering(affinity, count, rng, n_restarts=self.restarts)
        if not self.merge:
            return direct, Convergence(True, 0, 0.0)
        epipolar = _EpipolarGroups(views, affinity, self.noise, self.cut)
        candidates = [epipolar.reassign(direct, _MOST_SWEEPS)]
        for pieces in (p for p in _PIECES if count < p <= len(affinity) // _POINTS_PER_PIECE):
            groups = spectral_clustering(affinity, pieces, rng, n_restarts=self.restarts)
            candidates.append(epipolar.reassign(epipolar.merge(groups, count), _MOST_SWEEPS))
        return min(candidates, key=lambda candidate: epipolar.cost(candidate[0]))


def _epipolar_views(trajectories: Trajectories, most: int, gap: float) -> FloatArray:
    """Make the views (V, 9, N) of pairs of frames that see two trajectories or more.

    At most `most` pairs over as many frames as the median trajectory that is seen twice is seen in, more
    where the clip is longer. `gap` is the distance of two frames as part of that number less one.
    """
    lengths = trajectories.lengths[trajectories.lengths > 1]
    if not len(lengths):
        return np.zeros((0, 9, len(trajectories)))
    length = float(np.median(lengths))
    apart = max(1, round(gap * (length - 1)))
    wanted = round(most * trajectories.n_frames / length)
    chosen = np.unique(np.linspace(0, trajectories.n_frames - 1 - apart, wanted).round().astype(int))
    views = []
    for first in chosen.tolist():
        seen, x1, x2 = trajectories.pair(first, first + apart)
        if len(seen) > 1:
            ones = np.ones((len(seen), 1))
            homogeneous = [np.hstack([hartley.normalise(x)[0], ones]) for x in (x1, x2)]
            products = (homogeneous[1][:, :, None] * homogeneous[0][:, None, :]).reshape(len(seen), 9)
            view = np.zeros((9, len(trajectories)))
            view[:, seen] = (products / np.linalg.norm(products, axis=1, keepdims=True)).T
            views.append(view)
    return np.array(views).reshape(len(views), 9, len(trajectories))


def _collaborative_representation(
    views: FloatArray,
    alpha: float = 8000.0,
    penalty: float = 50.0,
    tolerance: float = 2e-3,
    max_iterations: int = 200,
) -> Representation:
    """Solve step 2 by ADMM; coefficients are the sum of magnitudes over the views.

    The programme falls apart into one for each column of C; they are solved a few at a time, in single
    precision. `penalty`, of the splitting of C into a fitted and a sparse copy, changes the way, not the
    solution. The convergence is that of the block of columns that took longest.
    """
    # Mixed norm: Li, Guo, Cheong, Zhou, section 3; splitting: Elhamifar and Vidal, TPAMI 2013, algorithm 2.
    n = views.shape[2]
    _, values, right = np.linalg.svd(np.sqrt(alpha) * views, full_matrices=False)
    gain = (values**2 / (values**2 + penalty))[:, None, :].astype(np.float32)
    coefficients = np.empty((n, n))
    ends = []
    for start in range(0, n, _BLOCK):
        block = _Columns(right.astype(np.float32), gain, penalty, np.arange(start, min(start + _BLOCK, n)))
        ends.append(iterate(block.step, tolerance=tolerance, max_iterations=max_iterations))
        coefficients[:, block.columns] = np.abs(block.sparse).sum(axis=0).T
    slowest = Convergence(
        all(end.converged for end in ends),
        max(end.iterations for end in ends),
        max(end.residual for end in ends),
    )
    return Representation(coefficients, slowest)


class _Columns:
    """ADMM of some columns of C, kept as rows: arrays are (V, columns, N).

    With ``W = L S V^T`` the fitted copy ``(alpha W^T W + p I)^-1 (alpha W^T w_j + p q)`` is
    ``q + V h (v_j - V^T q)``, v_j row j of V and ``h = alpha S^2 / (alpha S^2 + p)``.
    """

    def __init__(self, right: Float32Array, gain: Float32Array, penalty: float, columns: IntArray) -> None:
        self.columns = columns
        self.right, self.left = right, np.ascontiguousarray(right.transpose(0, 2, 1))
        self.gain, self.penalty = gain, np.float32(penalty)
        self.sparse = np.zeros((len(right), len(columns), right.shape[2]), dtype=np.float32)
        # The sparse copy before it is shrunk: multipliers and fitted copy together.
        self.raw = np.zeros_like(self.sparse)

    def step(self) -> float:
        fitted = 2 * self.sparse - self.raw
        fitted += ((self.left[:, self.columns] - fitted @ self.left) * self.gain) @ self.right
        self.raw += fitted - self.sparse
        size = np.sqrt(np.einsum("vjn,vjn->jn", self.raw, self.raw))
        keep = np.maximum(1 - 1 / np.maximum(self.penalty * size, 1), 0)
        keep[np.arange(len(self.columns)), self.columns] = 0
        before, self.sparse = self.sparse, self.raw * keep
        return max(float(np.abs(fitted - self.sparse).max()), float(np.abs(self.sparse - before).max()))


@dataclass(frozen=True, eq=False)
class _EpipolarGroups:
    """The cost of step 4, of groups of the N trajectories of `views`, and partitions that cost little."""

    views: FloatArray
    affinity: FloatArray
    noise: float
    weight: float

    def cost(self, labels: IntArray) -> float:
        """Cost of the groups 1..K of `labels` (N,)."""
        return sum(self._cost(labels == k) for k in np.unique(labels).tolist())

    def merge(self, labels: IntArray, count: int) -> IntArray:
        """Merge two groups at a time, those whose union lowers the cost most, until `count` are left."""
        groups = [labels == k for k in np.unique(labels).tolist()]
        costs = [self._cost(group) for group in groups]
        rise = np.full((len(groups), len(groups)), np.inf)
        for a, b in combinations(range(len(groups)), 2):
            rise[a, b] = self._cost(groups[a] | groups[b]) - costs[a] - costs[b]
        while len(groups) > count:
            a, b = divmod(int(rise.argmin()), len(groups))
            groups[a] |= groups.pop(b)
            costs[a] += costs.pop(b) + float(rise[a, b])
            rise = np.delete(np.delete(rise, b, axis=0), b, axis=1)
            for c in (c for c in range(len(groups)) if c != a):
                rise[min(a, c), max(a, c)] = self._cost(groups[a] | groups[c]) - costs[a] - costs[c]
        return np.asarray(np.stack(groups).argmax(axis=0) + 1)

    def reassign(self, labels: IntArray, max_iterations: int) -> tuple[IntArray, Convergence]:
        """Give every trajectory to the group whose geometry fits it best, and fit again.

        Distances from a group's matrix are taken for Gaussian with the group's own variance in the view; the
        nats are averaged over the views that see the trajectory and at least nine of the group. No group
        becomes empty, and a trajectory that no view decides keeps its label. The convergence is that of the
        share of trajectories that moved.
        """
        count = int(labels.max())

        def step() -> float:
            nonlocal labels
            nats = np.array([self._mean_nats(labels == k) for k in range(1, count + 1)])
            moved = np.where((nats < _LARGEST).any(axis=0), nats.argmin(axis=0) + 1, labels)
            if len(np.unique(moved)) < len(np.unique(labels)):
                return 0.0
            before, labels = labels, moved
            return float((before != labels).mean())

        convergence = iterate(step, tolerance=0.0, max_iterations=max_iterations)
        return labels, convergence

    def _cost(self, group: BoolArray) -> float:
        part = self.views[:, :, group]
        seen, squares = _distances(part, _fundamental_matrices(part))
        number = seen.sum(axis=1)
        mean = squares.sum(axis=1) / np.maximum(number, 1)
        nats = float(number @ np.log(mean + self.noise**2)) / 2 / float(self.views.any(axis=1).sum())
        weights = self.affinity[group]
        return nats + self.weight * (1 - float(weights[:, group].sum() / max(weights.sum(), 1e-300)))

    def _mean_nats(self, group: BoolArray) -> FloatArray:
        """Nats (N,) per view of each trajectory in a group; the largest number where no view decides."""
        seen, squares = _distances(self.views, _fundamental_matrices(self.views[:, :, group]))
        number = seen[:, group].sum(axis=1)
        variance = squares[:, group].sum(axis=1) / np.maximum(number, 1) + self.noise**2
        known = seen & (number > self.views.shape[1] - 1)[:, None]
        nats = np.where(known, (squares / variance[:, None] + np.log(variance)[:, None]) / 2, 0).sum(axis=0)
        views = known.sum(axis=0)
        return np.asarray(np.divide(nats, views, out=np.full(nats.shape, _LARGEST), where=views > 0))


def _fundamental_matrices(views: FloatArray) -> FloatArray:
    """Matrices (V, 3, 3) of least algebraic error of the points of views (V, 9, n)."""
    _, vectors = np.linalg.eigh(views @ views.transpose(0, 2, 1))
    return np.asarray(vectors[:, :, 0].reshape(-1, 3, 3))


def _distances(views: FloatArray, models: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Which points the views see (V, n), and squared Sampson distances, zero where they do not.

    The last row of ``x' x^T`` is x, the last column x', both at the scale of w: the distance is free of it.
    """
    seen = np.asarray(views.any(axis=1))
    algebraic = np.einsum("vd,vdn->vn", models.reshape(-1, 9), views)
    back = models[:, :, :2].transpose(0, 2, 1)
    lines = np.concatenate([models[:, :2] @ views[:, 6:], back @ views[:, 2::3]], axis=1)
    gradient = np.einsum("vdn,vdn->vn", lines, lines)
    squares = np.divide(algebraic**2, gradient, out=np.zeros_like(gradient), where=gradient > 0)
    return seen, squares
