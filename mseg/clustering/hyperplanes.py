"""Groups of correspondences of which each has one epipolar geometry in every pair of frames.

Pairs of frames come as views (V, 9, N): columns ``w = vec(x' x^T)``, x and x' homogeneous, at any scale;
zero columns where a pair does not see a trajectory. ``f . w = 0`` is a hyperplane of R^9, and f, row by row,
the fundamental matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from kt3dmoseg.types import BoolArray, FloatArray, IntArray
from mseg.iteration import Convergence, iterate

_LARGEST = float(np.finfo(np.float64).max)


@dataclass(frozen=True, eq=False)
class EpipolarGroups:
    """What a partition of trajectories costs, and partitions that cost little.

    The cost of groups g is, per trajectory and pair that sees it, the nats that describe its distance from
    the group's fundamental matrix, and the normalised cut of an affinity:

        sum_g (1/T sum_v n_gv/2 log(d_gv + noise^2) + weight cut(g) / degree(g))

    with d_gv the mean squared Sampson distance of the n_gv trajectories of g that view v sees, T the sum of
    all n_gv. Distances alone let K geometries per pair explain wrong groups as well; the cut alone parts the
    largest motion.

    Parameters
    ----------
    views : (V, 9, N) float64
        See the module.
    affinity : (N, N) float64
        Symmetric weights >= 0.
    noise : float
        Distance, in the units of the views, under which nothing is told apart.
    weight : float
        Weight of the cut.
    """

    views: FloatArray
    affinity: FloatArray
    noise: float
    weight: float

    def cost(self, labels: IntArray) -> float:
        """Cost of the groups 1..K of `labels` (N,)."""
        return sum(self._cost(labels == k) for k in np.unique(labels).tolist())

    def merge(self, labels: IntArray, count: int) -> IntArray:
        """Merge two groups at a time, those whose union lowers the cost most, until `count` are left.

        Returns
        -------
        (N,) int64
            Labels 1..min(count, number of groups).
        """
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
        nats are averaged over the views that see the trajectory and at least nine of the group.

        Returns
        -------
        labels : (N,) int64
            Labels 1..K; no group becomes empty, and what nothing is known about keeps its label.
        convergence : Convergence
            Of the share of trajectories that moved.
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
        seen, squares = _distances(self.views[:, :, group], fundamental_matrices(self.views[:, :, group]))
        number = seen.sum(axis=1)
        mean = squares.sum(axis=1) / np.maximum(number, 1)
        nats = float(number @ np.log(mean + self.noise**2)) / 2 / float(self.views.any(axis=1).sum())
        weights = self.affinity[group]
        return nats + self.weight * (1 - float(weights[:, group].sum() / max(weights.sum(), 1e-300)))

    def _mean_nats(self, group: BoolArray) -> FloatArray:
        """Nats (N,) per view as a member of a group; the largest number where no view tells."""
        seen, squares = _distances(self.views, fundamental_matrices(self.views[:, :, group]))
        number = seen[:, group].sum(axis=1)
        variance = squares[:, group].sum(axis=1) / np.maximum(number, 1) + self.noise**2
        telling = seen & (number > self.views.shape[1] - 1)[:, None]
        nats = np.where(telling, (squares / variance[:, None] + np.log(variance)[:, None]) / 2, 0).sum(axis=0)
        views = telling.sum(axis=0)
        return np.asarray(np.divide(nats, views, out=np.full(nats.shape, _LARGEST), where=views > 0))


def fundamental_matrices(views: FloatArray) -> FloatArray:
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
