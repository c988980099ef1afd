"""What every method that needs complete trajectories promises."""

from dataclasses import replace

import numpy as np
import pytest

import mseg.methods as methods
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import Camera, Clip, Trajectories
from mseg.errors import IncompleteTrajectoriesError, SegmentationError, TooFewPointsError
from mseg.geometry.subspaces import (
    leading_row_space,
    normalised,
    normalising_matrix,
    project,
    trajectory_matrix,
)
from mseg.methods.complete_data import complete_data
from mseg.methods.subspaces import exponents, gradients, vanishing_polynomial
from mseg.types import Segmentation

SUBSPACE = ["lsa", "gpca", "ssc", "lrr", "s3c", "rsim", "lrssc", "ransac"]
LINKED = ["alc", "tlinkage", "rpa"]
# A coarser grid: a quarter of the time.
QUICK = {"alc": {"distortions": 25}}
COUNTING = ["ssc", "lrr", "s3c", "rsim", "lrssc"]


def agree(labels, truth):
    return np.array_equal(labels[:, None] == labels, truth[:, None] == truth)


def with_xy(clip, xy, visible=None):
    visible = np.isfinite(xy).all(axis=2) if visible is None else visible
    return replace(clip, dense=Trajectories(xy, visible, image_size=clip.dense.image_size))


@pytest.mark.parametrize("name", SUBSPACE)
@pytest.mark.parametrize("sizes", [(30, 24), (30, 24, 36)])
def test_affine_motions_are_separated(make_scene, name, sizes):
    clip = make_scene(np.random.default_rng(1), sizes, n_frames=15, noise=0.02)
    result = methods.segment(clip, name, n_motions=len(sizes))
    errors = (result.labels[:, None] == result.labels) != (clip.labels.label[:, None] == clip.labels.label)
    # GPCA and RANSAC are not exact for three motions even on nearly clean data.
    assert errors.mean() <= (0.35 if name in {"gpca", "ransac"} and len(sizes) == 3 else 0.0)
    assert result.report.get("converged", True)


@pytest.mark.parametrize("name", SUBSPACE + LINKED)
def test_gaps_are_completed_and_reported(make_scene, name):
    clip = make_scene(np.random.default_rng(2), (30, 25), n_frames=12, missing=0.3)
    result = methods.segment(clip, name, n_motions=2, completion_rank=8, **QUICK.get(name, {}))
    assert agree(result.labels, clip.labels.label)
    assert result.report["completion_converged"]
    assert result.report["completion_rms_pixels"] < 1
    with pytest.raises(IncompleteTrajectoriesError, match="missing positions"):
        methods.segment(clip, name, n_motions=2, completion="none")


@pytest.mark.parametrize("name", SUBSPACE + LINKED)
def test_trajectories_seen_once_join_the_largest_motion(make_scene, name):
    clip = make_scene(np.random.default_rng(5), (30, 20))
    xy = clip.dense.xy.copy()
    xy[45:, 1:] = np.nan
    xy[48:] = np.nan
    result = methods.segment(with_xy(clip, xy), name, n_motions=2, **QUICK.get(name, {}))
    counts = np.bincount(result.labels[:45])
    np.testing.assert_array_equal(result.labels[45:], counts.argmax())
    assert result.report["trajectories_left_out"] == 5


@pytest.mark.parametrize("name", SUBSPACE + LINKED)
def test_bad_input_is_one_clear_error(make_scene, name):
    clip = make_scene(np.random.default_rng(6), (10, 10))
    same = with_xy(clip, np.broadcast_to(clip.dense.xy[:1], clip.dense.xy.shape).copy())
    with pytest.raises(SegmentationError, match="differ"):
        methods.segment(same, name, n_motions=2)
    with pytest.raises(TooFewPointsError):
        methods.segment(clip, name, n_motions=21)
    unseen = with_xy(clip, np.full(clip.dense.xy.shape, np.nan))
    with pytest.raises(TooFewPointsError, match="at least 2 trajectories"):
        methods.segment(unseen, name, n_motions=2)
    one_frame = with_xy(clip, np.where(np.arange(12)[:, None] == 3, clip.dense.xy, np.nan))
    with pytest.raises(TooFewPointsError):
        methods.segment(one_frame, name, n_motions=2)


@pytest.mark.parametrize("name", SUBSPACE + LINKED)
def test_one_motion_is_one_group(make_scene, name):
    clip = make_scene(np.random.default_rng(8), (20,))
    assert set(methods.segment(clip, name, n_motions=1, **QUICK.get(name, {})).labels) == {1}


@pytest.mark.parametrize("name", SUBSPACE)
def test_unknown_number_of_motions(make_scene, name):
    clip = make_scene(np.random.default_rng(9), (25, 20, 30), n_frames=15)
    if name in COUNTING:
        result = methods.segment(clip, name)
        assert len(set(result.labels)) == result.report["n_motions"]
        assert result.report["n_motions"] == 3
    else:
        with pytest.raises(InvalidValueError, match="n_motions"):
            methods.segment(clip, name)


@pytest.mark.parametrize(
    ("name", "parameters"), [("ssc", {"rho": 0}), ("tpv", {"rho": 0}), ("consistent", {"share": 0})]
)
def test_an_affinity_without_ties_is_refused(make_scene, rng, name, parameters):
    with pytest.raises(SegmentationError, match="expected ties between points, found none"):
        methods.segment(make_scene(rng, (20, 20)), name, n_motions=2, **parameters)


