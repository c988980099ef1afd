"""Two-view models against reference values, explicit formulas and invariances."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mseg.geometry import hartley
from mseg.geometry.hartley import change_frame
from mseg.geometry.models import (
    MODELS,
    _nearest_rank_2,
    _null_vectors,
    eight_point,
    fundamental_sampson,
)

# Values of the authors' functions, executed once elsewhere.
X1 = np.array([(0, 0), (1, 2), (2, 1), (3, 3), (1.5, -1)])
X2 = np.array([(0.1, 0.2), (1.2, 2.1), (2.4, 1.1), (3.1, 3.3), (1.9, -0.8)])
H = np.array([[[1.1, 0.1, 0.2], [0, 1.2, -0.1], [0.01, 0, 1]]])
F = np.array([[[0, -0.3, 0.2], [0.3, 0, -0.5], [-0.2, 0.5, 0]]])


def samples(kind: str, count: int = 30, seed: int = 0, extra: int = 0):
    rng = np.random.default_rng(seed)
    x1 = rng.normal(size=(count, MODELS[kind].minimal + extra, 2)) * 200 + 400
    return x1, x1 + rng.normal(size=x1.shape) * 5


def residuals(kind: str, models, x1, x2):
    return MODELS[kind].residuals["sampson"](models, x1, x2)


def test_symmetric_transfer_of_a_homography_is_the_reference():
    expected = [0.17533808, 0.19909424, 0.00588256, 0.67875298, 0.44304915]
    assert_allclose(MODELS["homography"].residuals["transfer"](H, X1, X2)[:, 0], expected, atol=1e-8)


def test_sampson_of_a_fundamental_matrix_is_the_reference():
    expected = [0.01206409, 0.02472188, 0.01055100, 0.00171350, 0.08004435]
    assert_allclose(fundamental_sampson(F, X1, X2)[:, 0], expected, atol=1e-8)


def test_affine_fit_and_transfer_are_the_reference():
    models, ok = MODELS["affine"].fit(X1[None, :3], X2[None, :3])
    assert ok.all()
    rows = [[1.16666667, -0.03333333, 0.1], [-0.03333333, 0.96666667, 0.2], [0, 0, 1]]
    assert_allclose(models[0], rows, atol=1e-8)
    found = MODELS["affine"].residuals["transfer"](models, X1, X2)
    assert_allclose(found[:, 0], [0, 0, 0, 0.45106089, 0.00108950], atol=1e-8)


def test_hartley_normalisation_is_the_reference():
    points, transform = hartley.normalise(X1)
    assert_allclose(
        transform, [[0.89272033, 0, -1.33908050], [0, 0.89272033, -0.89272033], [0, 0, 1]], atol=1e-8
    )
    assert_allclose(np.linalg.norm(points, axis=1).mean(), np.sqrt(2))
    assert_allclose(transform @ hartley.inverse(transform), np.eye(3), atol=1e-12)


def algebraic_error(kind, model, z):
    """The equations whose first-order distance Sampson's residual is."""
    first, second = np.append(z[:2], 1), z[2:]
    if kind == "fundamental":
        return np.array([np.append(second, 1) @ model @ first])
    u, v, w = model @ first
    if kind == "affine":
        return np.array([u, v]) - second
    return np.array([second[1] * w - v, u - second[0] * w])


@pytest.mark.parametrize("kind", MODELS)
def test_sampson_is_first_order_distance(kind):
    """Against c^T (J J^T)^-1 c with J by central differences."""
    x1, x2 = samples(kind, 1)
    n1, n2 = hartley.normalise(x1)[0], hartley.normalise(x2)[0]
    models, _ = MODELS[kind].fit(n1, n2)
    z = np.random.default_rng(1).normal(size=(10, 4))
    found = residuals(kind, models, z[:, :2], z[:, 2:])[:, 0]
    for point, value in zip(z, found, strict=True):
        c = algebraic_error(kind, models[0], point)
        steps = np.eye(4) * 1e-6
        jacobian = np.stack(
            [
                (algebraic_error(kind, models[0], point + s) - algebraic_error(kind, models[0], point - s))
                / 2e-6
                for s in steps
            ],
            axis=1,
        )
        assert_allclose(value, c @ np.linalg.solve(jacobian @ jacobian.T, c), rtol=1e-5)


@pytest.mark.parametrize("kind", ["affine", "homography"])
def test_minimal_fit_is_exact(kind):
    x1, x2 = samples(kind)
    models, ok = MODELS[kind].fit(x1, x2)
    assert ok.all()
    for model, a, b in zip(models, x1, x2, strict=True):
        assert residuals(kind, model[None], a, b).max() < 1e-12


def test_eight_points_satisfy_the_epipolar_equation_before_rank_2():
    x1, x2 = (hartley.normalise(x)[0] for x in samples("fundamental"))
    models, ok = eight_point(x1, x2)
    assert ok.all()
    singular = np.linalg.svd(models, compute_uv=False)
    assert (singular[:, 2] < 1e-12 * singular[:, 0]).all()


