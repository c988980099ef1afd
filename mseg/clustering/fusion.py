"""Fusion of views: spectral embeddings that agree, and normalised cuts of one partition in all graphs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise, starmap
from typing import Any

import numpy as np

from kt3dmoseg.types import FloatArray, IntArray
from mseg.clustering.spectral import GraphLaplacian, Symmetric, fixed_sign, smallest_subspace, unit_rows

# Residuals of the eigenvectors, of the first sweeps and of the last: an objective is off by their square.
_ROUGH, _ACCURATE = 1e-4, 1e-5
# Entries of a matrix computed at once: they stay in the cache.
_BLOCK_ENTRIES = 1 << 17
# Points up to which the subset constraint is in double precision. Above, its weight takes the error of single
# precision below that of the eigenvectors.
_DOUBLE = 250


@dataclass(frozen=True, eq=False)
class Fusion:
    """Embeddings of the views after they have been made to agree."""

    embeddings: tuple[FloatArray, ...]  # (N, K) each: one orthonormal embedding per view
    objectives: tuple[float, ...]  # the monitored objective after every sweep over the views
    converged: bool  # whether the last two objectives differ by less than the tolerance

    def joint(self) -> FloatArray:
        """All embeddings side by side, (N, V * K): unit rows per view, then unit rows overall."""
        return unit_rows(np.concatenate([unit_rows(u) for u in self.embeddings], axis=1))

    def view(self, index: int) -> FloatArray:
        """One view's embedding with unit rows, (N, K)."""
        return unit_rows(self.embeddings[index])


def coregularise(
    laplacians: Sequence[Symmetric], n_clusters: int, *, weight: float, tolerance: float, max_sweeps: int
) -> Fusion:
    """Embed views by their normalised Laplacians (N, N), arrays or `GraphLaplacian`, so that they agree.

    Minimise sum_v tr(U_v^T L_v U_v) - weight * sum_{v != w} tr(U_v U_v^T U_w U_w^T) over orthonormal
    U_v (N, K), one view after the other: U_v takes the eigenvectors of the smallest eigenvalues of
    L_v - weight * sum_{w != v} U_w U_w^T. The objectives are sum_v tr(U_v^T L'_v U_v), L'_v as it was when
    the view was updated; sweeps over the views end when it changes by less than the tolerance.
    """
    # Kumar, Rai, Daume, "Co-regularized multi-view spectral clustering", NIPS 2011; Xu, Cheong, Li, CVPR
    # 2018, section 3.2: weight is lambda.

    def others(embeddings: list[FloatArray], view: int) -> FloatArray:
        return np.concatenate([u for w, u in enumerate(embeddings) if w != view], axis=1)

    def earned(embeddings: list[FloatArray], view: int) -> float:
        return float(((others(embeddings, view).T @ embeddings[view]) ** 2).sum())

    def agreement(embeddings: list[FloatArray], view: int) -> Symmetric:
        return _LowRank(others(embeddings, view))

    return _alternate(laplacians, n_clusters, agreement, earned, weight, tolerance, max_sweeps)


def constrain_subsets(
    laplacians: Sequence[Symmetric], n_clusters: int, *, weight: float, tolerance: float, max_sweeps: int
) -> Fusion:
    """Embed views of which each model contains the one before, the smallest first; see `coregularise`.

    Affine inliers are homography inliers, homography inliers are fundamental matrix inliers, so
    points together in a smaller model should be together in the larger (its kernel max(K, 0) is
    rewarded there), and points apart in the larger should be apart in the smaller (min(K, 0)).
    With K_v = U_v U_v^T, U_v takes the eigenvectors of the smallest eigenvalues of
    L_v - weight * (max(K_{v-1}, 0) + min(K_{v+1}, 0)), one view after the other. The objectives are
    sum_v tr(U_v^T (L_v - weight Q_v) U_v), Q_v taken after the sweep; they need not decrease, since Q
    changes with the embeddings.
    """
    # Xu, Cheong, Li, CVPR 2018, section 3.2, equations of the subset constraint: weight is gamma.

    def nesting(embeddings: list[FloatArray], view: int) -> Symmetric:
        size = len(embeddings[view])
        total: Symmetric = np.zeros((size, size), np.float64 if size <= _DOUBLE else np.float32)
        for clip, other in ((np.maximum, view - 1), (np.minimum, view + 1)):
            if 0 <= other < len(embeddings):
                u = embeddings[other].astype(total.dtype)
                for rows in _blocks(size):
                    total[rows] += clip(u[rows] @ u.T, 0)
        return total

    def earned(embeddings: list[FloatArray], view: int) -> float:
        complete = view == len(embeddings) - 1
        return sum(starmap(_nested, pairwise(embeddings))) if complete else 0.0

    return _alternate(laplacians, n_clusters, nesting, earned, weight, tolerance, max_sweeps)


