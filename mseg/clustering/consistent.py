"""A shared affinity under several views: consistent to all of them, with what each view adds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import eigh

from kt3dmoseg.types import FloatArray, IntArray
from mseg.clustering.eigen import smallest_subspace
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
        The squared change of C, or that of all D_v together if it is larger, against the tolerance.
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
        Stop when neither the squared Frobenius norm of the change of C nor that of all D_v exceeds it.
    max_iterations : int
        Cap on sweeps.

    Notes
    -----
    Where no view has weight, C is zero and D_v is `smallest` from the first sweep on, so that the sweeps
    run over the E pairs with weight in some view: O(E (V + K)) each, and a few products with the
    Laplacian, whose eigenvectors start from those of the sweep before.

    References
    ----------
    Jiang, Xu, Ma, Yang, Cao, Huang, "What to select: pursuing consistent motion segmentation from multiple
    geometric models", AAAI 2021, problem and updates as in the authors' code; the last term: Lu, Feng, Lin,
    Mei, Yan, "Subspace clustering by block diagonal representation", TPAMI 2019.
    """
    search = _Search(np.asarray(views), n_clusters, specific_weight, rank_weight, largest, smallest)
    convergence = iterate(search.sweep, tolerance=tolerance, max_iterations=max_iterations)
    return ConsistentAffinity(*search.dense(), convergence)


@dataclass(eq=False)
class _Search:
    """State of the alternating minimisation, entries above the diagonal where some view has weight."""

    views: FloatArray
    n_clusters: int
    specific_weight: float
    rank_weight: float
    largest: float
    smallest: float
    edges: tuple[IntArray, IntArray] = field(init=False)
    weights: FloatArray = field(init=False)
    shared: FloatArray = field(init=False)
    specific: FloatArray = field(init=False)
    apart: FloatArray = field(init=False)
    subspace: FloatArray | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        first, second = np.nonzero(np.triu(self.views.any(axis=0), 1))
        self.edges = first.astype(np.int64), second.astype(np.int64)
        self.weights = self.views[:, first, second].astype(np.float64)
        self.shared = np.ones(self.weights.shape[1])
        self.specific = np.zeros_like(self.weights)
        # W starts as the identity.
        self.apart = np.full_like(self.shared, 2.0)

    def sweep(self) -> float:
        """Update D_v, C and W once; return the larger squared change of C and of all D_v."""
        fit = self.shared / (self.shared**2 + self.specific_weight)
        specific = np.maximum(fit * self.weights, self.smallest)
        shared = self._shared(specific)
        moved = 2 * max(((shared - self.shared) ** 2).sum(), ((specific - self.specific) ** 2).sum())
        self.shared, self.specific = shared, specific
        self._separate()
        return float(moved)

    def dense(self) -> tuple[FloatArray, FloatArray]:
        """Return C (N, N) and D_v (V, N, N)."""
        first, second = self.edges
        specific = np.full(self.views.shape, self.smallest)
        specific[:, first, second] = specific[:, second, first] = self.specific
        return self._graph(), specific

    def _shared(self, specific: FloatArray) -> FloatArray:
        """Minimise over symmetric C: entry by entry, C_ij and C_ji together."""
        explained = np.einsum("ve,ve->e", specific, self.weights)
        weight = np.einsum("ve,ve->e", specific, specific)
        numerator = 2 * explained - self.rank_weight * self.apart
        return np.asarray(np.clip(numerator / (2 * weight + _RIDGE), 0, self.largest))

    def _separate(self) -> None:
        """Update W, of which the sweeps need W_ii + W_jj - 2 W_ij alone: squared distances of its factors."""
        laplacian = -self._graph()
        np.fill_diagonal(laplacian, -laplacian.sum(axis=1))
        factors, self.subspace = component_factors(laplacian, self.n_clusters, self.subspace)
        first, second = self.edges
        self.apart = ((factors[first] - factors[second]) ** 2).sum(axis=1)

    def _graph(self) -> FloatArray:
        first, second = self.edges
        graph = np.zeros(self.views.shape[1:])
        graph[first, second] = graph[second, first] = self.shared
        return graph


def component_factors(
    laplacian: FloatArray, n_clusters: int, start: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Minimise ``<laplacian, W>`` over 0 <= W <= I of trace K.

    Parameters
    ----------
    laplacian : (N, N) float64
        Symmetric.
    n_clusters : int
        Trace K, at most N.
    start : (N, m) float64, optional
        `subspace` of a matrix nearby.

    Returns
    -------
    factors : (N, b) float64
        W is ``factors @ factors.T``: the projector on the eigenvectors of the K smallest eigenvalues. Where
        the K-th eigenvalue equals the next (within 1e-6), all eigenvectors of that value share what is left
        of the trace, so that the result does not depend on the basis that the solver happened to choose.
    subspace : (N, m) float64
        Start for the next call.
    """
    subspace = smallest_subspace(laplacian, n_clusters, start=start)
    last = subspace[:, n_clusters - 1 : n_clusters + 1]
    values = np.einsum("ik,ik->k", last, laplacian @ last)
    if n_clusters == len(laplacian) or values[1] - values[0] >= _TIE:
        return subspace[:, :n_clusters], subspace
    return _shared_factors(laplacian, float(values[0]), n_clusters), subspace


def _shared_factors(laplacian: FloatArray, tied: float, n_clusters: int) -> FloatArray:
    values, vectors = eigh(laplacian, subset_by_value=(-np.inf, tied + _TIE), check_finite=False)
    below = values < tied - _TIE
    share = np.where(below, 1.0, (n_clusters - below.sum()) / (~below).sum())
    return np.asarray(vectors * np.sqrt(share))