def test_guesses_about_many_trajectories_are_noted(make_scene, rng):
    tracks = make_scene(rng, (40, 40)).dense
    xy = np.array(tracks.xy)
    xy[50:, 2:] = np.nan
    short = methods.segment(xy, "ssc", n_motions=2)
    assert "30 trajectories are too short to fill their gaps" in short.report["notes"]
    xy[50:, 1] = np.nan
    once = methods.segment(xy, "ssc", n_motions=2)
    assert "30 trajectories took no part and were put into the largest motion" in once.report["notes"]
    few = methods.segment(xy[:52], "ssc", n_motions=2).report
    assert few["trajectories_left_out"] == 2
    assert not any("largest motion" in note or "too short" in note for note in few["notes"])


@pytest.mark.parametrize("name", ["ssc", "lrr", "s3c", "lrssc", "consistent"])
def test_failure_to_converge_is_reported(make_scene, name):
    clip = make_scene(np.random.default_rng(10), (15, 15))
    report = methods.segment(clip, name, n_motions=2, max_iterations=3).report
    assert report["converged"] is False
    assert report["iterations"] == 3
    assert report["residual"] > 0


# Nothing is iterated, or to the end: greedy merging (ALC), k-means. multibody's bodies stop early by design:
# its stages have few steps each, one sweep of fusion makes atoms, and nothing that it reports says converged.
WITHOUT_CAP = {"one_motion", "prevalence", "affine", "homography", "fundamental", "keradd", "mssc"}
WITHOUT_CAP |= {"lsa", "gpca", "alc", "multibody"}


@pytest.mark.parametrize("name", methods.list())
def test_every_iteration_with_a_cap_reports_how_it_ended(make_scene, name):
    clip = make_scene(np.random.default_rng(12), (18, 18), noise=0.05)
    report = methods.segment(clip, name, n_motions=2, **QUICK.get(name, {})).report
    ends = {key: value for key, value in report.items() if key.endswith("converged")}
    assert all(isinstance(value, bool) for value in ends.values())
    assert bool(ends) == (name not in WITHOUT_CAP)


def test_lrssc_as_a_cascade(make_scene):
    clip = make_scene(np.random.default_rng(11), (20, 20))
    cascade = methods.segment(clip, "lrssc", n_motions=2, variant="cascade")
    assert agree(cascade.labels, clip.labels.label)
    assert cascade.report["low_rank_converged"]


def test_gpca_needs_enough_trajectories(make_scene):
    clip = make_scene(np.random.default_rng(12), (8, 8, 8))
    with pytest.raises(TooFewPointsError, match="at least 35"):
        methods.segment(clip, "gpca", n_motions=3)


def test_gpca_normals_of_two_lines():
    points = np.array([[1.0, 0], [2, 0], [0, 1], [0, 3]])
    powers = exponents(2, 2)
    np.testing.assert_array_equal(powers, [[2, 0], [1, 1], [0, 2]])
    polynomial = vanishing_polynomial(points, powers)
    np.testing.assert_allclose(np.abs(polynomial), [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(
        np.abs(gradients(points, powers, polynomial)), [[0, 1], [0, 2], [1, 0], [3, 0]]
    )


def test_one_motion_and_prevalence(make_scene):
    clip = make_scene(np.random.default_rng(13), (4, 3), missing=0.9)
    for name in ("one_motion", "prevalence"):
        assert set(methods.segment(clip, name).labels) == {1}


def test_normalising_rules():
    xy = np.array([[[10.0, 20.0], [30.0, 20.0]], [[20.0, 60.0], [20.0, 40.0]]])
    seen = np.ones((2, 2), dtype=bool)
    plain, sized = Trajectories(xy, seen), Trajectories(xy, seen, image_size=(640, 480))
    by_camera = normalising_matrix(sized, Camera(K=np.diag([2.0, 4.0, 1.0])))
    np.testing.assert_allclose(normalised(sized.xy, by_camera)[0], [[5, 5], [15, 5]])
    np.testing.assert_allclose(
        normalised(sized.xy, normalising_matrix(sized))[0, 0], [20 / 640 - 1, 40 / 480 - 1]
    )
    by_range = normalised(plain.xy, normalising_matrix(plain))
    np.testing.assert_allclose([by_range.min(), by_range.max()], [-1, 1])
    with pytest.raises(InvalidValueError, match="invertible"):
        normalising_matrix(plain, Camera(K=np.zeros((3, 3))))


def test_trajectory_matrix_rows_and_projection(rng):
    xy = rng.normal(size=(5, 3, 2))
    matrix = trajectory_matrix(xy)
    np.testing.assert_array_equal(matrix[:, 2], xy[2].ravel())
    np.testing.assert_allclose(project(matrix, 9).T @ project(matrix, 9), matrix.T @ matrix, atol=1e-12)
    space = leading_row_space(matrix, 2)
    np.testing.assert_allclose(space.T @ space, np.eye(2), atol=1e-12)


def test_trajectories_that_took_no_part_join_the_largest_motion():
    used = np.array([True, False, True, True, False, True])
    found = Segmentation.of_part(np.array([1, 2, 2, 0]), used, {})
    np.testing.assert_array_equal(found.labels, [1, 2, 2, 2, 2, 0])
    outliers = Segmentation.of_part(np.zeros(4, dtype=np.int64), used, {})
    np.testing.assert_array_equal(outliers.labels, 0)


def test_complete_data_leaves_out_frames_that_nobody_sees(make_scene):
    clip = make_scene(np.random.default_rng(14), (6, 6))
    xy = clip.dense.xy.copy()
    xy[:, 4] = np.nan
    assert complete_data(with_xy(clip, xy)).pixels.shape == (22, 12)


def test_segment_refuses_zero_motions(make_scene):
    clip: Clip = make_scene(np.random.default_rng(15), (6, 6))
    with pytest.raises(InvalidValueError):
        methods.segment(clip, "ssc", n_motions=0)
