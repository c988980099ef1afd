"""Homographies between two images: x2 ~ H x1."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.types import BoolArray, FloatArray
from mseg.geometry import hartley

MINIMAL = 4
_Array = npt.NDArray[Any]
# Smallest area of three of the four points (normalised coordinates) that counts as a triangle.
_DEGENERATE = 1e-6


def fit(x1: FloatArray, x2: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Fit homographies to many samples at once.

    Parameters
    ----------
    x1, x2 : (K, p, 2) float64
        K samples of p >= 4 corresponding points; exact for p = 4, else the normalised direct
        linear transformation.

    Returns
    -------
    models : (K, 3, 3) float64
        Homographies of Frobenius norm 1; meaningless where not `ok`.
    ok : (K,) bool
        False where three points of a minimal sample are collinear in either image, or where the
        map found is singular.

    References
    ----------
    Hartley and Zisserman, "Multiple View Geometry", 2004, algorithm 4.2.
    """
    n1, t1 = hartley.normalise(x1)
    n2, t2 = hartley.normalise(x2)
    models, ok = _four_points(n1, n2) if x1.shape[1] == MINIMAL else _direct_linear(n1, n2)
    models = hartley.inverse(t2) @ models @ t1
    size = np.linalg.norm(models, axis=(1, 2), keepdims=True)
    return models / np.where(size > 0, size, 1.0), ok


def sampson(models: _Array, x1: _Array, x2: _Array) -> _Array:
    """Squared Sampson distances of points to homographies.

    First-order distance c^T (J J^T)^-1 c of (x1, y1, x2, y2) to the two algebraic equations
    c = (y2 w - v, u - x2 w) = 0 with (u, v, w) = H x1 (Hartley and Zisserman 2004, section 4.2.6;
    Chum, Pajdla, Sturm, "The geometric error for homographies", CVIU 2005).

    Parameters
    ----------
    models : (K, 3, 3) float
        Homographies.
    x1, x2 : (P, 2) float
        Corresponding points; their dtype is that of the result.

    Returns
    -------
    (P, K) float
    """
    h = models.astype(np.float64)
    one, x, y = np.ones(len(x1)), x1[:, 0].astype(np.float64), x1[:, 1].astype(np.float64)
    xx, yy = x2[:, 0].astype(np.float64), x2[:, 1].astype(np.float64)
    first = np.stack([x, y, one], axis=1)
    c1 = _product([first, -yy[:, None] * first], [-h[:, 1], -h[:, 2]], x1.dtype)
    c2 = _product([first, -xx[:, None] * first], [h[:, 0], h[:, 2]], x1.dtype)
    s11, s22, s12 = _gradient_products(h, first, xx, yy, x1.dtype)
    # c^T S^-1 c for 2 x 2 matrices S, written out; arrays are overwritten to spare memory traffic.
    numerator = c1 * c2
    numerator *= s12
    numerator *= -2.0
    c1 *= c1
    c1 *= s22
    c2 *= c2
    c2 *= s11
    numerator += c1
    numerator += c2
    s11 *= s22
    s12 *= s12
    s11 -= s12
    with np.errstate(divide="ignore", invalid="ignore"):
        numerator /= s11
    return numerator


def symmetric_transfer(models: _Array, x1: _Array, x2: _Array) -> _Array:
    """Squared symmetric transfer errors |x2 - H x1|^2 + |x1 - H^-1 x2|^2, (P, K).

    Parameters
    ----------
    models : (K, 3, 3) float
        Invertible homographies; points that they map to infinity get an infinite error or NaN.
    x1, x2 : (P, 2) float
        Corresponding points.

    References
    ----------
    Hartley and Zisserman, "Multiple View Geometry", 2004, section 4.2.2.
    """
    back = adjugate(models)
    return _transfer(models, x1, x2) + _transfer(back, x2, x1)


def adjugate(matrices: _Array) -> _Array:
    """Transposed cofactors of 3 x 3 matrices: inverses up to scale, also where nearly singular."""
    a, b, c = matrices[:, 0], matrices[:, 1], matrices[:, 2]
    out: _Array = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    return out


