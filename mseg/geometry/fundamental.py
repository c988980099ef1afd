"""Fundamental matrices between two images: x2^T F x1 = 0, rank 2."""

from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.types import BoolArray, FloatArray

_Array = npt.NDArray[Any]
# Smallest eighth pivot of the design matrix, relative to its first, that still fixes F.
_DEGENERATE = 1e-9
# Samples at a time: few enough that their matrices stay in the cache.
_TOGETHER = 512
# Squarings until one eigenvector is left: ratios of singular values below 0.95 come out exact.
_SQUARINGS = 8
_TINY = float(np.finfo(np.float64).tiny)


def eight_point(x1: FloatArray, x2: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Fit rank-2 fundamental matrices (K, 3, 3) to samples of points (K, 8, 2); and which are fixed (K,).

    In the coordinates as they are, for points that are normalised together, as those of a frame pair:
    normalising each sample by itself moves the frame in which the nearest matrix of rank 2 is taken, and
    costs two points of error of the fundamental view on KT3DMoSeg. Not fixed: repeated points, or points and
    motions on a plane, leave more than one solution to within rounding.
    """
    # Hartley, "In defense of the eight-point algorithm", TPAMI 1997.
    models, ok = np.empty((len(x1), 3, 3)), np.empty(len(x1), dtype=np.bool_)
    for start in range(0, len(x1), _TOGETHER):
        part = slice(start, start + _TOGETHER)
        vectors, ok[part] = _null_vectors(_outer(_homogeneous(x2[part]), _homogeneous(x1[part])))
        models[part] = _nearest_rank_2(vectors.reshape(3, 3, -1)).transpose(2, 0, 1)
    return models, ok


def sampson(models: _Array, x1: _Array, x2: _Array) -> _Array:
    """Squared Sampson distances (P, K) of points (P, 2) to fundamental matrices, in the points' dtype.

    (x2^T F x1)^2 / ((F x1)_1^2 + (F x1)_2^2 + (F^T x2)_1^2 + (F^T x2)_2^2); NaN where both are epipoles.
    """
    # Hartley and Zisserman, "Multiple View Geometry", 2004, equation 11.9.
    f = models.astype(np.float64)
    first, second = _homogeneous(x1), _homogeneous(x2)
    algebraic: _Array = _outer(second, first).astype(x1.dtype) @ f.reshape(-1, 9).T.astype(x1.dtype)
    # |(F x1)_12|^2 is a quadratic form of x1 with the matrix F_12^T F_12; likewise of x2.
    forms1 = symmetric_part(f[:, :2].transpose(0, 2, 1) @ f[:, :2])
    forms2 = symmetric_part(f[:, :, :2] @ f[:, :, :2].transpose(0, 2, 1))
    points = np.concatenate([squares(first), squares(second)], axis=1).astype(x1.dtype)
    gradient: _Array = points @ np.concatenate([forms1, forms2], axis=1).astype(x1.dtype).T
    algebraic *= algebraic
    # Cancellation may leave the gradient at an epipole a rounding error below zero.
    np.abs(gradient, out=gradient)
    with np.errstate(divide="ignore", invalid="ignore"):
        algebraic /= gradient
    return algebraic


def _homogeneous(points: _Array) -> FloatArray:
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)


def _outer(second: FloatArray, first: FloatArray) -> FloatArray:
    """Coefficients (..., p, 9) of x2^T F x1 in the row-major entries of F, x1 and x2 homogeneous."""
    return np.asarray((second[..., :, None] * first[..., None, :]).reshape(*first.shape[:-1], 9))


def _null_vectors(design: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Null vectors (9, K) of 8 x 9 matrices: the ninth column of Q in the QR of the transpose.

    Householder's reflections written for many matrices side by side: LAPACK, called for one small
    matrix after the other, takes four times as long.
    """
    columns = np.ascontiguousarray(design.transpose(2, 1, 0))
    reflections, pivots = [], []
    for j in range(columns.shape[1]):
        mirror = columns[j:, j].copy()
        norm = np.sqrt(np.einsum("ik,ik->k", mirror, mirror))
        mirror[0] += np.copysign(norm, mirror[0])
        square = np.einsum("ik,ik->k", mirror, mirror)
        factor = 2.0 / np.where(square > 0, square, 1.0)
        rest = columns[j:, j + 1 :]
        rest -= mirror[:, None] * (np.einsum("ik,imk->mk", mirror, rest) * factor)
        reflections.append((mirror, factor))
        pivots.append(norm)
    last = np.zeros((len(columns), columns.shape[2]))
    last[-1] = 1.0
    for j, (mirror, factor) in reversed(list(enumerate(reflections))):
        last[j:] -= mirror * (np.einsum("ik,ik->k", mirror, last[j:]) * factor)
    return last, np.min(pivots, axis=0) > _DEGENERATE * np.max(pivots, axis=0)


def _nearest_rank_2(matrices: FloatArray) -> FloatArray:
    """Remove the smallest singular value of (3, 3, K): F - F v v^T with v its right singular vector.

    v v^T is what adj(F) adj(F)^T, whose eigenvalues are products of two squared singular values, tends
    to when it is squared again and again.
    """
    a, b, c = matrices
    cofactors = np.empty_like(matrices)
    for k, rows in enumerate(((b, c), (c, a), (a, b))):
        cofactors[k] = np.cross(*rows, axis=0)
    projector = _product(cofactors.swapaxes(0, 1), cofactors)
    for _ in range(_SQUARINGS):
        projector /= np.maximum(np.einsum("iik->k", projector), _TINY)
        projector = _product(projector, projector)
    projector /= np.maximum(np.einsum("iik->k", projector), _TINY)
    return matrices - _product(matrices, projector)


def _product(left: FloatArray, right: FloatArray) -> FloatArray:
    """Products of many 3 x 3 matrices, all (3, 3, K)."""
    out: FloatArray = left[:, :1] * right[0]
    out += left[:, 1:2] * right[1]
    out += left[:, 2:] * right[2]
    return out


def squares(points: FloatArray) -> FloatArray:
    """Monomials (P, 6) of degree two of homogeneous points."""
    x, y, w = points.T
    return np.stack([x * x, y * y, w * w, x * y, x * w, y * w], axis=1)


def symmetric_part(forms: FloatArray) -> FloatArray:
    """Coefficients (K, 6) of quadratic forms (K, 3, 3) in the monomials of `squares`."""
    m = forms
    return np.stack(
        [m[:, 0, 0], m[:, 1, 1], m[:, 2, 2], 2 * m[:, 0, 1], 2 * m[:, 0, 2], 2 * m[:, 1, 2]], axis=1
    )
