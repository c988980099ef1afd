"""Models between two frames: affine maps x2 = A x1 + t, homographies x2 ~ H x1, fundamental matrices.

`MODELS` is the table of the three kinds; residuals are squared distances (P, K) of P correspondences to K
models. Fundamental matrices satisfy x2^T F x1 = 0 and have rank 2.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.types import BoolArray, FloatArray
from mseg.geometry import hartley
from mseg.types import ModelKind

Distance: TypeAlias = Literal["sampson", "transfer"]
_Array = npt.NDArray[Any]
# Smallest area of three points, relative to their squared size, that still fixes two directions.
_FLAT_AREA = 1e-6
# Smallest area of three of four points (normalised coordinates) that counts as a triangle.
_TRIANGLE = 1e-6
# Smallest eighth pivot of the design matrix, relative to its first, that still fixes a fundamental matrix.
_DEGENERATE = 1e-9
# Samples at a time: few enough that their matrices stay in the cache.
_TOGETHER = 512
# Squarings until one eigenvector is left: ratios of singular values below 0.95 come out exact.
_SQUARINGS = 8
_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Model:
    """A kind of model between two frames.

    ``fit(x1 (K, p, 2), x2 (K, p, 2))`` gives models (K, 3, 3) and where a sample fixes one (K,);
    ``residual(models (K, 3, 3), x1 (P, 2), x2 (P, 2))`` gives (P, K) squared Sampson distances or symmetric
    transfer errors, in the units and the dtype of the points. Fundamental matrices, which map points to
    lines, have Sampson's alone.
    """

    minimal: int  # size p of a minimal sample
    fit: Callable[[FloatArray, FloatArray], tuple[FloatArray, BoolArray]]
    residuals: Mapping[Distance, Callable[[_Array, _Array, _Array], _Array]]


def _fit_affine(x1: FloatArray, x2: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Rows (a11 a12 t1), (a21 a22 t2), (0 0 1); not ok where points of either image are collinear."""
    n1, t1 = hartley.normalise(x1)
    n2, t2 = hartley.normalise(x2)
    s11 = np.einsum("kpi,kpj->kij", n1, n1)
    s21 = np.einsum("kpi,kpj->kij", n2, n1)
    s22 = np.einsum("kpi,kpj->kij", n2, n2)
    area1, area2 = _determinant(s11), _determinant(s22)
    ok = (area1 > _FLAT_AREA) & (area2 > _FLAT_AREA)
    models = np.zeros((len(x1), 3, 3))
    models[:, :2, :2] = s21 @ _swapped(s11) / np.where(ok, area1, 1.0)[:, None, None]
    models[:, 2, 2] = 1.0
    return hartley.inverse(t2) @ models @ t1, ok


def _affine_sampson(models: _Array, x1: _Array, x2: _Array) -> _Array:
    """Distances e^T (I + A A^T)^-1 e with e = A x1 + t - x2, which here are exact."""
    # Hartley and Zisserman, "Multiple View Geometry", 2004, section 4.2.6.
    linear = models[:, :2, :2]
    metric = linear @ linear.transpose(0, 2, 1) + np.eye(2)
    return _quadratic(_error_forms(models), _inverse_factor(metric), x1, x2)


def _affine_transfer(models: _Array, x1: _Array, x2: _Array) -> _Array:
    """Errors |x2 - A x1 - t|^2 + |x1 - A^-1 (x2 - t)|^2."""
    # Hartley and Zisserman, section 4.2.2.
    linear = models[:, :2, :2]
    # The backward error is A^-1 e, so both together are e^T (I + A^-T A^-1) e.
    back = _swapped(linear) / _determinant(linear)[:, None, None]
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
    schur = np.sqrt(np.maximum(c - b * b / a, _TINY))
    out = np.zeros_like(metric)
    out[:, 0, 0] = 1.0 / first
    out[:, 1, 0] = -b / (a * schur)
    out[:, 1, 1] = 1.0 / schur
    return out


