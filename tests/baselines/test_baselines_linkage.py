"""Methods by preferences, coding length and several views: what they promise on clean data."""

from dataclasses import replace

import numpy as np
import pytest

import mseg.methods as methods
from kt3dmoseg.types import Clip, Labels, Trajectories
from mseg.completion import robust_pca
from mseg.errors import SegmentationError
from mseg.geometry.models import fundamental_sampson
from mseg.geometry.subspaces import best_flat_distances, flat_distances, trajectory_matrix
from mseg.kernels import draw_near_subsets
from mseg.methods.alc import _coding_lengths, _compress, _elect, _sparsity_preserving_dimension
from mseg.methods.complete_data import by_size, complete_data
from mseg.methods.preferences import _code_length, _count_large, _factors, _linkage, _reassign
from mseg.methods.tpv import (
    _collaborative_representation,
    _epipolar_views,
    _ViewGroups,
)


def agree(labels, truth):
    return np.array_equal(labels[:, None] == labels, truth[:, None] == truth)


@pytest.mark.parametrize("name", ["alc", "tlinkage", "rpa"])
def test_affine_motions_are_separated(make_scene, name):
    clip = make_scene(np.random.default_rng(1), (26, 20), n_frames=10, noise=0.05)
    options = {"dimension": 5, "distortions": 25} if name == "alc" else {}
    result = methods.segment(clip, name, n_motions=2, **options)
    inlier = result.labels > 0
    assert inlier.mean() > 0.9
    assert agree(result.labels[inlier], clip.labels.label[inlier])
    assert result.report.get("converged", True)


def test_tlinkage_finds_the_number_of_motions_and_lowers_the_threshold(make_scene):
    clip = make_scene(np.random.default_rng(2), (25, 25, 25), noise=0.02)
    assert agree(methods.segment(clip, "tlinkage").labels, clip.labels.label)
    coarse = methods.segment(clip, "tlinkage", n_motions=3, epsilon=300.0)
    assert set(coarse.labels) == {1, 2, 3}
    assert coarse.report["epsilon"] < 300


@pytest.mark.parametrize("name", ["alc", "rpa"])
def test_a_number_of_motions_is_asked_for(make_scene, name):
    clip = make_scene(np.random.default_rng(3), (10, 10))
    with pytest.raises(methods.InvalidValueError, match="n_motions"):
        methods.segment(clip, name)


def test_linkage_separates_orthogonal_tastes():
    tastes = np.array([[1, 0.5, 0], [0, 0, 1], [0.9, 0.6, 0], [0, 0, 0], [1, 0.4, 0]])
    np.testing.assert_array_equal(_linkage(tastes), [1, 2, 1, 3, 1])
    np.testing.assert_array_equal(by_size(np.array([7, 3, 3, 9])), [2, 1, 1, 3])


@pytest.mark.parametrize(
    ("sizes", "large"),
    [
        ([40, 30, 2, 1], 2),
        ([100, 20, 18, 1], 3),
        ([9], 1),
        ([50, 3, 2], 1),  # the largest drops are next to the size of a sample, which is no cluster
        ([50, 4, 1], 2),
        ([50, 3], 1),
    ],
)
def test_outlier_clusters_come_after_the_largest_drop(sizes, large):
    assert _count_large(np.array(sizes)) == large


def test_distances_to_flats(rng):
    points = rng.normal(size=(9, 5))
    samples = np.array([[0, 1, 2, 3], [4, 5, 6, 7]])
    distance = flat_distances(points, samples)
    np.testing.assert_allclose(distance[samples, [[0], [1]]], 0, atol=1e-12)
    basis, _ = np.linalg.qr((points[1:4] - points[0]).T)
    off = (points - points[0]) - (points - points[0]) @ basis @ basis.T
    np.testing.assert_allclose(distance[:, 0], np.linalg.norm(off, axis=1), atol=1e-12)
    np.testing.assert_allclose(best_flat_distances(points, np.arange(4), 3), distance[:, 0], atol=1e-12)


