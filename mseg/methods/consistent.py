"""Consistent motion segmentation (ConsistentMoSeg)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csr_array

from kt3dmoseg.compiled import compiled
from kt3dmoseg.options import option
from kt3dmoseg.types import Float32Array, FloatArray, IntArray, Trajectories
from mseg.clustering.spectral import smallest_eigenvectors, smallest_subspace, unit_rows
from mseg.iteration import Convergence, iterate
from mseg.kernels import GUARD, covisible_frames
from mseg.methods.paper import KINDS, ViewMethod
from mseg.methods.self_expression import keep_largest
from mseg.types import Grouping

ALGORITHM_VERSION: int = 12  # raised when results of this method change
_GUARD = 0.2
_NEGLIGIBLE = 1e-5
# Bounds of C from above and of D_v from below; ridge of C's least squares; eigenvalues that count as equal.
_LARGEST, _SMALLEST, _RIDGE, _TIE = 5.0, 1e-4, 1e-4, 1e-6


@dataclass(frozen=True)
class ConsistentMoSeg(ViewMethod):
    """One graph of K components that all three views share, and what each view adds to it.

    1. Kernels Z_v of the affine, homography and fundamental views, divided by the number of common frames
       plus 0.2, sparsified with alpha = 3, diagonals zero.
    2. ``min sum_v 1/2 |Z_v - C o D_v|^2 + l1/2 |D_v|^2 + l2 <Laplacian of C, W>`` over symmetric
       0 <= C <= 5, D_v >= 1e-4 and 0 <= W <= I of trace K, by turns over D_v, C and W, each in closed form.
       The last term is l2 times the sum of the K smallest eigenvalues of the Laplacian of C, which is zero
       exactly when the graph has K components.
    3. Affinity: the sum of C o D_v, of each column the largest entries that make up
       90 per cent of its sum, then spectral clustering.

    Source: Jiang, Xu, Ma, Yang, Cao, Huang, "What to select: pursuing consistent motion segmentation from
    multiple geometric models", AAAI 2021, and its authors' code; the last term of step 2: Lu, Feng, Lin, Mei,
    Yan, "Subspace clustering by block diagonal representation", TPAMI 2019; l1 = 0.001, l2 = 0.015 are theirs
    for Hopkins155 and MTPV62 (0.005 and 0.05 for Hopkins12, 0.001 and 0.01 for KT3DMoSeg). Deviation: their
    affinity is left unsymmetric by the last step and goes into spectral clustering as such; here it is
    averaged with its transpose, and a small uniform weight is added as in the paper's views.
    Input: gaps allowed. Number of motions: given or found. Outliers: not handled. Cost: that of the three
    views and up to 500 sweeps of O(N^2 K); O(N^2) memory.
    """

    alpha: float = option(3.0, "power of the kernel before neighbours are chosen", low=0)
    specific_weight: float = option(0.001, "weight l1 of the view-specific parts", low=1e-9)
    rank_weight: float = option(0.015, "weight l2 of the graph's K smallest eigenvalues", low=0)
    share: float = option(0.9, "share of a column's sum that is kept", low=0, high=1)
    tolerance: float = option(1e-3, "largest squared change at convergence", low=0)
    max_iterations: int = option(500, "cap on sweeps", low=1)

    def group(self, views: Sequence[csr_array], n_motions: int, rng: np.random.Generator) -> Grouping:
        """Find the shared graph and cut it."""
        kernels = np.array([view.toarray() for view in views])
        shared, specific, convergence = self.solve(kernels, n_motions)
        affinity = shared * specific.sum(axis=0)
        kept = keep_largest(np.where(affinity < _NEGLIGIBLE, 0.0, affinity), self.share)
        graph = self.laplacian(csr_array((kept + kept.T) / 2))
        labels, report = self.read_out(unit_rows(smallest_eigenvectors(graph, n_motions)), n_motions, rng)
        return labels, {"views": list(KINDS), **convergence.report(), **report}

    def rescale(self, kernel: Float32Array, points: Trajectories) -> Float32Array:
        """Divide by the common frames plus 0.2 instead of the paper's 0.1."""
        together = covisible_frames(points)
        scale = (together + np.float32(GUARD)) / (together + np.float32(_GUARD))
        return np.asarray(kernel * scale, dtype=np.float32)

    def solve(self, views: FloatArray, n_clusters: int) -> tuple[FloatArray, FloatArray, Convergence]:
        """Solve step 2 for affinities (V, N, N): C (N, N), D_v (V, N, N), and how the sweeps ended.

        Where no view has weight, C is zero and D_v is its bound from the first sweep on, so that the sweeps
        run over the E pairs with weight in some view, entries above the diagonal. The residual is the squared
        change of C, or that of all D_v together if it is larger.
        """
        first, second = np.nonzero(np.triu(views.any(axis=0), 1))
        weights = np.ascontiguousarray(views[:, first, second].T, dtype=np.float64)
        c, d = np.ones(len(weights)), np.zeros_like(weights)
        # W_ii + W_jj - 2 W_ij is needed: squared distances of the factors of W; at first it is the identity.
        w, subspace = (np.empty((views.shape[1], 0)), 2.0), None
        laplacian = np.zeros(views.shape[1:])

        def sweep() -> float:
            nonlocal w, subspace
            moved = _sweep(
                c, d, laplacian, weights, first, second, *w, self.specific_weight, self.rank_weight
            )
            factors, subspace = _component_factors(laplacian, n_clusters, subspace)
            w = factors, 0.0
            return float(moved)

        convergence = iterate(sweep, tolerance=self.tolerance, max_iterations=self.max_iterations)
        specific = np.full(views.shape, _SMALLEST)
        specific[:, first, second] = specific[:, second, first] = d.T
        np.fill_diagonal(laplacian, 0)
        return -laplacian, specific, convergence