def _alternate(
    laplacians: Sequence[Symmetric],
    n_clusters: int,
    reward: Callable[[list[FloatArray], int], Symmetric],
    earned: Callable[[list[FloatArray], int], float],
    weight: float,
    tolerance: float,
    max_sweeps: int,
) -> Fusion:
    """Update one view after the other; the objective gets what was `earned` after each update."""
    subspaces = [smallest_subspace(laplacian, n_clusters, tolerance=_ROUGH)[1] for laplacian in laplacians]
    embeddings = [subspace[:, :n_clusters] for subspace in subspaces]
    objectives: list[float] = []
    change = np.inf
    while len(objectives) < max_sweeps and change >= tolerance:
        # An error of the objective far below what the sweep before has changed.
        accuracy = min(max(0.01 * np.sqrt(change), _ACCURATE), _ROUGH)
        value = 0.0
        for view, laplacian in enumerate(laplacians):
            target = WeightedSum((1.0, laplacian), (-weight, reward(embeddings, view)))
            start = subspaces[view]
            _, subspaces[view] = smallest_subspace(target, n_clusters, start=start, tolerance=accuracy)
            embeddings[view] = subspaces[view][:, :n_clusters]
            smoothness = np.einsum("nk,nk->", embeddings[view], laplacian @ embeddings[view])
            value += float(smoothness) - weight * earned(embeddings, view)
        change = abs(value - objectives[-1]) if objectives else np.inf
        objectives.append(value)
    return Fusion(tuple(map(fixed_sign, embeddings)), tuple(objectives), change < tolerance)


class WeightedSum:
    """A sum of symmetric matrices of one shape, each times its weight, as something to multiply with."""

    def __init__(self, *terms: tuple[float, Symmetric]) -> None:
        self.terms, self.shape = terms, terms[0][1].shape

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> FloatArray:  # noqa: ANN401
        return np.asarray(sum(weight * np.asarray(matrix) for weight, matrix in self.terms))

    def __matmul__(self, vectors: FloatArray) -> FloatArray:
        """Multiply with (N, b), an array in single precision in that."""
        total = np.zeros_like(vectors)
        for weight, matrix in self.terms:
            product = matrix @ vectors.astype(getattr(matrix, "dtype", np.float64), copy=False)
            total += weight * product.astype(np.float64, copy=False)
        return total


class _LowRank:
    """U U^T of a thin factor U (N, b)."""

    def __init__(self, factor: FloatArray) -> None:
        self.factor, self.shape = factor, (len(factor),) * 2

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> FloatArray:  # noqa: ANN401
        return np.asarray(self.factor @ self.factor.T)

    def __matmul__(self, vectors: FloatArray) -> FloatArray:
        return np.asarray(self.factor @ (self.factor.T @ vectors))


def _nested(smaller: FloatArray, larger: FloatArray) -> float:
    """Traces of U_L^T max(S, 0) U_L and U_S^T min(L, 0) U_S, S and L the kernels of the embeddings U."""
    total = 0.0
    for rows in _blocks(len(smaller)):
        small, large = smaller[rows] @ smaller.T, larger[rows] @ larger.T
        total += float(np.vdot(np.maximum(small, 0), large) + np.vdot(np.minimum(large, 0), small))
    return total


def _blocks(size: int) -> list[slice]:
    """Blocks of rows of a square matrix that stay in the cache."""
    rows = max(1, _BLOCK_ENTRIES // max(1, size))
    return [slice(start, start + rows) for start in range(0, size, rows)]


@dataclass(frozen=True, eq=False)
class Cut:
    """A partition and what it cuts."""

    labels: IntArray  # (N,): cluster of each vertex, 0..K-1
    value: float  # over graphs and clusters, the weight that leaves a cluster divided by all its weight


def lower_cut(graphs: Sequence[GraphLaplacian], labels: IntArray, n_clusters: int) -> Cut:
    """Improve a partition (N,) until its normalised cuts, summed over the graphs, become no smaller.

    With S_v the indicators of the clusters, scaled by D_v^1/2 and to unit length, the cut of graph v
    is tr(S_v^T L_v S_v): what a spectral embedding minimises, but for a partition instead of any
    orthonormal columns. All vertices move at once, each to the cluster whose weighted kernel mean is
    nearest over all graphs; the last step that gained something is kept. No cluster is emptied; one that is
    empty counts 1 per graph.
    """
    # Shi and Malik, "Normalized cuts and image segmentation", PAMI 2000; Dhillon, Guan, Kulis, "Weighted
    # graph cuts without eigenvectors: a multilevel approach", PAMI 2007, for one graph.
    value, nearness = _cut(graphs, labels, n_clusters)
    while True:
        moved = nearness.argmax(axis=1)
        if len(np.unique(moved)) < len(np.unique(labels)):
            return Cut(labels, value)
        lower, nearness = _cut(graphs, moved, n_clusters)
        if lower >= value:
            return Cut(labels, value)
        labels, value = moved, lower


def _cut(graphs: Sequence[GraphLaplacian], labels: IntArray, n_clusters: int) -> tuple[float, FloatArray]:
    """Value of a partition, and how near every vertex is to every cluster, (N, K)."""
    indicator = (labels[:, None] == np.arange(n_clusters)).astype(np.float64)
    nearness = np.zeros_like(indicator)
    value = 0.0
    for graph in graphs:
        root = graph.root_degree[:, None]
        scaled = root * indicator
        weight = np.einsum("nk,nk->k", scaled, scaled)
        weight[weight == 0] = np.inf
        smooth = scaled - graph @ scaled
        share = np.einsum("nk,nk->k", scaled, smooth) / weight
        value += float((1 - share).sum())
        nearness += root * (2 * smooth - root * share) / weight
    return value, nearness
