"""A few smallest eigenvectors of a large symmetric matrix."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from scipy.linalg import eigh, qr

from kt3dmoseg.types import FloatArray
from mseg.errors import TooFewPointsError

_DENSE = 600
_GUARD = 4
_BLOCKS = 8
_MAX_RESTARTS = 60
_START_SEED = 20180618


class Symmetric(Protocol):
    """A symmetric (N, N) matrix that may exist only as a product with vectors."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(N, N)."""

    def __matmul__(self, vectors: FloatArray, /) -> Any:  # noqa: ANN401  # ndarray, whatever its stubs say
        """Multiply with (N, b) float64."""


def smallest_eigenvectors(
    matrix: Symmetric,
    count: int,
    *,
    start: FloatArray | None = None,
    tolerance: float = 1e-8,
) -> FloatArray:
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
    start : (N, k) float64, optional
        Guess at the eigenvectors, which saves work when it is good.
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
    size = matrix.shape[0]
    if not 1 <= count <= size:
        raise TooFewPointsError("number of clusters", expected=f"1..{size} (points)", found=str(count))
    block = count + _GUARD
    if size <= max(_DENSE, (_BLOCKS + 2) * block):
        dense = matrix if isinstance(matrix, np.ndarray) else matrix @ np.eye(size)
        vectors = eigh(dense, subset_by_index=(0, count - 1), driver="evr", check_finite=False)[1]
    else:
        vectors = _krylov(matrix, _starting_block(size, block, start), count, tolerance)
    return fixed_sign(np.ascontiguousarray(vectors))


def fixed_sign(vectors: FloatArray) -> FloatArray:
    """Flip columns so that the entry of largest magnitude is positive: an eigenvector has no sign."""
    largest = np.abs(vectors).argmax(axis=0)
    sign = np.sign(vectors[largest, np.arange(vectors.shape[1])])
    return vectors * np.where(sign == 0, 1.0, sign)


def _starting_block(size: int, block: int, start: FloatArray | None) -> FloatArray:
    """Orthonormal (N, block): the guess, filled up with a fixed random block."""
    random = np.random.default_rng(_START_SEED).standard_normal((size, block))
    return _orthonormal(random if start is None else np.concatenate([start, random], axis=1)[:, :block])


def _krylov(matrix: Symmetric, first: FloatArray, count: int, tolerance: float) -> FloatArray:
    """Expand by blocks, solve the projected problem, keep the best, repeat."""
    block = first.shape[1]
    basis, image = first, matrix @ first
    direction: FloatArray = image
    for _ in range(_MAX_RESTARTS):
        for _ in range(_BLOCKS):
            direction = _orthonormal(_without(direction, basis))
            direction = _orthonormal(_without(direction, basis))
            basis = np.concatenate([basis, direction], axis=1)
            direction = matrix @ direction
            image = np.concatenate([image, direction], axis=1)
        projected = basis.T @ image
        values, rotation = eigh((projected + projected.T) / 2, check_finite=False)
        keep = rotation[:, : 2 * block]
        basis, image = basis @ keep, image @ keep
        residual = image[:, :block] - basis[:, :block] * values[:block]
        if np.linalg.norm(residual[:, :count], axis=0).max() < tolerance:
            break
        direction = residual
    return basis[:, :count]


def _without(vectors: FloatArray, basis: FloatArray) -> FloatArray:
    out: FloatArray = vectors - basis @ (basis.T @ vectors)
    return out


def _orthonormal(vectors: FloatArray) -> FloatArray:
    return np.asarray(qr(vectors, mode="economic", check_finite=False)[0], dtype=np.float64)
