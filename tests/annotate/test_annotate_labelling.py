"""label_tracks: votes, margins, conflicts, front regions, marks, tracker independence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kt3dmoseg.annotate import (
    AnnotatedObject,
    Annotation,
    KeyFrame,
    Mark,
    label_tracks,
    label_tracks_detailed,
)
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import Trajectories

FRAMES = 6


def box(x, y, w=20, h=20):
    return ((x, y), (x + w, y), (x + w, y + h), (x, y + h))


def thing(polygon=None, motion=1, id=1, keys=None):
    keys = keys or (KeyFrame(0, polygons=(polygon or box(40, 40),)),)
    return AnnotatedObject(id, f"thing {id}", "car", motion, tuple(keys))


def annotation(*objects, marks=()):
    return Annotation("clip", (200, 100), FRAMES, objects, marks)


def straight(starts, step=(0.0, 0.0)):
    starts = np.asarray(starts, dtype=float)
    xy = starts[:, None] + np.arange(FRAMES)[None, :, None] * np.asarray(step)
    return Trajectories(xy, np.ones(xy.shape[:2], bool))


def test_inside_gets_the_motion_plus_one_and_outside_the_background():
    labels = label_tracks(straight([(50, 50), (120, 50)]), annotation(thing(motion=2)))
    assert labels.label.tolist() == [3, 1]
    assert labels.background == 1
    assert labels.names[3] == "thing 1"


def test_region_follows_the_trajectories_inside_it():
    grid = [(42 + 4 * i, 42 + 4 * j) for i in range(5) for j in range(5)]
    moving = straight(grid, (9, 1))
    still = straight([(150, 20), (20, 60), (41, 80)])
    xy = np.concatenate([moving.xy, still.xy])
    labels = label_tracks(Trajectories(xy, np.isfinite(xy[..., 0])), annotation(thing()))
    assert labels.label.tolist() == [2] * 25 + [1] * 3


def test_labels_do_not_depend_on_the_order_of_the_trajectories():
    rng = np.random.default_rng(1)
    tracks = straight(rng.uniform((0, 0), (200, 100), (300, 2)), (2, 0))
    order = rng.permutation(300)
    drawn = annotation(thing(), thing(box(100, 10), 2, 2))
    assert (label_tracks(tracks, drawn).label[order] == label_tracks(tracks.select(order), drawn).label).all()


@pytest.mark.parametrize(("depth", "weight"), [(1.0, 0.5), (2.0, 1.0), (-1.0, 0.5), (-5.0, 1.0)])
def test_votes_weigh_by_their_distance_to_the_boundary(depth, weight):
    result = label_tracks_detailed(straight([(40 + depth, 50)]), annotation(thing()))
    column = 1 if depth > 0 else 0
    assert result.votes[0, column] == pytest.approx(weight * FRAMES)


def test_a_trajectory_that_changes_sides_is_a_conflict():
    crossing = straight([(30, 50)], (8, 0))
    result = label_tracks_detailed(crossing, annotation(thing()))
    assert result.labels.label.tolist() == [0]
    assert result.rows("conflict").tolist() == [0]
    assert result.counts()["conflict"] == 1


def test_too_little_evidence_is_listed_as_short():
    tracks = straight([(40.2, 50)])
    visible = np.zeros((1, FRAMES), bool)
    visible[0, :2] = True
    short = Trajectories(np.where(visible[..., None], tracks.xy, np.nan), visible)
    assert label_tracks_detailed(short, annotation(thing())).rows("short").tolist() == [0]


def test_a_trajectory_that_is_never_visible_is_unseen():
    never = Trajectories(np.full((1, FRAMES, 2), np.nan), np.zeros((1, FRAMES), bool))
    assert label_tracks_detailed(never, annotation(thing())).rows("unseen").tolist() == [0]


def test_two_motions_over_one_place_cast_no_vote_and_are_a_conflict():
    drawn = annotation(thing(), thing(motion=2, id=2))
    result = label_tracks_detailed(straight([(50, 50)]), drawn)
    assert result.votes[0].tolist() == [0, 0, 0, 0]
    assert result.rows("conflict").tolist() == [0]


def test_two_objects_of_one_motion_may_overlap():
    assert label_tracks(straight([(50, 50)]), annotation(thing(), thing(id=2))).label.tolist() == [2]


def test_static_region_lies_in_front_of_a_moving_one():
    drawn = annotation(thing(), thing(box(45, 40, 10), 0, 2))
    assert label_tracks(straight([(50, 50), (57.5, 50)]), drawn).label.tolist() == [1, 2]


def test_rejected_region_lies_in_front_of_everything():
    drawn = annotation(thing(), thing(box(45, 40, 10), "reject", 2))
    result = label_tracks_detailed(straight([(50, 50)]), drawn)
    assert result.labels.label.tolist() == [0]
    assert result.rows("rejected").tolist() == [0]


def test_object_enters_and_leaves():
    keys = [KeyFrame(1, "outside"), KeyFrame(2, polygons=(box(40, 40),)), KeyFrame(4, "outside")]
    drawn = annotation(thing(keys=keys))
    tracks = straight([(50, 50)])
    assert label_tracks_detailed(tracks, drawn).votes[0].tolist() == [4, 2, 0]


def test_occluded_frames_cast_no_vote_inside_the_hidden_region():
    keys = [KeyFrame(0, polygons=(box(40, 40),)), KeyFrame(3, "occluded", (box(40, 40),))]
    result = label_tracks_detailed(straight([(50, 50)]), annotation(thing(keys=keys)))
    assert result.votes[0].tolist() == [0, 3, 0]


def test_marks_overrule_regions_and_later_marks_earlier_ones():
    tracks = straight([(50, 50), (120, 50), (160, 50)])
    marks = (Mark(0, 0, box(45, 45, 10, 10)), Mark(2, 4, box(115, 45)), Mark(2, "reject", box(155, 40)))
    labels = label_tracks(tracks, annotation(thing(), marks=marks))
    assert labels.label.tolist() == [1, 5, 0]
    later = (*marks, Mark(0, 4, box(0, 0, 200, 100)))
    assert label_tracks(tracks, annotation(thing(), marks=later)).label.tolist() == [5, 5, 5]


def test_no_objects_means_all_background():
    assert label_tracks(straight([(50, 50)]), annotation()).label.tolist() == [1]


def test_wrong_clip_is_refused():
    with pytest.raises(InvalidValueError, match="7 frames"):
        label_tracks(straight([(1, 1)]), replace(annotation(), n_frames=7))
    other = Trajectories(np.zeros((1, FRAMES, 2)), np.ones((1, FRAMES), bool), image_size=(10, 10))
    with pytest.raises(InvalidValueError, match="image size"):
        label_tracks(other, annotation())
