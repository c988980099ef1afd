"""Self-expressive models: every trajectory written as a combination of the others.

Data on a union of independent subspaces have combinations that use only columns of the own subspace.
They are sought by convex programmes, solved by alternating directions; the linear systems are solved
through a thin singular value decomposition of the data, so that an iteration costs ``O(N^2 D)`` for
D x N data rather than ``O(N^3)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import FloatArray
from mseg.completion import shrink
from mseg.errors import SegmentationError
from mseg.iteration import Convergence, iterate

# Factor by which a penalty grows from one iteration to the next.
_GROWTH = 1.1
_EPSILON = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class Representation:
    """Coefficients (N, N) float64, column j expressing point j, and how the solver ended."""

    coefficients: FloatArray
    convergence: Convergence


def sparse_representation(
    data: FloatArray,
    *,
    alpha: float = 800.0,
    affine: bool = True,
    weights: FloatArray | float = 1.0,
    start: FloatArray | None = None,
    tolerance: float = 2e-4,
    max_iterations: int = 200,
) -> Representation:
    """Solve the sparse subspace clustering programme by ADMM.

        min sum_ij w_ij |C_ij| + mu/2 |X - X C|_F^2   s.t. diag C = 0 and, if affine, 1^T C = 1^T

    with ``mu = alpha / min_j max_{i != j} |x_i . x_j|`` and penalty ``alpha`` of the splitting.

    Parameters
    ----------
    data : (D, N) float64
        Points X as columns.
    alpha : float
        Weight of the fit and penalty of ADMM.
    affine : bool
        Whether combinations are affine (columns of C sum to one).
    weights : float or (N, N) float64
        Weights w of the absolute values.
    start : (N, N) float64 or None
        Coefficients to start from; by default zero.
    tolerance : float
        Stop when no entry of the two constraints' residuals exceeds it.
    max_iterations : int
        Cap.

    Raises
    ------
    SegmentationError
        When some point is orthogonal to all others (for instance zero): it cannot be expressed.

    References
    ----------
    Elhamifar and Vidal, "Sparse subspace clustering: algorithm, theory and applications", TPAMI
    2013, equation 13 and algorithm 2.
    """
    n = data.shape[1]
    fit = alpha / _smallest_coherence(data)
    ones = np.full((1, n), np.sqrt(alpha) if affine else 0.0)
    system = _ShiftedInverse(np.vstack([np.sqrt(fit) * data, ones]))
    target = fit * (data.T @ data)
    threshold = np.asarray(weights) / alpha
    c = np.zeros((n, n)) if start is None else start.copy()
    # Scaled multipliers: of the splitting Z = C, and of the columns' sums.
    u, v = np.zeros((n, n)), np.zeros(n)

    def step() -> float:
        nonlocal c, u, v
        right = target + alpha * (c - u)
        if affine:
            right += alpha * (1 - v)
        z = system.solve(right, alpha)
        # The published code clears the diagonal here as well as in C; its results depend on it.
        np.fill_diagonal(z, 0)
        c = shrink(z + u, threshold)
        np.fill_diagonal(c, 0)
        gap = z - c
        u += gap
        excess = z.sum(axis=0) - 1 if affine else np.zeros(n)
        v += excess
        return max(float(np.abs(gap).max()), float(np.abs(excess).max()))

    convergence = iterate(step, tolerance=tolerance, max_iterations=max_iterations)
    return Representation(c, convergence)


def low_rank_representation(
    data: FloatArray,
    *,
    weight: float = 4.0,
    tolerance: float = 1e-8,
    max_iterations: int = 1000,
) -> Representation:
    """Solve the low-rank representation programme by the inexact augmented Lagrangian.

        min |Z|_* + weight |E|_{2,1}   s.t.  X = X Z + E

    Z lies in the row space of X, ``Z = Q W`` with orthonormal Q, so that W (rank X, N) is sought.

    Parameters
    ----------
    data, tolerance, max_iterations
        As in `sparse_representation`.
    weight : float
        Weight lambda of the columns' errors.

    Raises
    ------
    InvalidValueError
        When the data are zero.

    References
    ----------
    Liu, Lin, Yan, Sun, Yu, Ma, "Robust recovery of subspace structures by low-rank representation",
    TPAMI 2013, equation 7, algorithm 1 and section 4.2 (reduction by the row space).
    """
    _, values, right = np.linalg.svd(data, full_matrices=False)
    rank = int((values > max(data.shape) * _EPSILON * values[0]).sum())
    if rank == 0:
        raise InvalidValueError("trajectory matrix", expected="numbers other than zero", found="only zeros")
    basis = np.ascontiguousarray(right[:rank].T)
    dictionary = data @ basis
    inverse = np.linalg.inv(dictionary.T @ dictionary + np.eye(rank))
    w, error = np.zeros((rank, data.shape[1])), np.zeros_like(data)
    y_fit, y_split = np.zeros_like(data), np.zeros_like(w)
    penalty = 1e-6

    def step() -> float:
        nonlocal w, error, y_fit, y_split, penalty
        low = _shrink_leading(w + y_split / penalty, 1 / penalty)
        w = inverse @ (dictionary.T @ (data - error + y_fit / penalty) + low - y_split / penalty)
        left = data - dictionary @ w
        error = _shrink_columns(left + y_fit / penalty, weight / penalty)
        fit_gap, split_gap = left - error, w - low
        y_fit += penalty * fit_gap
        y_split += penalty * split_gap
        penalty = min(penalty * _GROWTH, 1e10)
        return max(float(np.abs(fit_gap).max()), float(np.abs(split_gap).max()))

    convergence = iterate(step, tolerance=tolerance, max_iterations=max_iterations)
    return Representation(basis @ w, convergence)


def low_rank_sparse_representation(
    data: FloatArray,
    *,
    sparsity: float = 0.1,
    alpha: float = 800.0,
    tolerance: float = 2e-4,
    max_iterations: int = 400,
) -> Representation:
    """Minimise nuclear norm, l1 norm and misfit of the coefficients together, by ADMM.

        min |C|_* + sparsity |C|_1 + mu/2 |X - X C|_F^2   s.t.  diag C = 0

    C is split into three copies (of the fit, of the nuclear norm, of the l1 norm with zero diagonal); the
    last is returned. An iteration takes a symmetric N x N eigenproblem of a few leading vectors.

    Parameters
    ----------
    data, tolerance, max_iterations
        As in `sparse_representation`, which raises the same errors.
    sparsity : float
        Weight lambda of the l1 norm.
    alpha : float
        ``mu = alpha / min_j max_{i != j} |x_i . x_j|``.

    References
    ----------
    Wang, Xu, Leng, "Provable subspace clustering: when LRR meets SSC", NIPS 2013, equation 2 (relaxed for
    noise as in their section 6).
    """
    n = data.shape[1]
    fit = alpha / _smallest_coherence(data)
    system = _ShiftedInverse(np.sqrt(fit) * data)
    target = fit * (data.T @ data)
    low, sparse = np.zeros((n, n)), np.zeros((n, n))
    y_low, y_sparse = np.zeros((n, n)), np.zeros((n, n))
    penalty = 1.0

    def step() -> float:
        nonlocal low, sparse, y_low, y_sparse, penalty
        c = system.solve(target + penalty * (low + sparse) - y_low - y_sparse, 2 * penalty)
        low = _shrink_leading(c + y_low / penalty, 1 / penalty)
        sparse = shrink(c + y_sparse / penalty, sparsity / penalty)
        np.fill_diagonal(sparse, 0)
        y_low += penalty * (c - low)
        y_sparse += penalty * (c - sparse)
        penalty *= _GROWTH
        return max(float(np.abs(c - low).max()), float(np.abs(c - sparse).max()))

    convergence = iterate(step, tolerance=tolerance, max_iterations=max_iterations)
    return Representation(sparse, convergence)


def keep_largest(coefficients: FloatArray, share: float) -> FloatArray:
    """Keep of each column (N, N) its largest magnitudes, as many as make up a share of their sum.

    The entry that reaches the share is kept, the smaller ones become zero; a share of 1 keeps everything.

    References
    ----------
    Elhamifar and Vidal, TPAMI 2013, section 7.1 (the step called thrC in their code).
    """
    if share >= 1:
        return coefficients
    magnitude = np.abs(coefficients)
    order = np.argsort(-magnitude, axis=0, kind="stable")
    ordered = np.take_along_axis(magnitude, order, axis=0)
    before = ordered.cumsum(axis=0) - ordered
    kept = np.zeros(coefficients.shape, dtype=bool)
    np.put_along_axis(kept, order, before < share * magnitude.sum(axis=0), axis=0)
    return np.where(kept, coefficients, 0.0)


def sparse_affinity(coefficients: FloatArray, share: float = 0.7) -> FloatArray:
    """Affinity of sparse coefficients C (N, N): kept, columns scaled to a maximum of one, ``|C| + |C|^T``.

    `share` is that of `keep_largest`; the affinity (N, N) is symmetric, in [0, 2].
    """
    magnitude = np.abs(keep_largest(coefficients, share))
    scaled = magnitude / (magnitude.max(axis=0) + _EPSILON)
    return np.asarray(scaled + scaled.T)


def _smallest_coherence(data: FloatArray) -> float:
    """``min_j max_{i != j} |x_i . x_j|``: the smallest l1 weight for which no column of C vanishes."""
    if data.shape[1] < 2:
        raise SegmentationError("trajectories", expected="at least 2", found=str(data.shape[1]))
    gram = np.abs(data.T @ data)
    np.fill_diagonal(gram, 0)
    smallest = float(gram.max(axis=0).min())
    if smallest <= np.finfo(np.float64).tiny:
        raise SegmentationError(
            "trajectories", expected="each one correlated with another", found="one orthogonal to all others"
        )
    return smallest


def _shrink_columns(matrix: FloatArray, threshold: float) -> FloatArray:
    """Shorten every column by `threshold`, to zero at most: the proximal map of the l2,1 norm."""
    length = np.linalg.norm(matrix, axis=0)
    return np.asarray(matrix * (np.maximum(length - threshold, 0) / np.where(length > 0, length, 1)))


def _shrink_leading(matrix: FloatArray, threshold: float) -> FloatArray:
    """Soft threshold of the singular values of a matrix (D, N), D <= N, through ``M M^T``.

    Only the eigenvectors above the threshold are computed. Squaring costs half of the digits of values
    near zero, but those fall below the threshold of an iteration that has not converged.
    """
    squares, left = eigh(matrix @ matrix.T, subset_by_value=(threshold**2, np.inf), check_finite=False)
    gain = 1 - threshold / np.sqrt(squares)
    return np.asarray((left * gain) @ (left.T @ matrix))


class _ShiftedInverse:
    """Solve systems with ``B^T B + shift I`` through the row space of B (Woodbury)."""

    def __init__(self, rows: FloatArray) -> None:
        _, values, right = np.linalg.svd(rows, full_matrices=False)
        kept = values > values[0] * _EPSILON * max(rows.shape)
        self.basis = np.ascontiguousarray(right[kept].T)
        self.squares = values[kept, None] ** 2

    def solve(self, right: FloatArray, shift: float) -> FloatArray:
        gain = self.squares / (self.squares + shift)
        return np.asarray((right - self.basis @ (gain * (self.basis.T @ right))) / shift)
