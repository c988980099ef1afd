"""Regions between key frames follow the image motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kt3dmoseg.annotate import AnnotatedObject, Annotation, KeyFrame, TrackMotion, propagate
from kt3dmoseg.annotate.geometry import area, blend, resample, signed_distance
from kt3dmoseg.annotate.propagation import Region, apply, fit_similarities, weak_frames
from kt3dmoseg.types import Trajectories

FRAMES = 9
SQUARE = np.array([(40.0, 40.0), (60.0, 40.0), (60.0, 60.0), (40.0, 60.0)])


def path(frame):
    """Out and back: no straight line between the ends has anything to do with it."""
    return np.array([30 * np.sin(np.pi * frame / (FRAMES - 1)), 2.0 * frame])


def tracks(n=80):
    rng = np.random.default_rng(0)
    start = rng.uniform((41, 41), (59, 59), (n, 1, 2))
    xy = start + np.array([path(f) for f in range(FRAMES)])[None]
    still = rng.uniform((0, 0), (150, 120), (200, 1, 2)) + np.zeros((1, FRAMES, 1))
    xy = np.concatenate([xy, still])
    return Trajectories(xy, np.ones(xy.shape[:2], bool))


def annotation(*keys):
    return Annotation("c", (150, 120), FRAMES, (AnnotatedObject(1, "a", "car", 1, keys),))


def at(frame):
    return tuple(map(tuple, SQUARE + path(frame)))


def test_between_key_frames_the_region_follows_the_motion_not_a_line():
    drawn = annotation(KeyFrame(0, polygons=(at(0),)), KeyFrame(FRAMES - 1, polygons=(at(FRAMES - 1),)))
    regions = propagate(drawn, TrackMotion(tracks()))[1]
    for frame in range(FRAMES):
        assert np.abs(regions[frame].polygons[0] - SQUARE - path(frame)).max() < 1.0
    line = propagate(drawn)[1][4].polygons[0]
    assert np.abs(line - SQUARE - path(4)).max() > 20


def doubts(trajectories, *keys):
    motion = TrackMotion(trajectories)
    return weak_frames(propagate(annotation(*keys), motion)[1], motion)


def test_a_region_that_follows_its_trajectories_is_not_in_doubt():
    assert doubts(tracks(), KeyFrame(4, polygons=(at(4),))) == [""] * FRAMES


def test_frames_with_few_trajectories_are_in_doubt():
    few = doubts(tracks(5).select(np.arange(5)), KeyFrame(4, polygons=(at(4),)))
    assert few == ["follows 5 trajectories"] * 4 + [""] + ["follows 5 trajectories"] * 4


def test_frames_where_something_else_moves_through_are_in_doubt():
    both = tracks(80)
    xy = both.xy.copy()
    xy[40:80, 5:] += np.arange(1, 5)[:, None] * (0.0, 9.0)
    found = doubts(Trajectories(xy, both.visible), KeyFrame(0, polygons=(at(0),)))
    assert found[1:5] == [""] * 4
    assert "of" in found[5]
    assert "move otherwise" in found[5]


def test_noisy_trajectories_and_a_jump_of_the_area_are_in_doubt():
    shaken = tracks()
    noise = np.random.default_rng(1).normal(0, 1.5, shaken.xy.shape)
    found = doubts(Trajectories(shaken.xy + noise, shaken.visible), KeyFrame(0, polygons=(at(0),)))
    assert all("px" in why or "otherwise" in why for why in found[1:])
    big = tuple((2 * x - 50.0, 2 * y - 50.0) for x, y in at(0))
    grown = [Region("visible", (np.array(at(0)),), key=True), Region("visible", (np.array(big),))]
    assert weak_frames(grown, TrackMotion(tracks())) == ["", "area changes by 300%"]


def test_what_a_person_drew_or_nobody_sees_is_not_in_doubt():
    keys = [KeyFrame(0, polygons=(at(0),)), KeyFrame(1, "occluded", (at(1),)), KeyFrame(5, "outside")]
    assert doubts(tracks(4), *keys) == [""] * FRAMES


def test_before_the_first_and_after_the_last_key_frame():
    regions = propagate(annotation(KeyFrame(4, polygons=(at(4),))), TrackMotion(tracks()))[1]
    for frame in (0, 8):
        assert np.abs(regions[frame].polygons[0] - SQUARE - path(frame)).max() < 2.0


def test_key_frames_are_exact_whatever_moves():
    odd = ((1.5, 2.25), (30.125, 3.0), (7.0, 50.0))
    drawn = annotation(KeyFrame(0, polygons=(at(0),)), KeyFrame(5, polygons=(odd, at(1))))
    regions = propagate(drawn, TrackMotion(tracks()))[1]
    assert regions[5].key
    assert [tuple(map(tuple, p)) for p in regions[5].polygons] == [odd, at(1)]


def test_too_few_trajectories_fall_back_to_the_line():
    few = tracks(2).select(np.arange(2))
    drawn = annotation(KeyFrame(0, polygons=(at(0),)), KeyFrame(4, polygons=(at(4),)))
    middle = propagate(drawn, TrackMotion(few))[1][2].polygons[0]
    assert np.allclose(middle, SQUARE + (path(0) + path(4)) / 2)


def test_static_and_rejected_objects_without_trajectories_follow_those_around():
    ring = tracks()
    away = np.abs(ring.xy[:, 0] - 50).max(axis=1)
    ring = ring.select(np.flatnonzero((away > 3) & (away < 9)))  # of those that move, and none inside
    (drawn,) = annotation(KeyFrame(0, polygons=(((48, 48), (52, 48), (52, 52), (48, 52)),))).objects
    ends = {}
    for motion in (0, "reject", 1):
        item = Annotation("c", (150, 120), FRAMES, (replace(drawn, motion=motion),))
        ends[motion] = propagate(item, TrackMotion(ring))[1][4].polygons[0].mean(axis=0) - 50
    assert np.abs(ends[0] - path(4)).max() < 1.0
    assert np.allclose(ends[0], ends["reject"])
    assert np.allclose(ends[1], 0)


def test_visibility_holds_until_the_next_key_frame():
    drawn = annotation(
        KeyFrame(1, "outside"),
        KeyFrame(2, polygons=(at(2),)),
        KeyFrame(5, "occluded"),
        KeyFrame(7, "outside"),
    )
    regions = propagate(drawn)[1]
    shown = [region.visibility for region in regions]
    assert shown == ["outside"] * 2 + ["visible"] * 3 + ["occluded"] * 2 + ["outside"] * 2
    assert [len(region.polygons) for region in regions] == [0, 0, 1, 1, 1, 0, 0, 0, 0]


def test_fit_ignores_a_minority_that_moves_otherwise():
    rng = np.random.default_rng(3)
    x1 = rng.uniform(0, 50, (60, 2))
    model = np.array([[1.02, -0.03, 4.0], [0.03, 1.02, -2.0]])
    x2 = apply(model, x1) + rng.normal(0, 0.05, x1.shape)
    x2[:20] += (15, 3)
    (found,), _ = fit_similarities(x1[None], x2[None], np.ones((1, 60), bool))
    assert np.abs(apply(found, x1) - apply(model, x1)).max() < 0.15


def test_fit_needs_four():
    known = np.array([[True] * 3 + [False], [True] * 4])
    models, ok = fit_similarities(np.zeros((2, 4, 2)), np.ones((2, 4, 2)), known)
    assert ok.tolist() == [False, True]
    assert np.allclose(models[1], [[1, 0, 1], [0, 1, 1]])


def test_outlines_drawn_again_are_blended_by_shape():
    finer = np.roll(resample(SQUARE, 12), 5, axis=0)[::-1] + np.array([10.0, 0.0])
    half = blend([SQUARE], [finer], 0.5)[0]
    assert abs(area(half)) == pytest.approx(400, rel=0.05)
    assert np.allclose(half.mean(axis=0), (55, 50), atol=0.5)
    assert np.allclose(blend([SQUARE], [finer], 0.0)[0].mean(axis=0), (50, 50))


def test_signed_distance_by_hand():
    points = np.array([(50.0, 50.0), (42.0, 50.0), (35.0, 50.0), (63.0, 64.0)])
    assert signed_distance(points, [SQUARE]).tolist() == [10, 2, -5, -5]
    assert np.isneginf(signed_distance(points, [])).all()


def test_inside_is_even_odd():
    star = np.array(
        [(0, 0), (10, 0), (10, 10), (0, 10), (0, 0), (3, 3), (7, 3), (7, 7), (3, 7), (3, 3)], float
    )
    depth = signed_distance(np.array([(1.0, 1.0), (5.0, 5.0), (11.0, 5.0)]), [star], reach=0.0)
    assert (depth >= 0).tolist() == [True, False, False]