def _transfer(models: _Array, x1: _Array, x2: _Array) -> _Array:
    points = np.concatenate([x1, np.ones((len(x1), 1), x1.dtype)], axis=1)
    u, v, w = (points @ models[:, row].T.astype(x1.dtype) for row in range(3))
    with np.errstate(divide="ignore", invalid="ignore"):
        u /= w
        v /= w
    u -= x2[:, :1]
    v -= x2[:, 1:]
    out: _Array = u * u
    out += v * v
    return out


def _gradient_products(
    h: FloatArray, first: FloatArray, xx: FloatArray, yy: FloatArray, dtype: npt.DTypeLike
) -> tuple[_Array, _Array, _Array]:
    """Entries s11, s22, s12 of J J^T, each (P, K), as polynomials in the points.

    J has the rows (-h2 + y2 h3, 0, w) and (h1 - x2 h3, -w, 0), h_i being the first two entries of
    row i.
    """
    h1, h2, h3 = h[:, 0, :2], h[:, 1, :2], h[:, 2, :2]
    one, x, y = first[:, 2], first[:, 0], first[:, 1]
    g11, g22, g33 = (np.einsum("ki,ki->k", g, g) for g in (h1, h2, h3))
    g12, g13, g23 = (np.einsum("ki,ki->k", p, q) for p, q in ((h1, h2), (h1, h3), (h2, h3)))
    a, b, c = h[:, 2].T
    depth = np.stack([x * x, y * y, one, x * y, x, y], axis=1)
    depth_weights = np.stack([a * a, b * b, c * c, 2 * a * b, 2 * a * c, 2 * b * c], axis=1)
    s11 = _product(
        [depth, np.stack([one, yy, yy * yy], axis=1)],
        [depth_weights, np.stack([g22, -2 * g23, g33], axis=1)],
        dtype,
    )
    s22 = _product(
        [depth, np.stack([one, xx, xx * xx], axis=1)],
        [depth_weights, np.stack([g11, -2 * g13, g33], axis=1)],
        dtype,
    )
    s12 = _product(
        [np.stack([one, yy, xx, xx * yy], axis=1)], [np.stack([-g12, g13, g23, -g33], axis=1)], dtype
    )
    return s11, s22, s12


def _product(left: list[FloatArray], right: list[FloatArray], dtype: npt.DTypeLike) -> _Array:
    """Concatenate along the last axis and multiply, (P, m) by (K, m), to (P, K)."""
    out: _Array = np.concatenate(left, axis=1).astype(dtype) @ np.concatenate(right, axis=1).astype(dtype).T
    return out


def _four_points(x1: FloatArray, x2: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Exact homographies: canonical basis to image 2, after image 1 to canonical basis."""
    basis1, ok1 = _projective_basis(x1)
    basis2, ok2 = _projective_basis(x2)
    return basis2 @ adjugate(basis1), ok1 & ok2


def _projective_basis(points: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Find the maps of e1, e2, e3, (1, 1, 1) to the four points, (K, 3, 3), and where they exist."""
    homogeneous = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2)
    a, b, c = (points[:, triple] for triple in np.array(list(combinations(range(4), 3))).T)
    area: FloatArray = np.abs((b - a)[..., 0] * (c - a)[..., 1] - (b - a)[..., 1] * (c - a)[..., 0])
    columns = homogeneous[:, :3].transpose(0, 2, 1)
    weights = adjugate(columns) @ homogeneous[:, 3, :, None]
    return columns * weights.transpose(0, 2, 1), np.asarray((area > _DEGENERATE).all(axis=1))


def _direct_linear(x1: FloatArray, x2: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Least algebraic error over more than four points."""
    one = np.ones((*x1.shape[:2], 1))
    first = np.concatenate([x1, one], axis=2)
    zero = np.zeros_like(first)
    rows = [
        np.concatenate([zero, -first, x2[..., 1:] * first], axis=2),
        np.concatenate([first, zero, -x2[..., :1] * first], axis=2),
    ]
    design = np.concatenate(rows, axis=1)
    _, singular, right = np.linalg.svd(design, full_matrices=False)
    models = right[:, -1].reshape(-1, 3, 3)
    unique = singular[:, -2] > _DEGENERATE * singular[:, 0]
    return models, unique & (np.abs(np.linalg.det(models)) > _DEGENERATE**2)
