"""What makes trajectories hard: each property on scenes with a known answer."""

import numpy as np
import pytest

from kt3dmoseg.types import Clip, Labels, Trajectories
from mseg.evaluation.axes import AXES, from_epipolar_lines, motion_sizes, speeds, thirds

K = np.array([[500.0, 0, 320], [0, 500, 120], [0, 0, 1]])
FRAMES = 8


def project(points):
    """Pixels (N, F, 2) of points (N, F, 3) in camera coordinates."""
    image = points @ K.T
    return image[..., :2] / image[..., 2:]


def scene(motion, *, camera=(0, 0, 0.5), turn=0.0, flat=False):
    """Sixty static points and one that moves by `motion` per frame, seen by a camera that moves and turns."""
    rng = np.random.default_rng(1)
    points = rng.uniform((-6, -2, 10), (6, 2, 40), size=(61, 3))
    if flat:
        points[:60, 1] = 1.5  # a road
    points[60] = (1.0, 0.5, 15)
    steps = np.arange(FRAMES)[:, None]
    world = np.repeat(points[:, None], FRAMES, axis=1)
    world[60] += steps * motion
    seen = world - steps * camera
    angle = np.radians(turn) * steps[:, 0]
    c, s, zero, one = np.cos(angle), np.sin(angle), 0 * angle, 1 + 0 * angle
    rotation = np.stack([np.stack(row, -1) for row in ((c, zero, -s), (zero, one, zero), (s, zero, c))], 1)
    xy = project(np.einsum("fij,nfj->nfi", rotation, seen))
    return Trajectories(xy, np.ones(xy.shape[:2], dtype=bool)), np.arange(61) < 60


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_what_moves_along_with_the_camera_stays_on_its_epipolar_line(turn):
    off = from_epipolar_lines(*scene((0, 0, 0.3), turn=turn))
    assert off[:60].max() < 1e-6  # neither do static points leave theirs, whatever the camera's turn
    assert off[60] < 1e-6


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_what_crosses_leaves_the_line_by_its_distance(turn):
    tracks, static = scene((0.02, 0.1, 0), turn=turn)
    off = from_epipolar_lines(tracks, static)
    # Without a turn the line runs from the centre of the picture through the first position.
    if not turn:
        first, second = tracks.xy[60, 0] - K[:2, 2], tracks.xy[60, 5] - K[:2, 2]
        distance = abs(first[0] * second[1] - first[1] * second[0]) / np.linalg.norm(first)
        assert from_epipolar_lines(Trajectories(tracks.xy[:, :6], tracks.visible[:, :6]), static)[60] == (
            pytest.approx(distance, rel=1e-4)
        )
    assert off[60] > 10


def test_where_the_camera_rests_or_only_turns_all_motion_counts():
    for turn in (0.0, 0.5):
        tracks, static = scene((0.1, 0, 0), camera=(0, 0, 0), turn=turn)
        off = from_epipolar_lines(tracks, static)
        assert off[:60].max() < 1e-6
        assert off[60] == pytest.approx(500 * 0.5 / 15, rel=0.1)  # five frames of 0.1, 15 away


def test_static_points_with_another_label_do_not_bend_the_lines():
    tracks, static = scene((0, 0, 0.3))
    xy = tracks.xy.copy()
    xy[:5] += np.linspace(0, 40, FRAMES)[:, None]  # five wrongly labelled
    off = from_epipolar_lines(Trajectories(xy, tracks.visible), static)
    assert off[60] < 0.1


def test_what_is_never_seen_twice_or_among_too_few_is_not_known():
    tracks, static = scene((0, 0, 0.3))
    visible = tracks.visible.copy()
    visible[60, 1:] = False
    xy = np.where(visible[..., None], tracks.xy, np.nan)
    assert np.isnan(from_epipolar_lines(Trajectories(xy, visible), static)[60])
    assert np.isnan(from_epipolar_lines(tracks, np.arange(61) < 11)).all()


def test_speed_is_the_median_step_also_over_gaps():
    xy = np.zeros((3, 5, 2))
    xy[0, :, 0] = [0, 1, 2, 3, 100]
    xy[1, :, 1] = [0, 4, 8, 0, 0]
    visible = np.ones((3, 5), dtype=bool)
    visible[1, 3:] = visible[2, 1:] = False
    tracks = Trajectories(np.where(visible[..., None], xy, np.nan), visible)
    assert speeds(tracks)[:2].tolist() == [1, 4]
    assert np.isnan(speeds(tracks)[2])


def test_position_is_the_ninth_of_the_image():
    xy = np.array([[[0, 0]], [[89, 0]], [[45, 45]], [[60, 29]], [[0, 89]], [[89.5, 89.5]]], dtype=float)
    tracks = Trajectories(xy, np.ones((6, 1), dtype=bool))
    assert thirds(tracks, (90, 90)).tolist() == [0, 2, 4, 2, 6, 8]
    nowhere = Trajectories(np.full((1, 1, 2), np.nan), np.zeros((1, 1), dtype=bool))
    assert np.isnan(thirds(nowhere, (90, 90))).all()


def test_bins_hold_every_trajectory_once():
    tracks, static = scene((0.02, 0.1, 0))
    clip = Clip("c", tracks, np.arange(61), Labels(np.where(static, 2, 1)))
    found = {axis.name: axis.bins(clip, (640, 240)) for axis in AXES}
    titles = {axis.name: axis.titles for axis in AXES}
    assert [titles["line"][k] for k in found["line"][[0, 60]]] == ["static scene", "8 and over"]
    assert [titles["size"][k] for k in found["size"][[0, 60]]] == ["50 to 100", "under 20"]
    assert [titles["length"][k] for k in found["length"][[0]]] == ["5 to 10"]
    for axis in AXES:
        assert len(axis.titles) == len(axis.bounds) + 1
        assert found[axis.name].max() <= len(axis.titles)


def test_sizes_are_of_the_labelled():
    assert motion_sizes(Labels(np.array([3, 3, 0, 1]))).tolist()[:2] == [2, 2]