def test_near_subsets_are_subsets_that_start_with_each_point_in_turn(rng):
    points = np.vstack([rng.normal(size=(12, 3)), 100 + rng.normal(size=(12, 3))])
    subsets = draw_near_subsets(points, 60, 4, rng)
    np.testing.assert_array_equal(subsets[:, 0], np.arange(60) % 24)
    assert all(len(set(row)) == 4 for row in subsets.tolist())
    assert ((subsets < 12) == (subsets[:, :1] < 12)).mean() > 0.99


def test_coding_length_of_the_definition(rng):
    points, labels = rng.normal(size=(3, 10)), np.repeat([1, 2], [6, 4])
    expected = 0.0
    for group, m in ((1, 6), (2, 4)):
        part = points[:, labels == group]
        _, logarithm = np.linalg.slogdet(np.eye(3) + 3 / (0.5**2 * m) * part @ part.T)
        expected += (m + 3) / 2 * logarithm / np.log(2) - m * np.log2(m / 10)
    np.testing.assert_allclose(_coding_lengths(points, labels, np.array([0.5])), expected)


def greedily_merged(points, distortion):
    """Merge by the definition: of all unions the one that saves most."""
    at = np.array([distortion])

    def bits(labels):
        return _coding_lengths(points, labels, at)[0]

    labels = np.arange(points.shape[1])
    while True:
        pairs = [(i, j) for i in np.unique(labels) for j in np.unique(labels) if i < j]
        unions = [np.where(labels == j, i, labels) for i, j in pairs]
        best = min(unions, key=bits, default=labels)
        if not unions or bits(best) > bits(labels):
            return labels if bits(labels) <= bits(np.zeros_like(labels)) else np.zeros_like(labels)
        labels = best


@pytest.mark.parametrize("distortion", [1e-8, 0.05, 1.0, 20.0, 300.0])
def test_merging_is_greedy_by_the_coding_length(rng, distortion):
    for _ in range(3):
        planes = [rng.normal(size=(3, 2)) @ rng.normal(size=(2, 7)) * 30 for _ in range(2)]
        points = np.hstack(planes) + 0.5 * rng.normal(size=(3, 14))
        assert agree(_compress(points, distortion), greedily_merged(points, distortion))


def test_compression_finds_planes(rng):
    planes = [rng.normal(size=(4, 2)) @ rng.normal(size=(2, 20)) * 50 for _ in range(2)]
    points = np.hstack(planes) + 0.01 * rng.normal(size=(4, 40))
    assert agree(_compress(points, 0.1), np.repeat([1, 2], 20))


def test_election_without_a_candidate_is_reported(rng):
    points = rng.normal(size=(2, 12))
    found = [np.repeat([1, 2], 6), np.ones(12, dtype=int)]
    labels, report = _elect(points, np.array([0.1, 1.0]), found, 3)
    np.testing.assert_array_equal(labels, found[0])
    assert report["exact_count"] is False
    assert _sparsity_preserving_dimension(60) == 16


def test_factors_recover_memberships():
    truth = np.kron(np.eye(2), np.ones((5, 1)))
    found, convergence = _factors(truth @ truth.T, truth + 0.2)
    assert convergence.converged
    np.testing.assert_allclose(found, truth, atol=1e-3)


def test_correspondences_of_a_motion_lie_in_a_hyperplane(make_scene):
    clip = make_scene(np.random.default_rng(4), (30,))
    for view in _epipolar_views(clip.evaluated_trajectories, 3, 0.25):
        assert np.linalg.svd(view)[1][-1] < 1e-9
        np.testing.assert_allclose(np.linalg.norm(view, axis=0), 1)


