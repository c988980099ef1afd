"""Multi-view spectral clustering: pairwise co-regularisation and the subset constraint."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import FloatArray
from mseg.clustering.laplacian import smallest_eigenvectors, unit_rows

_Array = npt.NDArray[Any]
_Reward: TypeAlias = Callable[[list[FloatArray], int], FloatArray]


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
    laplacians: Sequence[_Array],
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
    laplacians : sequence of V arrays (N, N)
        Normalised Laplacians of the views.
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

    def agreement(embeddings: list[FloatArray], view: int) -> FloatArray:
        others = np.concatenate([u for w, u in enumerate(embeddings) if w != view], axis=1)
        out: FloatArray = others @ others.T
        return out

    return _alternate(laplacians, n_clusters, agreement, weight, tolerance, max_sweeps, monitor_last=False)


def constrain_subsets(
    laplacians: Sequence[_Array],
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
    laplacians : sequence of V arrays (N, N)
        Normalised Laplacians, the smallest model first: affine, homography, fundamental.
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

    def nesting(embeddings: list[FloatArray], view: int) -> FloatArray:
        reward = np.zeros((len(embeddings[view]),) * 2)
        if view > 0:
            reward += np.maximum(embeddings[view - 1] @ embeddings[view - 1].T, 0.0)
        if view + 1 < len(embeddings):
            reward += np.minimum(embeddings[view + 1] @ embeddings[view + 1].T, 0.0)
        return reward

    return _alternate(laplacians, n_clusters, nesting, weight, tolerance, max_sweeps, monitor_last=True)


def _alternate(
    laplacians: Sequence[_Array],
    n_clusters: int,
    reward: _Reward,
    weight: float,
    tolerance: float,
    max_sweeps: int,
    *,
    monitor_last: bool,
) -> Fusion:
    if len({laplacian.shape for laplacian in laplacians}) != 1:
        shapes = ", ".join(str(laplacian.shape) for laplacian in laplacians)
        raise InvalidValueError("laplacians", expected="at least one, all of one shape", found=shapes or "none")
    embeddings = [smallest_eigenvectors(laplacian, n_clusters) for laplacian in laplacians]
    objectives: list[float] = []
    converged = False
    while len(objectives) < max_sweeps and not converged:
        value = 0.0
        for view, laplacian in enumerate(laplacians):
            target = laplacian - weight * reward(embeddings, view)
            embeddings[view] = smallest_eigenvectors(target, n_clusters)
            value += _trace(target, embeddings[view])
        if monitor_last:
            value = sum(
                _trace(laplacian - weight * reward(embeddings, view), embeddings[view])
                for view, laplacian in enumerate(laplacians)
            )
        converged = bool(objectives) and abs(value - objectives[-1]) < tolerance
        objectives.append(value)
    return Fusion(tuple(embeddings), tuple(objectives), converged)


def _trace(matrix: _Array, vectors: FloatArray) -> float:
    return float(np.einsum("nk,nk->", vectors, matrix @ vectors))
