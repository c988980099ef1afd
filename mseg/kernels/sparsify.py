"""Sparsification of an affinity by an entropy-based neighbourhood of every point."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.types import BoolArray, FloatArray

_Array = npt.NDArray[Any]
_BLOCK_ENTRIES = 1 << 16
_EPSILON = float(np.finfo(np.float64).eps)


def neighbourhood_mask(kernel: _Array, alpha: float) -> _Array:
    """Tell which neighbours every point keeps.

    With B = K^alpha, the distances s_ij = max_j B_ij - B_ij of row i are read as a distribution
    P_ij = s_ij / sum_j s_ij, and those neighbours stay whose log P_ij lies below its mean under P,
    the negative entropy of the row.

    Parameters
    ----------
    kernel : (N, N) float
        Symmetric affinity in 0..1.
    alpha : float
        Power that sharpens the affinity first; larger keeps fewer neighbours.

    Returns
    -------
    (N, N) float of the kernel's dtype
        1 where both points keep each other, 0.5 where one of them does, else 0. A constant row
        tells no neighbours apart and keeps none.

    References
    ----------
    Xu, Cheong, Li, "Motion segmentation by exploiting complementary geometric models", CVPR 2018,
    section 4 (the neighbourhood of the authors' released code).
    """
    keep = np.empty(kernel.shape, dtype=np.bool_)
    rows = max(1, _BLOCK_ENTRIES // max(1, len(kernel)))
    for start in range(0, len(kernel), rows):
        block = kernel[start : start + rows]
        keep[start : start + rows] = _kept_neighbours(block.astype(np.float64), alpha)
    mask: _Array = keep.astype(kernel.dtype)
    mask += keep.T
    mask *= kernel.dtype.type(0.5)
    return mask


def sparsify(kernel: _Array, alpha: float) -> _Array:
    """Return the affinity times its `neighbourhood_mask`: symmetric, mostly zero."""
    out: _Array = neighbourhood_mask(kernel, alpha)
    out *= kernel
    return out


def _kept_neighbours(kernel: FloatArray, alpha: float) -> BoolArray:
    """Rows of the mask before it is made symmetric.

    In double precision: most distances of a row are nearly equal to its largest, and the threshold
    lies among them.
    """
    power = _power(kernel, alpha)
    distance = power.max(axis=1, keepdims=True) - power
    total = distance.sum(axis=1, keepdims=True)
    np.divide(distance, total, out=distance, where=total > 0)
    logarithm = np.log(distance + _EPSILON)
    mean = np.einsum("ij,ij->i", distance, logarithm)
    kept: BoolArray = (logarithm < mean[:, None]) & (total > 0)
    return kept


def _power(base: FloatArray, exponent: float) -> FloatArray:
    """Raise to a power; by products where it is whole, since a general power takes twenty times as long."""
    if exponent <= 2 or exponent % 1:
        return base**exponent
    half = _power(base, exponent // 2)
    half *= half
    if exponent % 2:
        half *= base
    return half
