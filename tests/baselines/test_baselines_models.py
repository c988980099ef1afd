"""Self-expressive models, affinities, discretisation, preferences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mseg.clustering.spectral import count_by_eigengap
from mseg.errors import SegmentationError
from mseg.iteration import iterate
from mseg.methods.preferences import tanimoto_distance
from mseg.methods.self_expression import (
    _ShiftedInverse,
    keep_largest,
    low_rank_affinity,
    low_rank_representation,
    low_rank_sparse_representation,
    sparse_affinity,
    sparse_representation,
)
from mseg.methods.subspaces import _discretise, _ncut_embedding


def subspaces(rng, sizes=(15, 20), dimension=3, ambient=12, affine=False):
    inside = [rng.normal(size=(dimension, n)) for n in sizes]
    if affine:
        inside = [np.vstack([part[1:], np.ones(part.shape[1])]) for part in inside]
    parts = [rng.normal(size=(ambient, dimension)) @ part for part in inside]
    return np.hstack(parts) / 10, np.repeat(np.arange(len(sizes)), sizes)


def across(affinity, labels):
    """Share of the weight between different groups."""
    return affinity[labels[:, None] != labels].sum() / affinity.sum()


def test_shifted_inverse_equals_the_dense_solution(rng):
    rows, right = rng.normal(size=(4, 9)), rng.normal(size=(9, 5))
    dense = np.linalg.solve(rows.T @ rows + 0.3 * np.eye(9), right)
    np.testing.assert_allclose(_ShiftedInverse(rows).solve(right, 0.3), dense, rtol=1e-10)


def test_sparse_coefficients_keep_to_the_own_subspace(rng):
    data, labels = subspaces(rng, affine=True)
    solved = sparse_representation(data)
    c = solved.coefficients
    assert solved.convergence.converged
    assert not np.diagonal(c).any()
    assert across(np.abs(c), labels) < 0.02
    np.testing.assert_allclose(c.sum(axis=0), 1, atol=0.02)


def test_heavier_weights_remove_coefficients(rng):
    data, labels = subspaces(rng)
    weights = np.where(labels[:, None] == labels, 1.0, 1000.0)
    c = sparse_representation(data, weights=weights).coefficients
    assert across(np.abs(c), labels) < 1e-6


def test_a_start_at_the_solution_needs_fewer_iterations(rng):
    data, _ = subspaces(rng)
    cold = sparse_representation(data, tolerance=1e-5, max_iterations=2000)
    warm = sparse_representation(data, tolerance=1e-2, start=cold.coefficients)
    again = sparse_representation(data, tolerance=1e-2)
    assert warm.convergence.iterations <= again.convergence.iterations


def test_points_that_cannot_be_expressed_are_an_error():
    with pytest.raises(SegmentationError, match="orthogonal"):
        sparse_representation(np.eye(3))


def test_a_single_point_is_one_cluster():
    assert count_by_eigengap(np.ones((1, 1))) == 1


def test_low_rank_coefficients_of_clean_data_are_the_shape_interaction_matrix(rng):
    data, labels = subspaces(rng)
    solved = low_rank_representation(data, weight=1000.0)
    right = np.linalg.svd(data)[2][:6]
    assert solved.convergence.converged
    np.testing.assert_allclose(solved.coefficients, right.T @ right, atol=1e-4)
    assert across(low_rank_affinity(solved.coefficients, data), labels) < 1e-6


def test_low_rank_sparse_coefficients(rng):
    data, labels = subspaces(rng)
    solved = low_rank_sparse_representation(data)
    assert solved.convergence.converged
    assert not np.diagonal(solved.coefficients).any()
    assert across(np.abs(solved.coefficients), labels) < 0.05
    rank = np.linalg.matrix_rank(solved.coefficients, tol=0.05)
    assert rank <= np.linalg.matrix_rank(sparse_representation(data).coefficients, tol=0.05)


def test_iterate_reports_whether_it_converged():
    residuals = iter([3.0, 2.0, 0.5, 0.1])
    ended = iterate(lambda: next(residuals), tolerance=1.0, max_iterations=10)
    assert (ended.converged, ended.iterations, ended.residual) == (True, 3, 0.5)
    assert not iterate(lambda: 2.0, tolerance=1.0, max_iterations=4).converged
    never = iterate(lambda: float("nan"), tolerance=1.0, max_iterations=4)
    assert (never.converged, never.iterations) == (False, 4)


def test_keep_largest_by_hand():
    column = np.array([[0.5], [-0.3], [0.15], [0.05]])
    np.testing.assert_array_equal(keep_largest(column, 0.7).ravel(), [0.5, -0.3, 0, 0])
    np.testing.assert_array_equal(keep_largest(column, 0.5).ravel(), [0.5, 0, 0, 0])
    assert keep_largest(column, 1.0) is column


@given(st.integers(0, 10_000), st.floats(0.1, 1))
@settings(max_examples=25, deadline=None)
def test_sparse_affinity_is_symmetric_and_bounded(seed, share):
    affinity = sparse_affinity(np.random.default_rng(seed).normal(size=(8, 8)), share)
    np.testing.assert_array_equal(affinity, affinity.T)
    assert affinity.min() >= 0
    assert affinity.max() <= 2


def blocks(sizes, weak=0.01):
    labels = np.repeat(np.arange(len(sizes)), sizes)
    return np.where(labels[:, None] == labels, 1.0, weak), labels


@pytest.mark.parametrize("sizes", [(5, 5), (4, 8, 6), (3, 4, 5, 6)])
def test_blocks_are_counted_and_cut(rng, sizes):
    affinity, labels = blocks(sizes)
    assert count_by_eigengap(affinity) == len(sizes)
    found = _discretise(_ncut_embedding(affinity, len(sizes)), rng)[0]
    same = labels[:, None] == labels
    np.testing.assert_array_equal(found[:, None] == found, same)


def test_discretise_does_not_depend_on_the_seed():
    affinity, _ = blocks((6, 9, 7), weak=0.2)
    embedding = _ncut_embedding(affinity, 3)
    partitions = [_discretise(embedding, np.random.default_rng(s))[0] for s in range(4)]
    for labels in partitions[1:]:
        np.testing.assert_array_equal(labels[:, None] == labels, partitions[0][:, None] == partitions[0])


def test_tanimoto_by_hand():
    distance = tanimoto_distance(np.array([[1.0, 0], [1, 0], [0, 1], [1, 1], [0, 0]]))
    np.testing.assert_allclose(distance[0], [0, 0, 1, 0.5, 1])
    np.testing.assert_array_equal(np.diagonal(distance), 0)
    np.testing.assert_array_equal(distance[4, :4], 1)
