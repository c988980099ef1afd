from __future__ import annotations

import numpy as np
import pytest

from kt3dmoseg.annotate import (
    AnnotatedObject,
    Annotation,
    KeyFrame,
    Mark,
    geometry,
    label_tracks,
    label_tracks_detailed,
)
from kt3dmoseg.annotate.geometry import signed_distance
from kt3dmoseg.types import Trajectories

FRAMES = 6
DRIFT = np.array([3.0, 0.0])  # of the object, pixels per frame; the background is still


def square(frame: int) -> list[tuple[float, float]]:
    left = 40 + DRIFT[0] * frame
    return [(left, 40), (left + 40, 40), (left + 40, 80), (left, 80)]


def annotation() -> Annotation:
    keys = tuple(KeyFrame(f, polygons=(square(f),)) for f in range(FRAMES))
    return Annotation("c", (160, 120), FRAMES, (AnnotatedObject(1, "box", "car", 1, keys),))


def tracks(starts: np.ndarray, moving: np.ndarray) -> Trajectories:
    steps = np.arange(FRAMES)[None, :, None] * DRIFT
    xy = starts[:, None] + np.where(moving[:, None, None], steps, 0.0)
    return Trajectories(xy, np.ones(xy.shape[:2], bool), image_size=(160, 120))


@pytest.fixture
def scene():
    """A grid of clear trajectories, then two just above the outline: one rides along, one does not."""
    inside = np.array([(x, y) for x in range(46, 78, 6) for y in range(46, 78, 6)], float)
    outside = np.array([(x, y) for x in range(10, 150, 10) for y in (10, 20, 100, 110)], float)
    pair = np.array([(60.0, 36.0), (62.0, 36.0)])
    starts = np.concatenate([inside, outside, pair])
    moving = np.concatenate([np.ones(len(inside), bool), np.zeros(len(outside), bool), [True, False]])
    return tracks(starts, moving), moving


def test_motion_decides_along_the_outline(scene):
    trajectories, moving = scene
    labels = label_tracks(trajectories, annotation())
    assert labels.label.tolist() == np.where(moving, 2, 1).tolist()


def test_far_outside_nothing_is_decided_by_motion(scene):
    trajectories, moving = scene
    starts = trajectories.xy[:, 0].copy()
    starts[-2] = (60.0, 28.0)
    labels = label_tracks(tracks(starts, moving), annotation())
    assert labels.label[-2] == 1


def test_where_motions_agree_the_outline_decides(scene):
    trajectories, moving = scene
    still = tracks(trajectories.xy[:, 0], np.zeros(len(moving), bool))
    keys = (KeyFrame(0, polygons=(square(0),)),)
    parked = Annotation("c", (160, 120), FRAMES, (AnnotatedObject(1, "box", "car", 1, keys),))
    assert label_tracks(still, parked).label[-2:].tolist() == [1, 1]


def test_a_mark_overrules_the_motion(scene):
    trajectories, _ = scene
    base = annotation()
    lasso = Mark(frame=0, polygon=((58, 34), (61, 34), (61, 38), (58, 38)), motion=0)
    marked = Annotation(base.clip, base.image_size, base.n_frames, base.objects, (lasso,))
    assert label_tracks_detailed(trajectories, marked).labels.label[-2] == 1


def test_distances_to_an_outline_of_many_corners_are_those_to_its_nearest_edge():
    rng = np.random.default_rng(0)
    angle = np.sort(rng.uniform(0, 2 * np.pi, 300))
    ring = (60 + 40 * np.stack([np.cos(angle), np.sin(angle)], axis=1)) * rng.uniform(0.9, 1.1, (300, 1))
    points = rng.uniform(0, 120, (500, 2))
    found = signed_distance(points, [ring], reach=8.0)
    dense = geometry.resample(ring, 200_000)
    near = np.flatnonzero(np.isfinite(found))
    apart = [np.hypot(*(dense - point).T).min() for point in points[near]]
    assert np.allclose(np.abs(found[near]), apart, atol=0.02)
    assert 50 < len(near) < 500