def test_short_trajectories_get_near_frames_and_more_pairs(make_scene):
    clip = make_scene(np.random.default_rng(5), (40,), n_frames=24)
    visible = (np.arange(24) // 8)[None] == (np.arange(40) % 3)[:, None]
    parts = Trajectories(np.where(visible[..., None], clip.dense.xy, np.nan), visible)
    assert len(_epipolar_views(clip.dense, 3, 0.5)) == 3
    views = _epipolar_views(parts, 3, 0.5)
    assert views.any(axis=(0, 1)).all()


def test_collaboration_leaves_unseen_points_out(rng):
    views = [rng.normal(size=(3, 8)) for _ in range(2)]
    for view in views:
        view[:, 7] = 0
    solved = _collaborative_representation(
        np.array([v / np.maximum(np.linalg.norm(v, axis=0), 1e-9) for v in views]), 8000.0, 50.0, 200
    )
    assert not solved.coefficients[7].any()
    assert not solved.coefficients[:, 7].any()
    assert not np.diagonal(solved.coefficients).any()


def two_motions(make_scene, unseen=0):
    """Groups of a clip of 30 and 30 trajectories, the first few unseen, without affinity between motions."""
    clip = make_scene(np.random.default_rng(4), (30, 30), noise=0.02)
    views = _epipolar_views(clip.evaluated_trajectories, 4, 0.5)
    views[:, :, :unseen] = 0
    truth = clip.labels.label
    return _ViewGroups(views, (truth[:, None] == truth).astype(float), 0.005, 1.0, "fundamental"), truth


def test_pieces_of_motions_merge(make_scene):
    groups, truth = two_motions(make_scene)
    pieces = 2 * truth - (np.arange(60) % 30 < 14)
    assert agree(groups.merge(pieces, 2), truth)
    assert agree(groups.merge(truth, 3), truth)


def test_trajectories_move_to_their_motion_and_the_cost_falls(make_scene):
    groups, truth = two_motions(make_scene, unseen=2)
    wrong = truth.copy()
    moved = [np.flatnonzero(truth == 1)[4], np.flatnonzero(truth == 2)[5]]
    wrong[moved] = 3 - truth[moved]
    found, convergence = groups.reassign(wrong, 20)
    np.testing.assert_array_equal(found[2:], truth[2:])
    assert convergence.converged
    assert groups.cost(found) < groups.cost(wrong)
    assert not groups.reassign(wrong, 1)[1].converged


@pytest.mark.parametrize("seed", range(3))
def test_tpv_separates_planes_that_move(seed):
    """Two planes across one another, growing and shifting: no fundamental matrix of theirs is determined."""
    rng = np.random.default_rng(seed)
    truth, frames = np.repeat([1, 2], 60), np.arange(8)[:, None]
    start, step = rng.uniform((40, 40), (280, 200), (120, 2)), rng.uniform(-3, 3, (2, 2))
    growth = 1 + 0.01 * frames * truth[:, None, None]
    xy = (start[:, None] - (160, 120)) * growth + (160, 120) + step[truth - 1][:, None] * frames
    xy += rng.normal(0, 0.1, xy.shape)
    tracks = Trajectories(xy, np.ones(xy.shape[:2], dtype=bool), image_size=(320, 240))
    clip = Clip("planes", tracks, np.arange(120), Labels(truth))
    assert agree(methods.segment(clip, "tpv", n_motions=2).labels, truth)


def test_the_order_of_trajectories_means_nothing_to_tpv(make_scene, rng):
    scene = make_scene(rng, (60, 40), noise=0.5, missing=0.4).evaluated_trajectories
    order = rng.permutation(len(scene))

    def coefficients(tracks):
        views = _epipolar_views(tracks, 8, 0.25)
        return _collaborative_representation(views, 8000.0, 50.0, 100).coefficients

    first, second = coefficients(scene), coefficients(scene.select(order))
    assert first.max() > 0.1
    np.testing.assert_allclose(first[np.ix_(order, order)], second, atol=1e-3 * first.max())


def test_tpv_reports_a_group_that_would_become_empty(make_scene):
    clip = make_scene(np.random.default_rng(5), (40, 30))
    views = _epipolar_views(clip.evaluated_trajectories, 4, 0.25)
    groups = _ViewGroups(views, np.eye(70), 0.005, 0.0, "fundamental")
    labels = clip.labels.label.copy()
    labels[:2] = 3  # two trajectories have no matrix of their own
    assert not groups.reassign(labels, 100)[1].converged


def test_epipolar_distance_is_that_of_sampson(make_scene):
    clip = make_scene(np.random.default_rng(6), (25,), noise=0.5)
    view = _epipolar_views(clip.evaluated_trajectories, 1, 1.0)[0]
    first, second = view[6:8] / view[8], view[2:8:3] / view[8]
    models = np.linalg.eigh(view @ view.T)[1][:, 0].reshape(1, 3, 3)
    expected = fundamental_sampson(models, first.T, second.T)[:, 0]
    cost = _ViewGroups(view[None], np.eye(25), 1e-9, 0.0, "fundamental").cost(np.ones(25, dtype=int))
    assert cost == pytest.approx(np.log(expected.mean() + 1e-18) / 2)


def test_points_move_to_their_flat_and_the_code_shortens(rng):
    flats = [rng.normal(size=(30, 2)) @ rng.normal(size=(2, 4)) * 20 + 5 * k for k in range(2)]
    points, truth = np.vstack(flats), np.repeat([1, 2], 30)
    start = truth.copy()
    start[[0, 9, 40]], start[[1, 2]] = [2, 2, 1], 0
    found, convergence = _reassign(points, start, 2, 9)
    assert convergence.converged
    assert not _reassign(points, start, 2, 1)[1].converged
    np.testing.assert_array_equal(found, truth)
    assert _code_length(points, found, 2) < _code_length(points, np.where(start == 0, 2, start), 2)
    np.testing.assert_array_equal(_reassign(points[:3], np.arange(1, 4), 2, 9)[0], [1, 2, 3])


def test_code_length_of_the_definition(rng):
    points = rng.normal(size=(12, 3))
    s = np.linalg.eigvalsh(np.cov(points.T, bias=True)) + 0.01
    # The two variances across are added before the precision is: once 0.01, not twice.
    expected = 12 * (np.log(s[2]) + np.log(s[0] + s[1] - 0.01)) / 2
    assert _code_length(points, np.ones(12, dtype=int), 1) == pytest.approx(expected)


def test_a_given_epsilon_separates_easy_motions(make_scene):
    clip = make_scene(np.random.default_rng(1), (26, 26), n_frames=10, noise=0.02)
    result = methods.segment(clip, "tlinkage", n_motions=2, choose_epsilon=False)
    assert agree(result.labels, clip.labels.label)


def test_tpv_needs_trajectories_in_pairs_of_frames():
    xy = np.full((6, 4, 2), np.nan)
    xy[np.arange(6), np.arange(6) % 4] = 50.0
    clip = Clip("rare", Trajectories(xy, np.isfinite(xy).all(axis=2)), np.arange(6), Labels(np.ones(6, int)))
    with pytest.raises(SegmentationError, match="pair of frames"):
        methods.segment(clip, "tpv", n_motions=2)


def test_robust_pca_decides_missing_and_corrupted_entries(rng):
    truth = rng.normal(size=(30, 2)) @ rng.normal(size=(2, 60))
    data = truth.copy()
    data[rng.random(data.shape) < 0.05] += 20
    data[rng.random(data.shape) < 0.1] = np.nan
    split = robust_pca(data)
    assert split.convergence.converged
    # A column with few sound entries may stay undecided.
    assert np.quantile(np.abs(split.low_rank - truth).max(axis=0), 0.95) < 1e-3


def test_completion_by_robust_pca_repairs_gross_errors(make_scene, rng):
    clip = make_scene(np.random.default_rng(6), (60,), n_frames=30)
    truth = clip.dense.xy
    jumps = 40 * (rng.random(truth.shape) < 0.02)
    visible = rng.random(truth.shape[:2]) > 0.05
    xy = np.where(visible[..., None], truth + jumps, np.nan)
    data = complete_data(replace(clip, dense=Trajectories(xy, visible, image_size=(640, 480))), "rpca")
    assert data.report["completion_converged"]
    assert np.quantile(np.abs(data.pixels - trajectory_matrix(truth)), 0.98) < 0.5


def test_tlinkage_does_not_prefer_a_threshold_that_groups_nothing(make_scene):
    clip = make_scene(np.random.default_rng(4), (30, 30), noise=6.0)
    assert (methods.segment(clip, "tlinkage", n_motions=2).labels > 0).all()


def test_no_label_0_where_all_clusters_are_too_small(make_scene):
    clip = make_scene(np.random.default_rng(0), (9, 7), noise=0.2)
    labels = methods.segment(clip, "tlinkage", n_motions=2, epsilon=1e-9, choose_epsilon=False).labels
    assert set(labels.tolist()) == {1, 2}
