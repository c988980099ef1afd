"""Sampling, ordered residual kernels, co-visibility and sparsification."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse.csgraph import connected_components

from kt3dmoseg.types import Trajectories
from mseg.geometry import hartley
from mseg.geometry.hartley import change_frame
from mseg.geometry.models import MODELS
from mseg.kernels import (
    GUARD,
    _draw_subsets,
    _neighbourhood_mask,
    _preferences,
    covisible_frames,
    parts,
    sample_hypotheses,
    sparsify,
    view_kernel,
)
from mseg.types import Hypotheses


@given(size=st.integers(1, 12), count=st.integers(1, 12))
def test_subsets_are_distinct_numbers(size, count):
    count = min(size, count)
    drawn = _draw_subsets(np.full(50, size), count, np.random.default_rng(size))
    assert drawn.min() >= 0
    assert drawn.max() < size
    assert all(len(set(row)) == count for row in drawn.tolist())


def test_subsets_are_uniform():
    """Each of the 10 subsets of 2 of 5 about 2000 times in 20000: sd 42."""
    drawn = np.sort(_draw_subsets(np.full(20000, 5), 2, np.random.default_rng(0)), axis=1)
    _, counts = np.unique(drawn, axis=0, return_counts=True)
    assert len(counts) == 10
    assert np.abs(counts - 2000).max() < 250


def test_exactly_the_best_are_preferred():
    values = np.array([[3.0, 1.0, 2.0, 0.5], [1.0, 1.0, 1.0, 1.0], [np.nan, 2.0, np.nan, np.inf]])
    expected = [[0, 1, 0, 1], [1, 1, 0, 0], [0, 1, 0, 1]]
    assert_array_equal(_preferences(values, 2), np.array(expected, bool))


@given(st.integers(0, 1000))
def test_preferences_are_those_of_a_stable_sort(seed):
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 6, size=(8, 20)).astype(np.float32)
    values[rng.random(values.shape) < 0.2] = np.nan
    count = int(rng.integers(1, 20))
    expected = np.zeros(values.shape, bool)
    np.put_along_axis(expected, np.argsort(values, axis=1, kind="stable")[:, :count], True, axis=1)
    assert_array_equal(_preferences(values, count), expected)


def ordered_residual_kernel(values, count):
    marks = _preferences(values, count).astype(float)
    return marks @ marks.T / count


def test_ordered_residual_kernel_by_hand():
    """Two of four preferred: points 0 and 1 share one, point 2 shares none with 0."""
    values = np.array([[0, 1, 2, 3], [3, 0, 1, 2], [3, 2, 1, 0]], float)
    assert_allclose(ordered_residual_kernel(values, 2), [[1, 0.5, 0], [0.5, 1, 0.5], [0, 0.5, 1]])


def test_view_kernel_is_the_plain_sum_over_pairs(make_clip):
    trajectories = make_clip(missing=0.2, frames=8).evaluated_trajectories
    found = view_kernel(
        trajectories, sample_hypotheses(trajectories, "affine", np.random.default_rng(0), per_pair=40)
    )
    assert_allclose(found, found.T)
    full = trajectories.visible.astype(float)
    together = full @ full.T
    pairs = full[:, 1:] * full[:, :-1]
    assert_allclose(
        np.diagonal(found), np.diagonal(pairs @ pairs.T) / (np.diagonal(together) + 0.1), rtol=1e-5
    )
    assert (found[pairs @ pairs.T == 0] == 0).all()


@pytest.mark.parametrize("kind", ["affine", "homography", "fundamental"])
def test_view_kernel_is_the_sum_of_the_pairs_kernels(kind, make_clip):
    """Against every pair by itself; one pair has fewer hypotheses, and all pairs weigh the same."""
    trajectories = make_clip(points=40, missing=0.2, frames=7).evaluated_trajectories
    rng = np.random.default_rng(0)
    drawn = sample_hypotheses(trajectories, kind, rng, per_pair=40)
    kept = ~((drawn.pair == (2, 3)).all(axis=1) & (np.arange(len(drawn.pair)) % 2 == 0))
    hypotheses = Hypotheses(drawn.models[kept], drawn.pair[kept], kind)
    expected = np.zeros((len(trajectories),) * 2)
    for i in range(trajectories.n_frames - 1):
        rows, x1, x2 = trajectories.pair(i, i + 1)
        (n1, t1), (n2, t2) = hartley.normalise(x1), hartley.normalise(x2)
        models = hypotheses.models[(hypotheses.pair == (i, i + 1)).all(axis=1)]
        single = n1.astype(np.float32), n2.astype(np.float32)
        values = MODELS[kind].residuals["sampson"](change_frame(kind, models, t1, t2), *single)
        expected[np.ix_(rows, rows)] += ordered_residual_kernel(values, round(0.1 * len(models)))
    expected /= covisible_frames(trajectories) + GUARD
    assert_allclose(view_kernel(trajectories, hypotheses), expected, atol=1e-6)


def test_kernel_separates_motions(make_clip):
    clip = make_clip()
    trajectories, same = clip.evaluated_trajectories, clip.labels.label[:, None] == clip.labels.label
    for kind in ("affine", "homography", "fundamental"):
        kernel = view_kernel(trajectories, sample_hypotheses(trajectories, kind, np.random.default_rng(0)))
        assert kernel[same].mean() > 1.3 * kernel[~same].mean()


@pytest.mark.parametrize("gap", [5, 7, 20])
def test_pairs_further_apart_than_the_clip_is_long_join_nothing(gap):
    assert parts(np.ones((3, 4), dtype=bool), gap).tolist() == [-1, -1, -1]


def test_same_stream_same_hypotheses(make_clip):
    trajectories = make_clip().evaluated_trajectories
    first, second = (
        sample_hypotheses(trajectories, "homography", np.random.default_rng(3)) for _ in range(2)
    )
    assert_array_equal(first.models, second.models)


def test_pairs_with_few_points_are_left_out(make_clip):
    clip = make_clip(points=5, motions=2, frames=4)
    visible = clip.dense.visible.copy()
    visible[7:, 2] = False
    xy = np.where(visible[..., None], clip.dense.xy, np.nan)
    trajectories = Trajectories(xy, visible)
    pairs = {
        tuple(p)
        for p in sample_hypotheses(trajectories, "fundamental", np.random.default_rng(0)).pair.tolist()
    }
    assert pairs == {(0, 1)}
    assert len(sample_hypotheses(trajectories, "affine", np.random.default_rng(0)).pair) == 1500


# Values of the authors' function, executed once elsewhere.
BLOCKS = np.array([[1, 0.8, 0.1, 0.05], [0.8, 1, 0.2, 0.1], [0.1, 0.2, 1, 0.6], [0.05, 0.1, 0.6, 1]])
FIVE = np.array(
    [
        [0.9, 0.5, 0.45, 0.4, 0.1],
        [0.5, 0.9, 0.3, 0.35, 0.2],
        [0.45, 0.3, 0.9, 0.5, 0.4],
        [0.4, 0.35, 0.5, 0.9, 0.6],
        [0.1, 0.2, 0.4, 0.6, 0.9],
    ]
)


@pytest.mark.parametrize("alpha", [1, 5])
def test_neighbourhoods_of_two_blocks(alpha):
    assert_array_equal(_neighbourhood_mask(BLOCKS, alpha), np.kron(np.eye(2), np.ones((2, 2))))


def test_neighbourhoods_of_five_points():
    expected = [
        [1, 1, 1, 0.5, 0],
        [1, 1, 0, 0.5, 0],
        [1, 0, 1, 1, 0.5],
        [0.5, 0.5, 1, 1, 1],
        [0, 0, 0.5, 1, 1],
    ]
    assert_array_equal(_neighbourhood_mask(FIVE, 2), expected)
    assert_allclose(sparsify(FIVE, 2), FIVE * expected)


def test_weak_ties_join_the_pieces_of_a_motion_and_no_two_motions(rng):
    """Two motions of two pieces: 0.7 inside a piece, 0.53 between those of a motion, 0.03 between motions."""
    motion, piece = np.repeat([0, 1], 40), np.repeat([0, 1, 2, 3], 20)
    kernel = np.where(piece[:, None] == piece, 0.7, np.where(motion[:, None] == motion, 0.53, 0.03))
    noise = rng.uniform(0.95, 1.05, size=kernel.shape)
    kernel *= (noise + noise.T) / 2
    np.fill_diagonal(kernel, 0.95)
    assert connected_components(sparsify(kernel, 8))[0] == 4
    joined = sparsify(kernel)
    count, component = connected_components(joined)
    assert count == 2
    assert len(set(zip(component.tolist(), motion.tolist(), strict=True))) == 2
    assert_allclose(joined.sum(), 1.1 * sparsify(kernel, 9).sum())


def test_sparsification_in_single_precision_is_that_in_double(make_clip):
    trajectories = make_clip(points=60).evaluated_trajectories
    kernel = view_kernel(trajectories, sample_hypotheses(trajectories, "affine", np.random.default_rng(0)))
    assert_array_equal(_neighbourhood_mask(kernel, 10), _neighbourhood_mask(kernel.astype(np.float64), 10))


def test_constant_rows_keep_nothing():
    assert not _neighbourhood_mask(np.zeros((3, 3)), 2).any()
    assert not _neighbourhood_mask(np.ones((3, 3)), 2).any()
    assert not sparsify(np.ones((3, 3))).any()


@pytest.mark.parametrize("alpha", [0.5, 1.0, 2.0, 3.0, 7.0, 8.0, 10.0, 2.5])
def test_neighbours_are_those_of_the_power_as_it_is_defined(alpha, rng):
    half = rng.uniform(0, 1, size=(40, 40))
    kernel = (half + half.T) / 2
    distance = (kernel**alpha).max(axis=1, keepdims=True) - kernel**alpha
    share = distance / distance.sum(axis=1, keepdims=True)
    logarithm = np.log(share + np.finfo(np.float64).eps)
    keep = logarithm < (share * logarithm).sum(axis=1, keepdims=True)
    assert_array_equal(_neighbourhood_mask(kernel, alpha), (keep.astype(float) + keep.T) / 2)
