"""Laplacian, eigenvectors, k-means, fusion."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import eigh
from scipy.sparse import csr_array

from kt3dmoseg.errors import InvalidValueError
from mseg.clustering.fusion import constrain_subsets, coregularise
from mseg.clustering.kmeans import kmeans
from mseg.clustering.spectral import (
    GraphLaplacian,
    normalised_laplacian,
    smallest_eigenvectors,
    spectral_clustering,
    spectral_embedding,
)
from mseg.errors import TooFewPointsError


def blobs(n: int, rng: np.random.Generator) -> np.ndarray:
    centres = np.array([[0, 0], [9, 0], [0, 9]])
    return np.concatenate([rng.normal(size=(n, 2)) + c for c in centres])


def gaussian(points: np.ndarray) -> np.ndarray:
    return np.exp(-((points[:, None] - points) ** 2).sum(axis=2) / 2)


def test_laplacian_by_hand():
    """Degrees 2, 2, 0: the last vertex hangs on nothing."""
    weights = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 0.0]])
    assert_allclose(normalised_laplacian(weights), [[0.5, -0.5, 0], [-0.5, 0.5, 0], [0, 0, 1]])


@pytest.mark.parametrize("uniform", [0.0, 0.5])
def test_sparse_laplacian_is_the_dense_one(rng, uniform):
    weights = gaussian(rng.normal(size=(30, 2)))
    spread = weights + uniform * weights.sum(axis=1).mean() / 30
    expected = normalised_laplacian(spread)
    for given_weights in (weights, csr_array(weights)):
        laplacian = GraphLaplacian(given_weights, uniform=uniform)
        assert_allclose(np.asarray(laplacian), expected, atol=1e-12)
        assert_allclose(laplacian @ np.eye(30), expected, atol=1e-12)


@pytest.mark.parametrize("bad", [np.array([[np.nan]]), np.array([[-1.0]])])
def test_affinities_are_checked(bad):
    for make in (normalised_laplacian, GraphLaplacian):
        with pytest.raises(InvalidValueError, match="affinity"):
            make(bad)


def test_krylov_finds_what_lapack_finds(rng):
    """Beyond LAPACK's size, with an eigenvalue of multiplicity three (three components)."""
    block = gaussian(rng.normal(size=(120, 3)))
    laplacian = normalised_laplacian(np.kron(np.eye(3), block))
    values, vectors = eigh(laplacian, subset_by_index=(0, 2))
    found = smallest_eigenvectors(laplacian, 3)
    assert_allclose(found.T @ found, np.eye(3), atol=1e-12)
    assert_allclose(np.einsum("nk,nk->k", found, laplacian @ found), values, atol=1e-12)
    assert_allclose(found @ found.T, vectors @ vectors.T, atol=1e-6)


def test_lapack_takes_over_where_krylov_does_not_get_there(rng):
    """Below the precision of a product no residual falls."""
    laplacian = normalised_laplacian(gaussian(rng.normal(size=(300, 3))))
    vectors = eigh(laplacian, subset_by_index=(0, 1))[1]
    found = smallest_eigenvectors(laplacian, 2, tolerance=0.0)
    assert_allclose(found @ found.T, vectors @ vectors.T, atol=1e-12)


def test_eigenvectors_have_a_fixed_sign(rng):
    vectors = spectral_embedding(gaussian(rng.normal(size=(20, 2))), 3)
    assert (vectors.max(axis=0) >= -vectors.min(axis=0)).all()


def test_kmeans_separates_blobs(rng):
    points = blobs(30, rng)
    found = kmeans(points, 3, rng)
    assert [len(set(found.labels[i : i + 30].tolist())) for i in (0, 30, 60)] == [1, 1, 1]
    assert_allclose(found.inertia, ((points - found.centres[found.labels]) ** 2).sum())


@settings(max_examples=30)
@given(st.integers(0, 500), st.integers(1, 5))
def test_kmeans_ends_in_a_local_optimum(seed, clusters):
    points = np.random.default_rng(seed).normal(size=(25, 3))
    found = kmeans(points, clusters, np.random.default_rng(seed), n_restarts=3)
    distance = ((points[:, None] - found.centres) ** 2).sum(axis=2)
    assert_allclose(
        np.take_along_axis(distance, found.labels[:, None], 1)[:, 0], distance.min(axis=1), atol=1e-12
    )
    for k in np.unique(found.labels):
        assert_allclose(found.centres[k], points[found.labels == k].mean(axis=0), atol=1e-9)


def test_more_restarts_are_no_worse_and_state_decides(rng):
    points = rng.normal(size=(200, 4))
    few, many = (kmeans(points, 6, np.random.default_rng(0), n_restarts=r).inertia for r in (1, 40))
    assert many <= few
    again = kmeans(points, 6, np.random.default_rng(0), n_restarts=40)
    assert again.inertia == many


def test_kmeans_with_fewer_distinct_points_than_clusters(rng):
    assert_array_equal(kmeans(np.ones((4, 2)), 3, rng).labels, [0, 0, 0, 0])
    assert len(set(kmeans(np.repeat(np.eye(2), 3, axis=0), 3, rng).labels.tolist())) == 2