def test_fundamental_matrix_of_a_rigid_scene_is_found():
    rng = np.random.default_rng(0)
    scene = rng.uniform(-1, 1, size=(12, 3)) + np.array([0, 0, 5])
    moved = scene @ np.array([[0.995, 0, -0.0998], [0, 1, 0], [0.0998, 0, 0.995]]) + (0.4, 0.1, -0.2)
    x1, x2 = (500 * p[..., :2] / p[..., 2:] + 300 for p in (scene, moved))
    (n1, t1), (n2, t2) = hartley.normalise(x1), hartley.normalise(x2)
    models, ok = eight_point(n1[None, :8], n2[None, :8])
    assert ok.all()
    pixels = change_frame("fundamental", models, hartley.inverse(t1), hartley.inverse(t2))
    assert fundamental_sampson(pixels, x1, x2).max() < 1e-12


@pytest.mark.parametrize("kind", MODELS)
@given(scale=st.floats(0.01, 100), shift=st.floats(-1e3, 1e3))
def test_residuals_scale_with_the_image(kind, scale, shift):
    """A similarity of both images multiplies squared distances by the squared scale."""
    x1, x2 = samples(kind, 1, extra=4)
    models, _ = MODELS[kind].fit(x1[:, :-4], x2[:, :-4])
    change = np.array([[scale, 0, shift], [0, scale, -shift], [0, 0, 1]])
    before = residuals(kind, models, x1[0], x2[0])
    moved = residuals(
        kind, change_frame(kind, models, change, change), *(x[0] * scale + (shift, -shift) for x in (x1, x2))
    )
    assert_allclose(moved, scale**2 * before, rtol=1e-3, atol=1e-6 * scale**2)


@pytest.mark.parametrize("kind", MODELS)
@pytest.mark.parametrize("fault", ["coincident", "collinear"])
def test_degenerate_samples_are_data(kind, fault):
    x1, x2 = samples(kind, 3)
    if fault == "coincident":
        x1[1], x2[1] = x1[1, 0], x2[1, 0]
    else:
        x1[1, :, 1], x2[1, :, 1] = 2 * x1[1, :, 0], 2 * x2[1, :, 0]
    models, ok = MODELS[kind].fit(x1, x2)
    assert ok.tolist() == [True, False, True]
    assert np.isfinite(models[ok]).all()


@pytest.mark.parametrize("kind", MODELS)
def test_single_precision_ranks_as_double(kind):
    x1, x2 = samples(kind, 40)
    models, _ = MODELS[kind].fit(hartley.normalise(x1)[0], hartley.normalise(x2)[0])
    z1, z2 = np.random.default_rng(2).normal(size=(2, 50, 2))
    double = residuals(kind, models, z1, z2)
    single = residuals(kind, models, z1.astype(np.float32), z2.astype(np.float32))
    assert single.dtype == np.float32
    close = np.abs(single - double) <= 1e-3 * double + 1e-5
    assert close.mean() > 0.99


@pytest.mark.parametrize("kind", MODELS)
def test_a_change_of_frame_can_be_undone(kind):
    x1, x2 = samples(kind, 9)
    models, _ = MODELS[kind].fit(x1, x2)
    t1, t2 = hartley.normalise(x1)[1], hartley.normalise(x2)[1]
    moved = change_frame(kind, models, t1, t2)
    back = change_frame(kind, moved, hartley.inverse(t1), hartley.inverse(t2))
    size = np.linalg.norm(models, axis=(1, 2), keepdims=True) / np.linalg.norm(
        back, axis=(1, 2), keepdims=True
    )
    assert_allclose(back * size, models, atol=1e-9)


def test_similarities_written_out_are_products():
    rng = np.random.default_rng(0)
    models, (_, transform) = rng.normal(size=(5, 3, 3)), hartley.normalise(rng.normal(size=(5, 4, 2)))
    assert_allclose(hartley._before(models, transform), models @ transform)
    assert_allclose(hartley._after(transform, models), transform @ models)
    assert_allclose(hartley._after(transform[0], models), transform[0] @ models)


def test_many_null_vectors_are_null_and_unit():
    """More samples than are taken together, one of them with a repeated point."""
    x1, x2 = samples("fundamental", 700)
    (n1, _), (n2, _) = hartley.normalise(x1), hartley.normalise(x2)
    n1[3, 1], n2[3, 1] = n1[3, 0], n2[3, 0]
    design = np.einsum("kpi,kpj->kpij", *(np.dstack([n, np.ones((700, 8))]) for n in (n2, n1)))
    vectors, ok = _null_vectors(design.reshape(700, 8, 9))
    assert np.flatnonzero(~ok).tolist() == [3]
    assert_allclose(np.linalg.norm(vectors, axis=0), 1)
    assert_allclose(design.reshape(700, 8, 9)[ok] @ vectors.T[ok, :, None], 0, atol=1e-12)


def test_nearest_matrices_of_rank_2_are_those_of_the_svd(rng):
    matrices = np.concatenate([rng.normal(size=(200, 3, 3)), np.diag([1.0, 0.5, 0.0])[None]])
    left, singular, right = np.linalg.svd(matrices)
    clear = singular[:, 2] < 0.9 * singular[:, 1]
    nearest = _nearest_rank_2(np.ascontiguousarray(matrices.transpose(1, 2, 0)))
    singular[:, 2] = 0
    expected = (left * singular[:, None]) @ right
    assert_allclose(nearest.transpose(2, 0, 1)[clear], expected[clear], atol=1e-12)


def test_a_matrix_of_rank_1_stays_as_it_is():
    matrix = np.outer([1.0, 2.0, 3.0], [1.0, 0.0, 1.0])
    assert_allclose(_nearest_rank_2(matrix[:, :, None])[:, :, 0], matrix, atol=1e-12)