def _determinant(matrices: _Array) -> _Array:
    return np.asarray(matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0])


def _swapped(matrices: _Array) -> _Array:
    """Adjugates of 2 x 2 matrices."""
    out = np.empty_like(matrices)
    out[:, 0, 0], out[:, 1, 1] = matrices[:, 1, 1], matrices[:, 0, 0]
    out[:, 0, 1], out[:, 1, 0] = -matrices[:, 0, 1], -matrices[:, 1, 0]
    return out


def _fit_homography(x1: FloatArray, x2: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Homographies of Frobenius norm 1; not ok where three points of either image are collinear."""
    n1, t1 = hartley.normalise(x1)
    n2, t2 = hartley.normalise(x2)
    # From the first image to the canonical basis, and on to the second image.
    basis1, ok1 = _projective_basis(n1)
    basis2, ok2 = _projective_basis(n2)
    models = basis2 @ _adjugate(basis1)
    return hartley.unit_norm(hartley.inverse(t2) @ models @ t1), ok1 & ok2


def _homography_sampson(models: _Array, x1: _Array, x2: _Array) -> _Array:
    """First-order distances c^T (J J^T)^-1 c of (x1, y1, x2, y2) to the two algebraic equations.

    c = (y2 w - v, u - x2 w) = 0 with (u, v, w) = H x1.
    """
    # Hartley and Zisserman, section 4.2.6; Chum, Pajdla, Sturm, "The geometric error for homographies",
    # CVIU 2005.
    h = models.astype(np.float64)
    one, x, y = np.ones(len(x1)), x1[:, 0].astype(np.float64), x1[:, 1].astype(np.float64)
    xx, yy = x2[:, 0].astype(np.float64), x2[:, 1].astype(np.float64)
    first = np.stack([x, y, one], axis=1)
    c1 = _products([first, -yy[:, None] * first], [-h[:, 1], -h[:, 2]], x1.dtype)
    c2 = _products([first, -xx[:, None] * first], [h[:, 0], h[:, 2]], x1.dtype)
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


def _homography_transfer(models: _Array, x1: _Array, x2: _Array) -> _Array:
    """Errors |x2 - H x1|^2 + |x1 - H^-1 x2|^2; infinite or NaN for points mapped to infinity."""
    # Hartley and Zisserman, section 4.2.2.
    back = _adjugate(models)
    return _transfer(models, x1, x2) + _transfer(back, x2, x1)


def _projective_basis(points: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Find the maps of e1, e2, e3, (1, 1, 1) to the four points, (K, 3, 3), and where they exist."""
    homogeneous = _homogeneous(points)
    a, b, c = (points[:, triple] for triple in np.array(list(combinations(range(4), 3))).T)
    area: FloatArray = np.abs((b - a)[..., 0] * (c - a)[..., 1] - (b - a)[..., 1] * (c - a)[..., 0])
    columns = homogeneous[:, :3].transpose(0, 2, 1)
    weights = _adjugate(columns) @ homogeneous[:, 3, :, None]
    return columns * weights.transpose(0, 2, 1), np.asarray((area > _TRIANGLE).all(axis=1))


def _adjugate(matrices: _Array) -> _Array:
    """Transposed cofactors of 3 x 3 matrices: inverses up to scale, also where nearly singular."""
    a, b, c = matrices[:, 0], matrices[:, 1], matrices[:, 2]
    return np.asarray(np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2))


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
    one = first[:, 2]
    g11, g22, g33 = (np.einsum("ki,ki->k", g, g) for g in (h1, h2, h3))
    g12, g13, g23 = (np.einsum("ki,ki->k", p, q) for p, q in ((h1, h2), (h1, h3), (h2, h3)))
    depth = _squares(first)
    depth_weights = _symmetric_part(h[:, 2, :, None] * h[:, 2, None])
    s11 = _products(
        [depth, np.stack([one, yy, yy * yy], axis=1)],
        [depth_weights, np.stack([g22, -2 * g23, g33], axis=1)],
        dtype,
    )
    s22 = _products(
        [depth, np.stack([one, xx, xx * xx], axis=1)],
        [depth_weights, np.stack([g11, -2 * g13, g33], axis=1)],
        dtype,
    )
    s12 = _products(
        [np.stack([one, yy, xx, xx * yy], axis=1)], [np.stack([-g12, g13, g23, -g33], axis=1)], dtype
    )
    return s11, s22, s12


