"""Normalised cuts of one partition in several graphs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import mseg
from kt3dmoseg.synthetic import SceneOptions, make_scene
from kt3dmoseg.types import Clip
from mseg.clustering.fusion import lower_cut
from mseg.clustering.spectral import GraphLaplacian
from mseg.evaluation import classification_error


def normalised_cut(weights, labels, n_clusters, uniform=0.0):
    """Weight that leaves each cluster, divided by all its weight; Shi and Malik's definition, by loops."""
    weights = weights + uniform * weights.sum() / len(weights) ** 2
    total = 0.0
    for cluster in range(n_clusters):
        inside = labels == cluster
        all_weight = weights[inside].sum()
        total += weights[inside][:, ~inside].sum() / all_weight if all_weight else 1.0
    return total


def random_graph(rng, size):
    weights = rng.random((size, size)) * (rng.random((size, size)) < 0.4)
    return weights + weights.T + np.eye(size)


def blocks(labels, rng, noise=0.05):
    weights = (labels[:, None] == labels) + noise * rng.random((len(labels), len(labels)))
    return weights + weights.T


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 10_000),
    st.integers(2, 25),
    st.integers(1, 5),
    st.integers(1, 3),
    st.sampled_from([0.0, 0.1]),
)
def test_descent(seed, size, n_clusters, n_graphs, uniform):
    rng = np.random.default_rng(seed)
    weights = [random_graph(rng, size) for _ in range(n_graphs)]
    graphs = [GraphLaplacian(w, uniform=uniform) for w in weights]
    start = rng.integers(n_clusters, size=size)
    found = lower_cut(graphs, start, n_clusters)
    value, before = (
        sum(normalised_cut(w, labels, n_clusters, uniform) for w in weights)
        for labels in (found.labels, start)
    )
    assert_allclose(found.value, value, atol=1e-9)
    assert value <= before + 1e-9
    assert len(np.unique(found.labels)) >= len(np.unique(start))
    assert_array_equal(lower_cut(graphs, found.labels, n_clusters).labels, found.labels)


def test_mislabelled_vertices_move_home():
    rng = np.random.default_rng(0)
    truth = np.repeat([0, 1, 2], [10, 20, 30])
    graphs = [GraphLaplacian(blocks(truth, rng)) for _ in range(2)]
    start = np.where(rng.random(60) < 0.2, rng.integers(3, size=60), truth)
    assert (start != truth).sum() > 5
    assert_array_equal(lower_cut(graphs, start, 3).labels, truth)


def test_all_graphs_count():
    """Two halves of a cluster that one graph separates and another does not are no two clusters."""
    rng = np.random.default_rng(0)
    truth, slices = np.repeat([0, 1], [30, 10]), np.repeat([0, 1, 0], [15, 15, 10])
    views = [GraphLaplacian(blocks(labels, rng)) for labels in (truth, slices + 2 * truth)]
    right, wrong = (lower_cut(views, labels, 2) for labels in (truth, slices))
    assert right.value < wrong.value


def test_a_vertex_without_weight_in_one_graph_follows_the_other():
    rng = np.random.default_rng(0)
    truth = np.repeat([0, 1], 10)
    first, second = blocks(truth, rng), blocks(truth, rng)
    first[0] = first[:, 0] = 0
    start = truth.copy()
    start[0] = 1
    found = lower_cut([GraphLaplacian(first), GraphLaplacian(second)], start, 2)
    assert_array_equal(found.labels, truth)


@pytest.mark.parametrize("method", ["coreg", "subset"])
def test_slices_of_the_background_do_not_outvote_the_motions(method):
    """Exact tracks of a deep scene: its affine and homography kernels fall into slices of depth."""
    scene = make_scene(SceneOptions(width=828, height=250, frames=10, objects=2, seed=5))
    x, y = np.meshgrid(np.arange(8, 828, 24.0), np.arange(8, 250, 16.0))
    seeds = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 5)])
    tracks, labels = scene.trajectories(seeds), scene.labels(seeds)
    clip = Clip("deep", tracks, np.arange(len(tracks)), labels)
    found = mseg.segment(clip, method, n_motions=3, seed=0)
    assert classification_error(labels.label, found.labels) < 0.02
    assert found.report["cuts"][found.report["chosen"]] == min(found.report["cuts"].values())
