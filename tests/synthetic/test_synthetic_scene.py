"""What a scene reports about itself must agree with what it shows."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation, map_coordinates

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.synthetic import SceneOptions, make_scene


def warped(scene, i, j):
    """Frame j carried back to frame i by the exact flow, and where that is valid."""
    flow, valid = scene.flow(i, j)
    y, x = np.mgrid[: flow.shape[0], : flow.shape[1]]
    at = [y + flow[..., 1], x + flow[..., 0]]
    return map_coordinates(scene.frame(j).astype(float), at, order=3, mode="nearest"), valid


@pytest.mark.parametrize(("i", "j"), [(3, 4), (4, 3), (0, 2)])
def test_flow_carries_one_frame_onto_the_other(scene, i, j):
    back, valid = warped(scene, i, j)
    error = np.abs(back - scene.frame(i))
    unmoved = np.abs(scene.frame(j).astype(float) - scene.frame(i))
    assert valid.mean() > 0.6
    # Two frames' noise alone gives 0.67 * sqrt(2) * 1.5 = 1.4; resampling and thin details the rest.
    assert np.median(error[valid]) < 2.6
    assert np.median(unmoved[valid]) > 2 * np.median(error[valid])
    for body in np.unique(scene.ids(i)):
        where = valid & (scene.ids(i) == body)
        if where.sum() > 100:
            assert np.median(error[where]) < 6


def test_noise_free_warp_is_nearly_perfect_on_smooth_parts():
    scene = make_scene(SceneOptions(width=200, height=64, frames=2, objects=2, noise=0.0, samples=4))
    back, valid = warped(scene, 0, 1)
    image = scene.frame(0).astype(float)
    smooth = np.hypot(*np.gradient(image)) < 6
    assert np.percentile(np.abs(back - image)[valid & smooth], 90) < 3


def test_flow_there_and_back_is_zero_where_both_are_valid(scene):
    there, seen = scene.flow(2, 5)
    back, _ = scene.flow(5, 2)
    y, x = np.mgrid[: there.shape[0], : there.shape[1]]
    at = [y + there[..., 1], x + there[..., 0]]
    returned = np.stack([map_coordinates(back[..., k], at, order=1, mode="nearest") for k in (0, 1)], axis=2)
    ids = map_coordinates(scene.ids(5), at, order=0, mode="nearest")
    # Bilinear sampling of the backward flow mixes surfaces at depth edges: look inside them.
    inner = seen & (ids == scene.ids(2))
    error = np.linalg.norm(there + returned, axis=2)[inner]
    assert np.median(error) < 0.01
    assert np.percentile(error, 90) < 0.2


def test_flow_to_itself_is_zero_and_everywhere_valid(scene):
    flow, valid = scene.flow(1, 1)
    assert np.abs(flow).max() < 1e-4
    assert valid.all()


def test_trajectories_agree_with_flow(scene):
    width, height = scene.image_size
    x, y = np.meshgrid(np.arange(3, width, 11), np.arange(2, height, 7))
    seeds = np.stack([x.ravel(), y.ravel(), np.full(x.size, 2)], axis=1)
    tracks = scene.trajectories(seeds)
    assert np.allclose(tracks.xy[:, 2], seeds[:, :2], atol=1e-9)
    assert tracks.visible[:, 2].all()
    for j in (0, 1, 3, 6):
        flow, valid = scene.flow(2, j)
        assert np.array_equal(tracks.visible[:, j], valid[y.ravel(), x.ravel()])
        moved = seeds[:, :2] + flow[y.ravel(), x.ravel()]
        seen = tracks.visible[:, j]
        assert np.abs(tracks.xy[seen, j] - moved[seen]).max() < 1e-3


def test_trajectories_stay_on_their_object(scene):
    rng = np.random.default_rng(5)
    width, height = scene.image_size
    seeds = np.column_stack(
        [rng.uniform(0, width - 1, 600), rng.uniform(0, height - 1, 600), rng.integers(0, 8, 600)]
    )
    tracks, labels = scene.trajectories(seeds), scene.labels(seeds)
    assert set(labels.motions) == {1, 2, 3, 4, 5}
    for j in range(scene.n_frames):
        ids = np.maximum(scene.ids(j), 1)  # the sky is background
        # Within half a pixel of an object's edge the pixel centre may be on the other side.
        flat = ~np.any(
            [binary_dilation(ids == k) & binary_dilation(ids != k) for k in np.unique(ids)], axis=0
        )
        seen = np.flatnonzero(tracks.visible[:, j])
        column, row = np.rint(tracks.xy[seen, j]).astype(int).T
        inner = flat[row, column]
        assert inner.mean() > 0.8
        assert np.array_equal(ids[row, column][inner], labels.label[seen][inner])


def test_hidden_points_are_behind_what_is_seen(scene):
    flow, valid = scene.flow(1, 6)
    y, x = np.mgrid[: flow.shape[0], : flow.shape[1]]
    target = np.stack([x, y], axis=2) + flow
    width, height = scene.image_size
    column, row = np.rint(target[..., 0]).astype(int), np.rint(target[..., 1]).astype(int)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    hidden = inside & ~valid & (flow != 0).any(axis=2)
    assert hidden.sum() > 100
    before, after = scene.ids(1)[hidden], scene.ids(6)[row[hidden], column[hidden]]
    assert (before != after).mean() > 0.2  # hidden by another object, not only by themselves


def test_ids_and_depth(scene):
    ids, depth = scene.ids(4), scene.depth(4)
    assert set(np.unique(ids)) == {0, 1, 2, 3, 4, 5}
    assert np.array_equal(np.isinf(depth), ids == 0)
    assert depth.min() > 0.5
    for body in range(2, 6):
        assert 4 < np.median(depth[ids == body]) < 60


def test_same_options_same_bytes_in_any_order(scene):
    again = make_scene(scene.options)
    frames = [again.frame(i) for i in (5, 0)]
    assert np.array_equal(frames[1], scene.frame(0))
    assert np.array_equal(frames[0], scene.frame(5))
    other = make_scene(SceneOptions(width=310, height=94, frames=8, objects=4, seed=4))
    assert not np.array_equal(other.frame(0), scene.frame(0))


def test_frames_are_like_photographs_of_a_street(scene):
    image = scene.frame(0)
    assert image.dtype == np.uint8
    assert image.shape == (94, 310)
    assert 60 < image.mean() < 150
    assert 35 < image.std() < 75


def test_points_that_make_no_sense_are_refused(scene):
    with pytest.raises(InvalidValueError, match="shape"):
        scene.trajectories([[1.0, 2.0]])
    with pytest.raises(InvalidValueError, match="frame"):
        scene.labels([[1.0, 2.0, 8.0]])
    with pytest.raises(InvalidValueError, match="frame"):
        scene.frame(-1)
    with pytest.raises(InvalidValueError):
        scene.trajectories([[np.nan, 2.0, 0.0]])
    assert len(scene.trajectories([])) == 0


@pytest.mark.parametrize("wrong", [{"width": 10}, {"objects": 5}, {"frames": 0}, {"seed": -1}])
def test_options_out_of_bounds_are_refused(wrong):
    with pytest.raises(InvalidValueError):
        SceneOptions(**wrong)


@settings(max_examples=12, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    objects=st.integers(0, 4),
    speed=st.floats(0, 20),
    turn=st.floats(-20, 20),
    frames=st.integers(2, 24),
)
def test_every_scene_is_consistent(seed, objects, speed, turn, frames):
    options = SceneOptions(
        width=96, height=48, frames=frames, objects=objects, seed=seed, speed=speed, turn=turn
    )
    scene = make_scene(options)
    middle = frames // 2
    ids = scene.ids(middle)
    assert ids.max() <= 1 + objects
    x, y = np.meshgrid(np.arange(2, 96, 9), np.arange(1, 48, 6))
    seeds = np.stack([x.ravel(), y.ravel(), np.full(x.size, middle)], axis=1)
    labels, tracks = scene.labels(seeds), scene.trajectories(seeds)
    assert np.array_equal(labels.label, np.maximum(ids[y.ravel(), x.ravel()], 1))
    assert tracks.visible[:, middle].all()
    # A track that is seen in two frames starts again from the second and arrives at the first.
    last = np.flatnonzero(tracks.visible[:, -1])
    again = scene.trajectories(np.column_stack([tracks.xy[last, -1], np.full(len(last), frames - 1)]))
    back = np.linalg.norm(again.xy[:, middle] - seeds[last, :2], axis=1)
    close = np.nan_to_num(back, nan=np.inf) < 1e-3
    assert close.mean() > 0.99 if len(last) else True


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_all_vehicles_are_in_view_and_do_not_collide(seed):
    scene = make_scene(SceneOptions(width=310, height=94, frames=20, objects=4, seed=seed))
    assert set(np.unique(scene.ids(10))) >= {1, 2, 3, 4, 5}
    for frame in (0, 5, 10, 15, 19):
        boxes = [_footprint(scene, k, frame) for k in range(4)]
        for k in range(4):
            for other in range(k):
                assert not _overlap(boxes[k], boxes[other]), (frame, k, other)


def _footprint(scene, k, frame):
    width, _, length = scene.vehicles[k].size
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (width / 2, length / 2)
    pose = scene.vehicles[k].drive.pose(scene.time(frame))
    return corners @ pose[np.ix_((0, 2), (0, 2))].T + pose[(0, 2), 3]


def _overlap(a, b):
    """Separating axis test of two convex quadrilaterals."""
    for shape in (a, b):
        for edge in np.diff(shape, axis=0, append=shape[:1]):
            axis = np.array([-edge[1], edge[0]])
            if (a @ axis).max() < (b @ axis).min() or (b @ axis).max() < (a @ axis).min():
                return False
    return True
