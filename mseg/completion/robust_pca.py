"""Robust principal components: a low-rank matrix plus sparse gross errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kt3dmoseg.types import FloatArray
from mseg.iteration import Convergence, iterate


@dataclass(frozen=True, eq=False)
class RobustPCA:
    """Data split into ``low_rank + sparse``, both (D, N) float64, and how the split converged."""

    low_rank: FloatArray
    sparse: FloatArray
    convergence: Convergence


def robust_pca(matrix: FloatArray, *, tolerance: float = 1e-7, max_iterations: int = 1000) -> RobustPCA:
    """Minimise ``|A|_* + weight |E|_1`` subject to ``A + E = X`` by the inexact augmented Lagrangian.

    The weight is ``1 / sqrt(max(D, N))`` (Candes et al. 2011). Missing elements are errors that cost nothing,
    so that the low-rank part alone decides them.

    Parameters
    ----------
    matrix : (D, N) float64
        Data X, NaN where missing.
    tolerance : float
        Stop when ``|X - A - E|_F <= tolerance |X|_F``.
    max_iterations : int
        Cap on iterations, each one singular value decomposition, or for symmetric data the four times
        cheaper eigenvalue decomposition.

    Returns
    -------
    RobustPCA

    References
    ----------
    Lin, Chen, Ma, "The augmented Lagrange multiplier method for exact recovery of corrupted low-rank
    matrices", 2010, algorithm 5 (penalty 1.25 / sigma_1, growth 1.5). Missing elements: Candes, Li, Ma,
    Wright, "Robust principal component analysis?", JACM 2011, section 1.6.
    """
    seen = np.isfinite(matrix)
    matrix = np.where(seen, matrix, 0.0)
    weight = float(1 / np.sqrt(max(matrix.shape)))
    largest, size = float(np.linalg.norm(matrix, 2)), float(np.linalg.norm(matrix))
    if size == 0:
        return RobustPCA(matrix.copy(), np.zeros_like(matrix), Convergence(True, 0, 0.0))
    low_rank, sparse = np.zeros_like(matrix), np.zeros_like(matrix)
    multiplier = matrix / max(largest, np.abs(matrix).max() / weight)
    multiplier *= seen
    price = np.where(seen, weight, 0.0)
    penalty = 1.25 / largest
    cap = penalty * 1e7
    symmetric = matrix.shape[0] == matrix.shape[1] and bool((matrix == matrix.T).all())
    shrunk = _shrink_eigenvalues if symmetric else _shrink_singular_values

    def step() -> float:
        nonlocal low_rank, sparse, multiplier, penalty
        sparse = shrink(matrix - low_rank + multiplier / penalty, price / penalty)
        low_rank = shrunk(matrix - sparse + multiplier / penalty, 1 / penalty)
        gap = matrix - low_rank - sparse
        multiplier = multiplier + penalty * gap
        penalty = min(penalty * 1.5, cap)
        return float(np.linalg.norm(gap) / size)

    convergence = iterate(step, tolerance=tolerance, max_iterations=max_iterations)
    return RobustPCA(low_rank, sparse, convergence)


def shrink(values: FloatArray, threshold: float | FloatArray) -> FloatArray:
    """Soft threshold: the proximal map of ``threshold |.|_1``, element by element."""
    # x - clip(x) touches memory less often than sign(x) * max(|x| - t, 0).
    return np.asarray(values - np.clip(values, -threshold, threshold))


def _shrink_singular_values(matrix: FloatArray, threshold: float) -> FloatArray:
    """Soft threshold of the singular values: the proximal map of ``threshold |.|_*``."""
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    kept = int((values > threshold).sum())
    return np.asarray((left[:, :kept] * (values[:kept] - threshold)) @ right[:kept])


def _shrink_eigenvalues(matrix: FloatArray, threshold: float) -> FloatArray:
    """Do the same for a symmetric matrix: its singular values are ``|lambda|``."""
    values, vectors = np.linalg.eigh(matrix)
    kept = np.abs(values) > threshold
    vectors, values = vectors[:, kept], values[kept]
    return np.asarray((vectors * (values - np.sign(values) * threshold)) @ vectors.T)
