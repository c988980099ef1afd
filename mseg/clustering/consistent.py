"""A shared affinity under several views: consistent to all of them, with what each view adds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import eigh

from kt3dmoseg.types import FloatArray
from mseg.iteration import Convergence, iterate

_TIE = 1e-6
_RIDGE = 1e-4


@dataclass(frozen=True, eq=False)
class ConsistentAffinity:
    """Views Z_v split into ``C o D_v``.

    Parameters
    ----------
    shared : (N, N) float64
        Symmetric C, the structure common to the views.
    specific : (V, N, N) float64
        D_v, what each view makes of it.
    convergence : Convergence
        Largest squared change of C or any D_v in the last sweep against the tolerance.
    """

    shared: FloatArray
    specific: FloatArray
    convergence: Convergence

    def affinity(self) -> FloatArray:
        """Sum (N, N) of the symmetric parts of ``C o D_v``."""
        total = self.shared * self.specific.sum(axis=0)
        return np.asarray((total + total.T) / 2)


def consistent_affinity(
    views: Sequence[FloatArray],
    n_clusters: int,
    *,
    specific_weight: float = 0.001,
    rank_weight: float = 0.015,
    largest: float = 5.0,
    smallest: float = 1e-4,
    tolerance: float = 1e-3,
    max_iterations: int = 500,
) -> ConsistentAffinity:
    """Find a graph of K components that, scaled entry by entry, explains several affinities.

    Minimises, by turns over D_v, C and W, each in closed form,

        sum_v 1/2 |Z_v - C o D_v|_F^2 + l1/2 |D_v|_F^2 + l2 <Diag(C 1) - C, W>

    subject to C = C^T in [0, largest] with zero diagonal, D_v >= smallest, 0 <= W <= I and tr W = K.
    The last term is l2 times the sum of the K smallest eigenvalues of the Laplacian of C, which is zero
    exactly when the graph has K components.

    Parameters
    ----------
    views : sequence of (N, N) float
        Symmetric affinities Z_v >= 0; diagonals are ignored.
    n_clusters : int
        Number K of components.
    specific_weight, rank_weight : float
        Weights l1 and l2.
    largest, smallest : float
        Bounds of C from above and of D_v from below.
    tolerance : float
        Stop when no squared Frobenius norm of a change exceeds it.
    max_iterations : int
        Cap on sweeps, each O(N^3) for the eigenvectors.

    References
    ----------
    Jiang, Xu, Ma, Yang, Cao, Huang, "What to select: pursuing consistent motion segmentation from multiple
    geometric models", AAAI 2021, problem and updates as in the authors' code; the last term: Lu, Feng, Lin,
    Mei, Yan, "Subspace clustering by block diagonal representation", TPAMI 2019.
    """
    data = np.array(views, dtype=np.float64)
    data[:, range(data.shape[1]), range(data.shape[1])] = 0
    search = _Search(data, n_clusters, specific_weight, rank_weight, largest, smallest)
    convergence = iterate(search.sweep, tolerance=tolerance, max_iterations=max_iterations)
    return ConsistentAffinity(search.shared, search.specific, convergence)


@dataclass(eq=False)
class _Search:
    """State of the alternating minimisation."""

    views: FloatArray
    n_clusters: int
    specific_weight: float
    rank_weight: float
    largest: float
    smallest: float
    shared: FloatArray = field(init=False)
    specific: FloatArray = field(init=False)
    projector: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        n = self.views.shape[1]
        self.shared = np.ones((n, n)) - np.eye(n)
        self.specific = np.zeros_like(self.views)
        self.projector = np.eye(n)

    def sweep(self) -> float:
        """Update D_v, C and W once; return the largest squared change of C or a D_v."""
        fit = self.shared / (self.shared**2 + self.specific_weight)
        specific = np.maximum(fit * self.views, self.smallest)
        shared = self._shared(specific)
        moved = max(
            float(((shared - self.shared) ** 2).sum()),
            float(((specific - self.specific) ** 2).sum(axis=(1, 2)).max()),
        )
        self.shared, self.specific = shared, specific
        self.projector = component_projector(shared, self.n_clusters)
        return moved

    def _shared(self, specific: FloatArray) -> FloatArray:
        """Minimise over symmetric C: entry by entry, C_ij and C_ji together."""
        explained = np.einsum("vij,vij->ij", specific, self.views)
        weight = np.einsum("vij,vij->ij", specific, specific)
        spread = np.diagonal(self.projector)[:, None] - self.projector
        numerator = explained + explained.T - self.rank_weight * (spread + spread.T)
        shared = np.clip(numerator / (weight + weight.T + _RIDGE), 0, self.largest)
        np.fill_diagonal(shared, 0)
        return np.asarray(shared)


def component_projector(weights: FloatArray, n_clusters: int) -> FloatArray:
    """Minimise ``<Laplacian of weights, W>`` over 0 <= W <= I of trace K.

    Parameters
    ----------
    weights : (N, N) float64
        Symmetric weights >= 0.
    n_clusters : int
        Trace K, at most N.

    Returns
    -------
    (N, N) float64
        Projector on the eigenvectors of the K smallest eigenvalues. Where the K-th eigenvalue equals the
        next (within 1e-6), all eigenvectors of that value share what is left of the trace, so that the
        result does not depend on the basis that the solver happened to choose.
    """
    n = len(weights)
    laplacian = np.diag(weights.sum(axis=1)) - weights
    values, vectors = eigh(laplacian, subset_by_index=(0, min(n_clusters, n - 1)), check_finite=False)
    if n_clusters < n and values[n_clusters] - values[n_clusters - 1] < _TIE:
        limit = (-np.inf, float(values[n_clusters - 1]) + _TIE)
        values, vectors = eigh(laplacian, subset_by_value=limit, check_finite=False)
        below = values < values[n_clusters - 1] - _TIE
        share = np.where(below, 1.0, (n_clusters - below.sum()) / (~below).sum())
        return np.asarray((vectors * share) @ vectors.T)
    vectors = vectors[:, :n_clusters]
    return np.asarray(vectors @ vectors.T)
