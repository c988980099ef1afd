"""A few smallest eigenvectors of a large symmetric matrix."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh
from scipy.linalg.lapack import dgeqrf, dorgqr

from kt3dmoseg.types import FloatArray
from mseg.clustering.symmetric import Symmetric
from mseg.errors import TooFewPointsError

_DENSE = 250
# Vectors beyond those asked for, and the width of a block: eight columns cost BLAS no more than six.
_GUARD = 3
_WIDTH = 8
_EXPANSIONS = 4
_MAX_RESTARTS = 150
_START_SEED = 20180618


def smallest_eigenvectors(matrix: Symmetric, count: int, *, tolerance: float = 1e-8) -> FloatArray:
    """Orthonormal eigenvectors of the smallest eigenvalues of a symmetric matrix.

    Small matrices are written out and given to LAPACK. Larger ones go through a block Krylov
    method with thick restarts, whose block is wider than `count` so that it finds eigenvalues of
    that multiplicity, as graphs of several components have them. No random state is used: the same
    matrix gives the same vectors.

    Parameters
    ----------
    matrix : (N, N), array or anything that multiplies (N, b) float64
        Symmetric.
    count : int
        Number of eigenvectors K.
    tolerance : float
        Largest norm of an eigenvector's residual |M u - theta u|.

    Returns
    -------
    (N, K) float64
        In the order of their eigenvalues, the largest entry of each positive.

    Raises
    ------
    TooFewPointsError
        When `count` is not in 1..N.

    References
    ----------
    Stewart, "A Krylov-Schur algorithm for large eigenproblems", SIAM J. Matrix Anal. Appl. 2001;
    Zhou and Saad, "Block Krylov-Schur method for large symmetric eigenvalue problems", 2008.
    """
    return fixed_sign(smallest_subspace(matrix, count, tolerance=tolerance)[:, :count])


def smallest_subspace(
    matrix: Symmetric, count: int, *, start: FloatArray | None = None, tolerance: float = 1e-8
) -> FloatArray:
    """Find what `smallest_eigenvectors` finds, without fixed signs, and some approximate ones more.

    Parameters
    ----------
    matrix, count, tolerance
        See there.
    start : (N, m) float64, optional
        What this function gave for a matrix nearby; saves most of the work.

    Returns
    -------
    (N, m) float64
        Orthonormal, m > K (m = N at most); the first K columns are the eigenvectors.
    """
    size = matrix.shape[0]
    if not 1 <= count <= size:
        raise TooFewPointsError("number of clusters", expected=f"1..{size} (points)", found=str(count))
    block = _block(count)
    if size <= max(_DENSE if start is None else 0, (_EXPANSIONS + 3) * block):
        return _dense(matrix, min(block, size))
    first = _random_block(size, block) if start is None else start
    return _krylov(matrix, first, count, tolerance)


def fixed_sign(vectors: FloatArray) -> FloatArray:
    """Flip columns so that the entry of largest magnitude is positive: an eigenvector has no sign."""
    largest = np.abs(vectors).argmax(axis=0)
    sign = np.sign(vectors[largest, np.arange(vectors.shape[1])])
    return vectors * np.where(sign == 0, 1.0, sign)


def _dense(matrix: Symmetric, count: int) -> FloatArray:
    vectors = eigh(np.asarray(matrix), subset_by_index=(0, count - 1), driver="evr", check_finite=False)[1]
    return np.ascontiguousarray(vectors)


def _block(count: int) -> int:
    return -(-(count + _GUARD) // _WIDTH) * _WIDTH


def _random_block(size: int, block: int) -> FloatArray:
    return _orthonormal(np.random.default_rng(_START_SEED).standard_normal((size, block)))


def _krylov(matrix: Symmetric, first: FloatArray, count: int, tolerance: float) -> FloatArray:
    """Solve the problem projected on a basis, expand the basis by residuals, repeat.

    LAPACK takes over where eigenvalues lie so close that this does not get there.
    """
    block = _block(count)
    kept = first.shape[1]
    basis = np.empty((len(first), max(kept, 2 * block) + _EXPANSIONS * block), order="F")
    image = np.empty_like(basis, order="F")
    basis[:, :kept], image[:, :kept] = first, matrix @ np.ascontiguousarray(first)
    filled = kept
    for _ in range(_MAX_RESTARTS):
        projected = basis[:, :filled].T @ image[:, :filled]
        values, rotation = np.linalg.eigh((projected + projected.T) / 2)
        kept = min(filled, 2 * block)
        best = np.asfortranarray(rotation[:, :kept])
        basis[:, :kept], image[:, :kept] = basis[:, :filled] @ best, image[:, :filled] @ best
        direction = image[:, :block] - basis[:, :block] * values[:block]
        if np.linalg.norm(direction[:, :count], axis=0).max() < tolerance:
            break
        filled = kept
        for _ in range(_EXPANSIONS):
            direction = _orthonormal(_without(direction, basis[:, :filled]))
            direction = _orthonormal(_without(direction, basis[:, :filled]))
            basis[:, filled : filled + block] = direction
            direction = matrix @ np.ascontiguousarray(direction)
            image[:, filled : filled + block] = direction
            filled += block
    else:
        return _dense(matrix, block)
    return np.ascontiguousarray(basis[:, :kept])


def _without(vectors: FloatArray, basis: FloatArray) -> FloatArray:
    out: FloatArray = vectors - basis @ (basis.T @ vectors)
    return out


def _orthonormal(vectors: FloatArray) -> FloatArray:
    # Straight to LAPACK: the blocks are thin, and wrappers would take most of the time.
    reflectors, tau, *_ = dgeqrf(vectors)
    return np.asarray(dorgqr(reflectors, tau)[0], dtype=np.float64)
