"""Two perspective views, collaboratively clustered (TPV).

Pairs of frames are views (V, 9, N): unit columns ``w = vec(x' x^T)``, x and x' homogeneous in Hartley's
coordinates, zero for trajectories that the pair does not see. ``f . w = 0`` is a hyperplane of R^9, and f,
row by row, the fundamental matrix.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import BoolArray, Clip, Float32Array, FloatArray, IntArray, Trajectories
from mseg.clustering.spectral import count_by_eigengap, spectral_clustering
from mseg.errors import SegmentationError, TooFewPointsError
from mseg.geometry.hartley import frame_pair
from mseg.geometry.models import MODELS
from mseg.iteration import Convergence, iterate
from mseg.methods.self_expression import Representation, shared_representation, sparse_affinity
from mseg.types import ModelKind, Segmentation

_PIECES = (4, 6, 8, 12)
# Three times the points that fix a fundamental matrix; of fewer, any will fit.
_POINTS_PER_PIECE = 24
_MOST_SWEEPS = 100
# Points whose coefficients are sought together: their state stays in the processor's cache.
_BLOCK = 32
_LARGEST = float(np.finfo(np.float64).max)
# Where homographies leave so little more than epipolar geometry (logarithm of variances), motions are planes.
_PLANES = 0.1
# Squared distances that count as far: points that a homography maps to infinity.
_FAR = 1e6


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
       Then trajectories move to the group whose matrices fit them best until none moves or a group would
       become empty (then reported as not converged). Of the five segmentations the cheapest stays.
    5. Planes that move leave their fundamental matrices undetermined, and wrong groups fit as well. So step 4
       is done with homographies too, on two clusterings; their distances are two numbers (``log`` in place of
       ``1/2 log``). Where these groups explain the trajectories about as well, a mean logarithm of the
       variance per number of at most 0.1 more, they stay.

    Trajectories that no pair sees join the largest motion.

    Source: Li, Guo, Cheong, Zhou, "Perspective motion segmentation via collaborative clustering", ICCV 2013.
    No code of it is public, and the paper was not at hand: it too over-segments and merges, but which pairs,
    alpha, the number of steps, the scaling of the affinity and all of steps 4 and 5 are ours.
    Input: gaps allowed. Number of motions: given, or the relative eigengap of the affinity (ours). Outliers:
    not handled. Cost: P pairs, O(P N^2) for each of 100 steps, O(N^3) for the spectral step; O(N^2)
    memory.
    """

    pairs: int = option(8, "most pairs of frames in the length of a trajectory", low=1)
    gap: float = option(
        0.25, "frames from the first to the second of a pair, as part of a trajectory", low=0, high=1
    )
    alpha: float = option(8000.0, "weight of the fit", low=1e-9)
    penalty: float = option(50.0, "penalty of ADMM's splitting", low=1e-9)
    rho: float = option(0.7, "share of a column's l1 norm that is kept", low=0, high=1)
    iterations: int = option(100, "steps of ADMM, as many for every trajectory", low=1)
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
        solved = shared_representation(
            _collaborative_representation,
            views,
            alpha=self.alpha,
            penalty=self.penalty,
            iterations=self.iterations,
        )
        affinity = sparse_affinity(solved.coefficients, self.rho)
        count = n_motions or count_by_eigengap(affinity)
        sizes = [p for p in _PIECES if count < p <= len(affinity) // _POINTS_PER_PIECE]
        pieces = [spectral_clustering(affinity, p, rng, n_restarts=self.restarts) for p in (count, *sizes)]
        bodies, planes = (
            _ViewGroups(views, affinity, self.noise, self.cut, kind) for kind in ("fundamental", "homography")
        )
        by_bodies, by_planes = bodies.best(pieces, count), planes.best(pieces[:2], count)
        more = planes.log_variance(by_planes[0]) - bodies.log_variance(by_bodies[0])
        labels, refined = by_planes if more <= _PLANES else by_bodies
        report: dict[str, Any] = {"pairs": len(views), "n_motions": count}
        report |= {"residual": solved.convergence.residual, **refined.report("reassignment_")}
        return Segmentation.of_part(labels, used, report)


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
        pair = frame_pair(trajectories, first, first + apart)
        if len(pair.rows) > 1:
            x1, x2 = (np.column_stack([x, np.ones(len(x))]) for x in (pair.x1, pair.x2))
            products = (x2[:, :, None] * x1[:, None, :]).reshape(len(x1), 9)
            view = np.zeros((9, len(trajectories)))
            view[:, pair.rows] = (products / np.linalg.norm(products, axis=1, keepdims=True)).T
            views.append(view)
    return np.array(views).reshape(len(views), 9, len(trajectories))


def _collaborative_representation(
    views: FloatArray, alpha: float, penalty: float, iterations: int
) -> Representation:
    """Solve step 2 by ADMM; coefficients are the sum of magnitudes over the views.

    The programme falls apart into one for each column of C; they are solved a few at a time, in single
    precision. `penalty`, of the splitting of C into a fitted and a sparse copy, changes the way, not the
    solution. All columns take the same steps: one that stopped by itself would not compare with the others.
    """
    # Mixed norm: Li, Guo, Cheong, Zhou, section 3; splitting: Elhamifar and Vidal, TPAMI 2013, algorithm 2.
    n = views.shape[2]
    _, values, right = np.linalg.svd(np.sqrt(alpha) * views, full_matrices=False)
    gain = (values**2 / (values**2 + penalty))[:, None, :].astype(np.float32)
    coefficients, residual = np.empty((n, n)), 0.0
    for start in range(0, n, _BLOCK):
        block = _Columns(right.astype(np.float32), gain, penalty, np.arange(start, min(start + _BLOCK, n)))
        residual = max(residual, *[block.step() for _ in range(iterations)][-1:])
        coefficients[:, block.columns] = np.abs(block.sparse).sum(axis=0).T
    return Representation(coefficients, Convergence(True, iterations, residual))


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
        """Return the largest violation of the constraint, or change if it is larger."""
        fitted = 2 * self.sparse - self.raw
        fitted += ((self.left[:, self.columns] - fitted @ self.left) * self.gain) @ self.right
        self.raw += fitted - self.sparse
        size = np.sqrt(np.einsum("vjn,vjn->jn", self.raw, self.raw))
        keep = np.maximum(1 - 1 / np.maximum(self.penalty * size, 1), 0)
        keep[np.arange(len(self.columns)), self.columns] = 0
        before, self.sparse = self.sparse, self.raw * keep
        return max(float(np.abs(fitted - self.sparse).max()), float(np.abs(self.sparse - before).max()))


class _ViewGroups:
    """The cost of step 4, of groups of the N trajectories of `views`, and partitions that cost little."""

    def __init__(
        self, views: FloatArray, affinity: FloatArray, noise: float, weight: float, kind: ModelKind
    ) -> None:
        self.affinity, self.noise, self.weight, self.kind = affinity, noise, weight, kind
        self.numbers = 1 if kind == "fundamental" else 2
        # The last row of x' x^T is x, the last column x', both at the scale of w.
        rows = [np.flatnonzero(view.any(axis=0)) for view in views]
        scaled = [view[:, r] / view[8, r] for view, r in zip(views, rows, strict=True)]
        points = [(w[6:8].T, w[2:8:3].T) for w in scaled]
        self.pairs = [(r, *x, _moments(kind, *x)) for r, x in zip(rows, points, strict=True)]

    def best(self, pieces: list[IntArray], count: int) -> tuple[IntArray, Convergence]:
        """Merge each of several partitions, reassign, and take the cheapest of what results."""
        found = [self.reassign(self.merge(each, count), _MOST_SWEEPS) for each in pieces]
        return min(found, key=lambda each: self.cost(each[0]))

    def cost(self, labels: IntArray) -> float:
        """Cost of the groups 1..K of `labels` (N,)."""
        return float(self._costs(_masks(labels)).sum())

    def log_variance(self, labels: IntArray) -> float:
        """Mean logarithm of the variance that groups leave, over trajectories and views."""
        return 2 / self.numbers * float(self._nats(_masks(labels)).sum())

    def merge(self, labels: IntArray, count: int) -> IntArray:
        """Merge two groups at a time, those whose union lowers the cost most, until `count` are left."""
        groups = [*_masks(labels)]
        costs = self._costs(np.array(groups)).tolist()
        rise = np.full((len(groups), len(groups)), np.inf)
        first, second = np.triu_indices(len(groups), 1)
        while len(groups) > count:
            if len(first):
                unions = np.array([groups[a] | groups[b] for a, b in zip(first, second, strict=True)])
                rise[first, second] = self._costs(unions) - np.take(costs, first) - np.take(costs, second)
            a, b = divmod(int(rise.argmin()), len(groups))
            costs[a] += costs.pop(b) + float(rise[a, b])
            groups[a] = groups[a] | groups.pop(b)
            rise = np.delete(np.delete(rise, b, axis=0), b, axis=1)
            others = np.delete(np.arange(len(groups)), a)
            first, second = np.minimum(a, others), np.maximum(a, others)
        return np.asarray(np.stack(groups).argmax(axis=0) + 1)

    def reassign(self, labels: IntArray, max_iterations: int) -> tuple[IntArray, Convergence]:
        """Give every trajectory to the group whose geometry fits it best, and fit again.

        Distances from a group's matrix are taken for Gaussian with the group's own variance in the view; the
        nats are averaged over the views that see the trajectory and at least nine of the group. No group
        becomes empty: this ends when one would. A trajectory that no view decides keeps its label. The
        convergence is that of the share of trajectories that moved.
        """
        emptied = False

        def step() -> float:
            nonlocal labels, emptied
            masks = _masks(labels)
            nats, views = np.zeros(masks.shape), np.zeros(masks.shape)
            for rows, number, variance, squares in self._residuals(masks):
                known = (number > 8)[:, None]
                each = squares / variance[:, None] + self.numbers * np.log(variance)[:, None]
                nats[:, rows] += np.where(known, each / 2, 0)
                views[:, rows] += known
            nats = np.divide(nats, views, out=np.full(nats.shape, _LARGEST), where=views > 0)
            moved = np.where((nats < _LARGEST).any(axis=0), nats.argmin(axis=0) + 1, labels)
            if emptied := len(np.unique(moved)) < len(masks):
                return 0.0
            before, labels = labels, moved
            return float((before != labels).mean())

        convergence = iterate(step, tolerance=0.0, max_iterations=max_iterations)
        return labels, replace(convergence, converged=convergence.converged and not emptied)

    def _costs(self, masks: BoolArray) -> FloatArray:
        """Costs (G,) of groups (G, N)."""
        weights = masks @ self.affinity
        inside, total = (weights * masks).sum(axis=1), np.maximum(weights.sum(axis=1), 1e-300)
        return np.asarray(self._nats(masks) + self.weight * (1 - inside / total))

    def _nats(self, masks: BoolArray) -> FloatArray:
        nats = sum(number * np.log(variance) for _, number, variance, _ in self._residuals(masks))
        return np.asarray(self.numbers / 2 * nats / sum(len(rows) for rows, *_ in self.pairs))

    def _residuals(self, masks: BoolArray) -> Iterator[tuple[IntArray, FloatArray, FloatArray, FloatArray]]:
        """Per view, the n trajectories it sees, and of groups (G, N) what follows.

        How many of these are in each (G,), their variance per number (G,), and squared Sampson distances
        (G, n) from the matrix of least algebraic error.
        """
        for rows, x1, x2, moments in self.pairs:
            inside = masks[:, rows].astype(np.float64)
            number = inside.sum(axis=1)
            _, vectors = np.linalg.eigh((inside @ moments).reshape(-1, 9, 9))
            distance = MODELS[self.kind].residuals["sampson"](vectors[:, :, 0].reshape(-1, 3, 3), x1, x2).T
            # Both points epipoles: on every line.
            distance = np.minimum(np.nan_to_num(distance, nan=0 if self.numbers == 1 else _FAR), _FAR)
            variance = (distance * inside).sum(axis=1) / np.maximum(self.numbers * number, 1)
            yield rows, number, variance + self.noise**2, distance


def _masks(labels: IntArray) -> BoolArray:
    """Tell the groups of labels (N,) apart, (K, N)."""
    return np.asarray(np.unique(labels)[:, None] == labels)


def _moments(kind: ModelKind, x1: FloatArray, x2: FloatArray) -> FloatArray:
    """Products (n, 81) of the linear equations that points (n, 2) pose to the nine entries of a matrix."""
    first, second = (np.column_stack([x, np.ones(len(x))]) for x in (x1, x2))
    if kind == "fundamental":
        equations = (second[:, :, None] * first[:, None]).reshape(-1, 1, 9)
        equations /= np.linalg.norm(equations, axis=2, keepdims=True)
    else:  # x' (h3 x) - h1 x = 0, y' (h3 x) - h2 x = 0
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        equations = np.zeros((len(x1), 2, 9))
        equations[:, 0, :3] = equations[:, 1, 3:6] = -first
        equations[:, :, 6:] = x2[:, :, None] * first[:, None]
    return np.asarray(equations.transpose(0, 2, 1) @ equations).reshape(-1, 81)