@compiled
def _sweep(
    c: FloatArray,
    d: FloatArray,
    laplacian: FloatArray,
    weights: FloatArray,
    first: IntArray,
    second: IntArray,
    factors: FloatArray,
    diagonal: float,
    specific_weight: float,
    rank_weight: float,
) -> float:
    """Update C (E,), D_v (E, V) and the Laplacian of C (N, N); twice the larger squared change.

    W is F F^T of the factors F (N, K), and half of `diagonal` more on its diagonal.
    """
    moved_c = moved_d = 0.0
    for i in range(len(laplacian)):
        laplacian[i, i] = 0.0
    for e in range(len(c)):
        i, j = first[e], second[e]
        scale = c[e] / (c[e] ** 2 + specific_weight)
        explained, weight, apart = 0.0, 0.0, diagonal
        for v in range(weights.shape[1]):
            value = max(scale * weights[e, v], _SMALLEST)
            moved_d += (value - d[e, v]) ** 2
            d[e, v] = value
            explained += value * weights[e, v]
            weight += value * value
        for k in range(factors.shape[1]):
            apart += (factors[i, k] - factors[j, k]) ** 2
        value = (2 * explained - rank_weight * apart) / (2 * weight + _RIDGE)
        value = min(max(value, 0.0), _LARGEST)
        moved_c += (value - c[e]) ** 2
        c[e] = value
        laplacian[i, j] = laplacian[j, i] = -value
        laplacian[i, i] += value
        laplacian[j, j] += value
    return 2 * max(moved_c, moved_d)


def _component_factors(
    laplacian: FloatArray, n_clusters: int, start: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Minimise ``<laplacian, W>`` over 0 <= W <= I of trace K: F of W = F F^T, and a start for next time.

    W is the projector on the eigenvectors of the K smallest eigenvalues. Where the K-th equals the next, all
    eigenvectors of that value share what is left of the trace, so that the result does not depend on the
    basis that the solver happened to choose.
    """
    # Residuals of 1e-3 leave errors of their square in the eigenvalues, less than a tie.
    values, subspace = smallest_subspace(laplacian, n_clusters, start=start, tolerance=1e-3)
    tied = float(values[n_clusters - 1])
    if n_clusters == len(laplacian) or values[n_clusters] - tied >= _TIE:
        return subspace[:, :n_clusters], subspace
    values, vectors = eigh(laplacian, subset_by_value=(-np.inf, tied + _TIE), check_finite=False)
    below = values < tied - _TIE
    share = np.where(below, 1.0, (n_clusters - below.sum()) / (~below).sum())
    return np.asarray(vectors * np.sqrt(share)), subspace
