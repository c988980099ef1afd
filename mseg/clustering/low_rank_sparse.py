"""Self-expression that is low-rank and sparse at once."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import FloatArray
from mseg.clustering.self_expressive import (
    Representation,
    ShiftedInverse,
    shrink_leading,
    smallest_coherence,
)
from mseg.completion import shrink
from mseg.iteration import iterate


def low_rank_sparse_representation(
    data: FloatArray,
    *,
    sparsity: float = 0.1,
    alpha: float = 800.0,
    growth: float = 1.1,
    tolerance: float = 2e-4,
    max_iterations: int = 400,
) -> Representation:
    """Minimise nuclear norm, l1 norm and misfit of the coefficients together, by ADMM.

        min |C|_* + sparsity |C|_1 + mu/2 |X - X C|_F^2   s.t.  diag C = 0

    C is split into three copies (of the fit, of the nuclear norm, of the l1 norm with zero diagonal).

    Parameters
    ----------
    data : (D, N) float64
        Points X as columns.
    sparsity : float
        Weight lambda of the l1 norm.
    alpha : float
        ``mu = alpha / min_j max_{i != j} |x_i . x_j|``.
    growth : float
        Factor by which the penalty of the splitting (1 at first) grows.
    tolerance : float
        Stop when no entry of the two splittings' residuals exceeds it.
    max_iterations : int
        Cap, each iteration an N x N symmetric eigenproblem of a few leading vectors.

    Returns
    -------
    Representation
        The sparse copy.

    Raises
    ------
    SegmentationError
        When some point is orthogonal to all others.

    References
    ----------
    Wang, Xu, Leng, "Provable subspace clustering: when LRR meets SSC", NIPS 2013, equation 2 (relaxed for
    noise as in their section 6).
    """
    n = data.shape[1]
    fit = alpha / smallest_coherence(data)
    system = ShiftedInverse(np.sqrt(fit) * data)
    target = fit * (data.T @ data)
    low, sparse = np.zeros((n, n)), np.zeros((n, n))
    y_low, y_sparse = np.zeros((n, n)), np.zeros((n, n))
    penalty = 1.0

    def step() -> float:
        nonlocal low, sparse, y_low, y_sparse, penalty
        c = system.solve(target + penalty * (low + sparse) - y_low - y_sparse, 2 * penalty)
        low = shrink_leading(c + y_low / penalty, 1 / penalty)
        sparse = shrink(c + y_sparse / penalty, sparsity / penalty)
        np.fill_diagonal(sparse, 0)
        y_low += penalty * (c - low)
        y_sparse += penalty * (c - sparse)
        penalty *= growth
        return max(float(np.abs(c - low).max()), float(np.abs(c - sparse).max()))

    convergence = iterate(step, tolerance=tolerance, max_iterations=max_iterations)
    return Representation(sparse, convergence)