def _products(left: list[FloatArray], right: list[FloatArray], dtype: npt.DTypeLike) -> _Array:
    """Concatenate along the last axis and multiply, (P, m) by (K, m), to (P, K)."""
    first, second = (np.concatenate(side, axis=1).astype(dtype) for side in (left, right))
    return np.asarray(first @ second.T)


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


def fundamental_sampson(models: _Array, x1: _Array, x2: _Array) -> _Array:
    """Squared Sampson distances (P, K) of points (P, 2) to fundamental matrices, in the points' dtype.

    (x2^T F x1)^2 / ((F x1)_1^2 + (F x1)_2^2 + (F^T x2)_1^2 + (F^T x2)_2^2); NaN where both are epipoles.
    """
    # Hartley and Zisserman, "Multiple View Geometry", 2004, equation 11.9.
    f = models.astype(np.float64)
    first, second = _homogeneous(x1), _homogeneous(x2)
    algebraic: _Array = _outer(second, first).astype(x1.dtype) @ f.reshape(-1, 9).T.astype(x1.dtype)
    # |(F x1)_12|^2 is a quadratic form of x1 with the matrix F_12^T F_12; likewise of x2.
    forms1 = _symmetric_part(f[:, :2].transpose(0, 2, 1) @ f[:, :2])
    forms2 = _symmetric_part(f[:, :, :2] @ f[:, :, :2].transpose(0, 2, 1))
    points = np.concatenate([_squares(first), _squares(second)], axis=1).astype(x1.dtype)
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
    projector = _products_3x3(cofactors.swapaxes(0, 1), cofactors)
    for _ in range(_SQUARINGS):
        projector /= np.maximum(np.einsum("iik->k", projector), _TINY)
        projector = _products_3x3(projector, projector)
    projector /= np.maximum(np.einsum("iik->k", projector), _TINY)
    return matrices - _products_3x3(matrices, projector)


def _products_3x3(left: FloatArray, right: FloatArray) -> FloatArray:
    """Products of many 3 x 3 matrices, all (3, 3, K)."""
    out: FloatArray = left[:, :1] * right[0]
    out += left[:, 1:2] * right[1]
    out += left[:, 2:] * right[2]
    return out


def _squares(points: FloatArray) -> FloatArray:
    """Monomials (P, 6) of degree two of homogeneous points."""
    x, y, w = points.T
    return np.stack([x * x, y * y, w * w, x * y, x * w, y * w], axis=1)


def _symmetric_part(forms: FloatArray) -> FloatArray:
    """Coefficients (K, 6) of quadratic forms (K, 3, 3) in the monomials of `_squares`."""
    m = forms
    return np.stack(
        [m[:, 0, 0], m[:, 1, 1], m[:, 2, 2], 2 * m[:, 0, 1], 2 * m[:, 0, 2], 2 * m[:, 1, 2]], axis=1
    )


MODELS: dict[ModelKind, Model] = {
    "affine": Model(3, _fit_affine, {"sampson": _affine_sampson, "transfer": _affine_transfer}),
    "homography": Model(
        4, _fit_homography, {"sampson": _homography_sampson, "transfer": _homography_transfer}
    ),
    "fundamental": Model(8, eight_point, dict.fromkeys(("sampson", "transfer"), fundamental_sampson)),
}