def test_points_that_are_not_numbers_are_refused(rng):
    with pytest.raises(InvalidValueError, match="finite matrix"):
        kmeans(np.array([[0.0, np.nan]]), 1, rng)


def test_too_many_clusters(rng):
    for call in (
        lambda: kmeans(np.ones((2, 2)), 3, rng),
        lambda: spectral_clustering(np.ones((2, 2)), 3, rng),
    ):
        with pytest.raises(TooFewPointsError, match=r"1\.\.2"):
            call()


def test_spectral_clustering_labels_start_at_one(rng):
    labels = spectral_clustering(gaussian(blobs(20, rng)), 3, rng)
    assert labels.dtype == np.int64
    assert sorted(set(labels.tolist())) == [1, 2, 3]


INDEX = np.arange(8)
SAME_HALF = (INDEX[:, None] < 4) == (INDEX < 4)
LAPLACIANS = [
    normalised_laplacian(np.exp(-np.abs(INDEX[:, None] - INDEX) / v) + 0.3 * SAME_HALF) for v in (1, 2, 3)
]
# Sweeps, objective and entries (1,1), (1,8), (3,6) of U U^T per view, of the authors' functions.
REFERENCE = [
    (coregularise, 0.01, 3, 0.7173194594, [(0.2698756940, -0.0482119280, 0.0086962919),
     (0.2882268926, -0.0743398595, 0.0231422800), (0.2954877097, -0.0791525337, 0.0261393245)]),
    (coregularise, 0.5, 9, -5.1608865096, [(0.2796912994, -0.0612831553, 0.0161381175),
     (0.2848694810, -0.0689380474, 0.0202088844), (0.2866870379, -0.0698848237, 0.0208509095)]),
    (constrain_subsets, 0.01, 2, 0.7971543804, [(0.2691312049, -0.0479129914, 0.0085368659),
     (0.2881634816, -0.0745252643, 0.0232564523), (0.2959096203, -0.0791621495, 0.0261093628)]),
    (constrain_subsets, 0.5, 9, -1.1579497356, [(0.2685704412, -0.0783649909, 0.0269126522),
     (0.2792976139, -0.0705626059, 0.0210265095), (0.2861183337, -0.0582296446, 0.0131092134)]),
]  # fmt: skip


HOW = {
    coregularise: {"tolerance": 1e-6, "max_sweeps": 16},
    constrain_subsets: {"tolerance": 1e-8, "max_sweeps": 21},
}


@pytest.mark.parametrize(("fuse", "weight", "sweeps", "objective", "entries"), REFERENCE)
def test_fusion_is_the_reference(fuse, weight, sweeps, objective, entries):
    fusion = fuse(LAPLACIANS, 2, weight=weight, **HOW[fuse])
    assert fusion.converged
    assert len(fusion.objectives) == sweeps
    assert_allclose(fusion.objectives[-1], objective, atol=1e-9)
    for embedding, expected in zip(fusion.embeddings, entries, strict=True):
        z = embedding @ embedding.T
        assert_allclose((z[0, 0], z[0, 7], z[2, 5]), expected, atol=1e-6)


@pytest.mark.parametrize("fuse", [coregularise, constrain_subsets])
def test_fusion_without_weight_leaves_views_alone(fuse):
    fusion = fuse(LAPLACIANS, 2, weight=0.0, **HOW[fuse])
    for embedding, laplacian in zip(fusion.embeddings, LAPLACIANS, strict=True):
        assert_allclose(embedding, smallest_eigenvectors(laplacian, 2), atol=1e-8)


@pytest.mark.parametrize("fuse", [coregularise, constrain_subsets])
def test_fusion_of_large_views_is_that_of_small_ones(fuse, rng):
    """The Krylov path with products only, against LAPACK on written-out matrices."""
    weights = [gaussian(blobs(90, rng) / 3) for _ in range(3)]
    fusion = fuse([GraphLaplacian(w) for w in weights], 3, weight=0.01, tolerance=1e-12, max_sweeps=4)
    dense = [normalised_laplacian(w) for w in weights]
    embeddings = [eigh(laplacian, subset_by_index=(0, 2))[1] for laplacian in dense]
    for _ in range(len(fusion.objectives)):
        for v in range(3):
            inner = [u @ u.T for u in embeddings]
            if fuse is coregularise:
                reward = sum(inner[w] for w in range(3) if w != v)
            else:
                reward = (np.maximum(inner[v - 1], 0) if v else 0) + (
                    np.minimum(inner[v + 1], 0) if v < 2 else 0
                )
            embeddings[v] = eigh(dense[v] - 0.01 * reward, subset_by_index=(0, 2))[1]
    for found, expected in zip(fusion.embeddings, embeddings, strict=True):
        assert_allclose(found @ found.T, expected @ expected.T, atol=1e-5)


def test_joint_embedding_has_unit_rows():
    joint = coregularise(LAPLACIANS, 2, weight=0.01, **HOW[coregularise]).joint()
    assert joint.shape == (8, 6)
    assert_allclose(np.linalg.norm(joint, axis=1), 1)
