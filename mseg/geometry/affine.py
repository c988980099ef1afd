"""Affine maps between two images: x2 = A x1 + t."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.types import BoolArray, FloatArray
from mseg.geometry import hartley

MINIMAL = 3
_Array = npt.NDArray[Any]
# Smallest area of the sample, relative to its squared size, that still fixes two directions.
_DEGENERATE = 1e-6


def fit(x1: FloatArray, x2: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Fit affine maps to many samples at once.

    Parameters
    ----------
    x1, x2 : (K, p, 2) float64
        K samples of p >= 3 corresponding points; exact for p = 3, else least squares in the
        second image.

    Returns
    -------
    models : (K, 3, 3) float64
        Rows (a11 a12 t1), (a21 a22 t2), (0 0 1); meaningless where not `ok`.
    ok : (K,) bool
        False where the points of either image are collinear or coincide.
    """
    n1, t1 = hartley.normalise(x1)
    n2, t2 = hartley.normalise(x2)
    s11 = np.einsum("kpi,kpj->kij", n1, n1)
    s21 = np.einsum("kpi,kpj->kij", n2, n1)
    s22 = np.einsum("kpi,kpj->kij", n2, n2)
    area1, area2 = _determinant(s11), _determinant(s22)
    ok = (area1 > _DEGENERATE) & (area2 > _DEGENERATE)
    models = np.zeros((len(x1), 3, 3))
    models[:, :2, :2] = s21 @ _adjugate(s11) / np.where(ok, area1, 1.0)[:, None, None]
    models[:, 2, 2] = 1.0
    return hartley.inverse(t2) @ models @ t1, ok


def sampson(models: _Array, x1: _Array, x2: _Array) -> _Array:
    """Squared Sampson distances of points to affine maps, which here are exact distances.

    With e = A x1 + t - x2 the squared distance of (x1, x2) to the linear manifold e = 0 is
    e^T (I + A A^T)^-1 e (Hartley and Zisserman, "Multiple View Geometry", 2004, section 4.2.6).

    Parameters
    ----------
    models : (K, 3, 3) float
        Affine maps.
    x1, x2 : (P, 2) float
        Corresponding points; their dtype is that of the result.

    Returns
    -------
    (P, K) float
    """
    linear = models[:, :2, :2]
    metric = linear @ linear.transpose(0, 2, 1) + np.eye(2)
    return _quadratic(_error_forms(models), _inverse_factor(metric), x1, x2)


def symmetric_transfer(models: _Array, x1: _Array, x2: _Array) -> _Array:
    """Squared symmetric transfer errors |x2 - A x1 - t|^2 + |x1 - A^-1 (x2 - t)|^2, (P, K).

    Parameters
    ----------
    models : (K, 3, 3) float
        Invertible affine maps.
    x1, x2 : (P, 2) float
        Corresponding points.

    References
    ----------
    Hartley and Zisserman, "Multiple View Geometry", 2004, section 4.2.2.
    """
    linear = models[:, :2, :2]
    # The backward error is A^-1 e, so both together are e^T (I + A^-T A^-1) e.
    back = _adjugate(linear) / _determinant(linear)[:, None, None]
    factor = np.concatenate([np.broadcast_to(np.eye(2), back.shape), back], axis=1)
    return _quadratic(_error_forms(models), factor, x1, x2)


def _error_forms(models: _Array) -> _Array:
    """Coefficients (K, 2, 5) of e = A x1 + t - x2 as linear forms in (x1, y1, 1, x2, y2)."""
    forms = np.zeros((len(models), 2, 5))
    forms[:, :, :3] = models[:, :2]
    forms[:, 0, 3] = forms[:, 1, 4] = -1.0
    return forms


def _quadratic(forms: _Array, factor: _Array, x1: _Array, x2: _Array) -> _Array:
    """Sum of squares (P, K) of the rows of factor @ forms."""
    rows = (factor @ forms).astype(x1.dtype)
    z = np.concatenate([x1, np.ones((len(x1), 1), x1.dtype), x2], axis=1)
    total: _Array = np.zeros((len(x1), len(forms)), x1.dtype)
    for k in range(rows.shape[1]):
        value = z @ rows[:, k].T
        value *= value
        total += value
    return total


def _inverse_factor(metric: _Array) -> _Array:
    """Lower triangular G with G^T G = metric^-1 up to a rotation, so |G e|^2 = e^T metric^-1 e."""
    a, b, c = metric[:, 0, 0], metric[:, 0, 1], metric[:, 1, 1]
    first = np.sqrt(a)
    schur = np.sqrt(np.maximum(c - b * b / a, np.finfo(np.float64).tiny))
    out = np.zeros_like(metric)
    out[:, 0, 0] = 1.0 / first
    out[:, 1, 0] = -b / (a * schur)
    out[:, 1, 1] = 1.0 / schur
    return out


def _determinant(matrices: _Array) -> _Array:
    out: _Array = matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0]
    return out


def _adjugate(matrices: _Array) -> _Array:
    out = np.empty_like(matrices)
    out[:, 0, 0], out[:, 1, 1] = matrices[:, 1, 1], matrices[:, 0, 0]
    out[:, 0, 1], out[:, 1, 0] = -matrices[:, 0, 1], -matrices[:, 1, 0]
    return out
