"""Multi-view spectral clustering: pairwise co-regularisation and the subset constraint."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise, starmap

import numpy as np

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import FloatArray
from mseg.clustering.eigen import fixed_sign, smallest_subspace
from mseg.clustering.laplacian import unit_rows
from mseg.clustering.nesting import Nesting, nested
from mseg.clustering.symmetric import LowRank, Symmetric, WeightedSum

# Residuals of the eigenvectors, of the first sweeps and of the last: an objective is off by their square.
_ROUGH, _ACCURATE = 1e-4, 1e-5


@dataclass(frozen=True, eq=False)
class Fusion:
    """Embeddings of the views after they have been made to agree.

    Parameters
    ----------
    embeddings : tuple of (N, K) float64
        One orthonormal embedding per view.
    objectives : tuple of float
        Value of the monitored objective after every sweep over the views.
    converged : bool
        Whether the last two objectives differ by less than the tolerance.
    """

    embeddings: tuple[FloatArray, ...]
    objectives: tuple[float, ...]
    converged: bool

    def joint(self) -> FloatArray:
        """All embeddings side by side, (N, V * K): unit rows per view, then unit rows overall."""
        return unit_rows(np.concatenate([unit_rows(u) for u in self.embeddings], axis=1))

    def view(self, index: int) -> FloatArray:
        """One view's embedding with unit rows, (N, K)."""
        return unit_rows(self.embeddings[index])


def coregularise(
    laplacians: Sequence[Symmetric],
    n_clusters: int,
    *,
    weight: float = 0.01,
    tolerance: float = 1e-6,
    max_sweeps: int = 16,
) -> Fusion:
    """Pairwise co-regularised spectral embedding of several views.

    Minimise sum_v tr(U_v^T L_v U_v) - weight * sum_{v != w} tr(U_v U_v^T U_w U_w^T) over orthonormal
    U_v, one view after the other: U_v takes the eigenvectors of the smallest eigenvalues of
    L_v - weight * sum_{w != v} U_w U_w^T.

    Parameters
    ----------
    laplacians : sequence of V matrices (N, N)
        Normalised Laplacians, arrays or `mseg.clustering.GraphLaplacian` of the views.
    n_clusters : int
        Number K of eigenvectors.
    weight : float
        lambda of the paper.
    tolerance : float
        Stop when the monitored objective changes by less.
    max_sweeps : int
        Most sweeps over the views.

    Returns
    -------
    Fusion
        Its objectives are sum_v tr(U_v^T L'_v U_v), L'_v as it was when the view was updated.

    References
    ----------
    Kumar, Rai, Daume, "Co-regularized multi-view spectral clustering", NIPS 2011; Xu, Cheong, Li,
    CVPR 2018, section 3.2.
    """

    def agreement(embeddings: list[FloatArray], view: int) -> LowRank:
        return LowRank(np.concatenate([u for w, u in enumerate(embeddings) if w != view], axis=1))

    def earned(embeddings: list[FloatArray], view: int) -> float:
        return float(((agreement(embeddings, view).factor.T @ embeddings[view]) ** 2).sum())

    return _alternate(laplacians, n_clusters, agreement, earned, weight, tolerance, max_sweeps)


def constrain_subsets(
    laplacians: Sequence[Symmetric],
    n_clusters: int,
    *,
    weight: float = 0.01,
    tolerance: float = 1e-8,
    max_sweeps: int = 21,
) -> Fusion:
    """Spectral embedding of views of which each model contains the one before.

    Affine inliers are homography inliers, homography inliers are fundamental matrix inliers, so
    points together in a smaller model should be together in the larger (its kernel max(K, 0) is
    rewarded there), and points apart in the larger should be apart in the smaller (min(K, 0)).
    With K_v = U_v U_v^T, U_v takes the eigenvectors of the smallest eigenvalues of
    L_v - weight * (max(K_{v-1}, 0) + min(K_{v+1}, 0)), one view after the other.

    Parameters
    ----------
    laplacians : sequence of V matrices (N, N)
        Normalised Laplacians, arrays or `mseg.clustering.GraphLaplacian`, the smallest model first:
        affine, homography, fundamental.
    n_clusters : int
        Number K of eigenvectors.
    weight : float
        gamma of the paper.
    tolerance : float
        Stop when the monitored objective changes by less.
    max_sweeps : int
        Most sweeps over the views.

    Returns
    -------
    Fusion
        Its objectives are sum_v tr(U_v^T (L_v - weight Q_v) U_v), Q_v taken after the sweep; they
        need not decrease, since Q changes with the embeddings.

    References
    ----------
    Xu, Cheong, Li, CVPR 2018, section 3.2, equations of the subset constraint.
    """

    def nesting(embeddings: list[FloatArray], view: int) -> LowRank | Nesting:
        if len(embeddings) == 1:
            return LowRank(np.zeros((len(embeddings[0]), 1)))
        smaller = embeddings[view - 1] if view > 0 else None
        larger = embeddings[view + 1] if view + 1 < len(embeddings) else None
        return Nesting(smaller, larger, len(embeddings[view]))

    def earned(embeddings: list[FloatArray], view: int) -> float:
        complete = view == len(embeddings) - 1
        return sum(starmap(nested, pairwise(embeddings))) if complete else 0.0

    return _alternate(laplacians, n_clusters, nesting, earned, weight, tolerance, max_sweeps)


def _alternate(
    laplacians: Sequence[Symmetric],
    n_clusters: int,
    reward: Callable[[list[FloatArray], int], LowRank | Nesting],
    earned: Callable[[list[FloatArray], int], float],
    weight: float,
    tolerance: float,
    max_sweeps: int,
) -> Fusion:
    """Update one view after the other; `earned` tells what the objective gets after each update."""
    if len({laplacian.shape for laplacian in laplacians}) != 1:
        shapes = ", ".join(str(laplacian.shape) for laplacian in laplacians)
        raise InvalidValueError(
            "laplacians", expected="at least one, all of one shape", found=shapes or "none"
        )
    subspaces = [smallest_subspace(laplacian, n_clusters, tolerance=_ROUGH) for laplacian in laplacians]
    embeddings = [subspace[:, :n_clusters] for subspace in subspaces]
    objectives: list[float] = []
    change = np.inf
    while len(objectives) < max_sweeps and change >= tolerance:
        # An error of the objective far below what the sweep before has changed.
        accuracy = min(max(0.01 * np.sqrt(change), _ACCURATE), _ROUGH)
        value = 0.0
        for view, laplacian in enumerate(laplacians):
            target = WeightedSum((1.0, laplacian), (-weight, reward(embeddings, view)))
            subspaces[view] = smallest_subspace(target, n_clusters, start=subspaces[view], tolerance=accuracy)
            embeddings[view] = subspaces[view][:, :n_clusters]
            smoothness = np.einsum("nk,nk->", embeddings[view], laplacian @ embeddings[view])
            value += float(smoothness) - weight * earned(embeddings, view)
        change = abs(value - objectives[-1]) if objectives else np.inf
        objectives.append(value)
    return Fusion(tuple(map(fixed_sign, embeddings)), tuple(objectives), change < tolerance)
