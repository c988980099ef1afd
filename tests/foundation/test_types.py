from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import kt3dmoseg
import mseg
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import Camera, Clip, Labels, Trajectories
from mseg.types import Segmentation

NAN = np.nan


def two_tracks() -> Trajectories:
    xy = np.array([[[0.0, 1.0], [2.0, 3.0], [NAN, NAN]], [[NAN, NAN], [4.0, 5.0], [6.0, 7.0]]])
    return Trajectories(xy, np.array([[1, 1, 0], [0, 1, 1]], dtype=bool), image_size=(10, 8))


def test_pair_gives_the_trajectories_seen_in_both_frames():
    rows, x1, x2 = two_tracks().pair(1, 2)
    assert rows.tolist() == [1]
    assert x1.tolist() == [[4.0, 5.0]]
    assert x2.tolist() == [[6.0, 7.0]]
    assert two_tracks().pair(0, 2)[0].size == 0


def test_select_keeps_identity_and_image_size():
    chosen = two_tracks().select([1])
    assert chosen.track_id.tolist() == [1]
    assert chosen.image_size == (10, 8)
    assert two_tracks().select(np.array([True, False])).track_id.tolist() == [0]


def test_arrays_are_read_only_and_independent_of_the_callers():
    xy = np.zeros((1, 2, 2))
    trajectories = Trajectories(xy, np.ones((1, 2), dtype=bool))
    xy[:] = 5
    assert trajectories.xy.max() == 0
    with pytest.raises(ValueError, match="read-only"):
        trajectories.xy[0, 0, 0] = 1


@pytest.mark.parametrize(
    ("xy", "visible", "message"),
    [
        (np.zeros((1, 2, 3)), np.ones((1, 2), bool), "xy: expected shape"),
        (np.zeros((1, 2, 2)), np.ones((1, 3), bool), "visible: expected shape"),
        (np.full((1, 2, 2), NAN), np.ones((1, 2), bool), "xy of trajectory 0 in frame 0: expected finite"),
        (np.full((1, 2, 2), np.inf), np.ones((1, 2), bool), "expected finite"),
        (np.zeros((1, 2, 2)), np.zeros((1, 2), bool), "expected NaN"),
    ],
)
def test_inconsistent_trajectories_are_refused(xy, visible, message):
    with pytest.raises(InvalidValueError, match=message):
        Trajectories(xy, visible)


@pytest.mark.parametrize("size", [(0, 4), (4, -1), (4,), 4, (2.5, 4), (np.inf, 4), ("4", "4"), (1 << 40, 4)])
def test_an_image_size_that_is_none_is_refused(size):
    with pytest.raises(InvalidValueError, match="image_size"):
        Trajectories(np.zeros((1, 2, 2)), np.ones((1, 2), bool), image_size=size)


def test_numbers_that_would_wrap_around_are_refused():
    beyond = np.array([1 << 63], dtype=np.uint64)
    with pytest.raises(InvalidValueError, match="at most 9223372036854775807"):
        Labels(beyond)
    with pytest.raises(InvalidValueError, match="at most 9223372036854775807"):
        Labels(np.array([1]), background=beyond[0])


def test_repeated_track_ids_are_refused():
    with pytest.raises(InvalidValueError, match="unique ids"):
        Trajectories(np.zeros((2, 1, 2)), np.ones((2, 1), bool), np.array([3, 3]))


@pytest.mark.parametrize("label", [[-1], [0.5], [[1]], ["car"]])
def test_bad_labels_are_refused(label):
    with pytest.raises(InvalidValueError, match="label"):
        Labels(np.array(label))


@given(st.lists(st.integers(0, 6), max_size=30))
def test_motions_are_the_distinct_positive_labels(values):
    labels = Labels(np.array(values, dtype=int))
    assert labels.motions.tolist() == sorted(set(values) - {0})
    assert labels.n_motions == len(set(values) - {0})


def test_clip_checks_what_it_joins():
    dense = two_tracks()
    with pytest.raises(InvalidValueError, match="labels: expected 1"):
        Clip("c", dense, np.array([0]), Labels(np.array([1, 2])))
    with pytest.raises(InvalidValueError, match="evaluated"):
        Clip("c", dense, np.array([2]), Labels(np.array([1])))
    with pytest.raises(InvalidValueError, match="unique rows"):
        Clip("c", dense, np.array([0, 0]), Labels(np.array([1, 1])))
    with pytest.raises(InvalidValueError, match="frame_numbers"):
        Clip("c", dense, np.array([0]), Labels(np.array([1])), frame_numbers=np.array([1]))
    with pytest.raises(InvalidValueError, match="frame_numbers: expected each number once"):
        Clip("c", dense, np.array([0]), Labels(np.array([1])), frame_numbers=np.array([1, 2, 1]))
    with pytest.raises(InvalidValueError, match="camera"):
        Camera("image_00", np.eye(2))


def test_what_numpy_would_turn_into_something_else_is_refused():
    xy, seen = np.zeros((1, 2, 2)), np.ones((1, 2), bool)
    with pytest.raises(InvalidValueError, match=r"no masked values, .* NaN"):
        Trajectories(np.ma.masked_array(xy, xy == 0), seen)
    with pytest.raises(InvalidValueError, match="True or False, found float64"):
        Trajectories(xy, seen * 0.3)
    with pytest.raises(InvalidValueError, match="whole numbers, found bool"):
        Clip("c", Trajectories(xy, seen), np.array([False]), Labels(np.array([1])))


def test_clip_survives_pickling_between_processes():
    clip = Clip("c", two_tracks(), np.array([1]), Labels(np.array([2]), 1, {2: "car"}), provenance={"a": 1})
    copy = pickle.loads(pickle.dumps(clip))
    assert copy.labels.names == {2: "car"}
    assert copy.provenance == {"a": 1}
    assert np.array_equal(copy.dense.xy, clip.dense.xy, equal_nan=True)
    assert not copy.dense.xy.flags.writeable


def test_without_labels_hides_the_truth_only():
    clip = Clip("c", two_tracks(), np.array([1, 0]), Labels(np.array([2, 1]), 1))
    hidden = clip.without_labels()
    assert hidden.labels.label.tolist() == [0, 0]
    assert hidden.labels.background is None
    assert hidden.evaluated.tolist() == [1, 0]


def test_objects_print_as_one_line():
    clip = Clip("Seq", two_tracks(), np.array([1, 0]), Labels(np.array([2, 1])))
    assert repr(clip) == "Clip('Seq': 3 frames, 2 trajectories, 2 evaluated, 2 motions)"
    assert repr(clip.dense) == "Trajectories(2 over 3 frames)"
    assert repr(clip.labels) == "Labels(2 of 2 motions)"
    assert (
        repr(Segmentation(np.array([1, 3, 3]))) == "Segmentation(3 trajectories; motion: size {1: 1, 3: 2})"
    )


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: kt3dmoseg.load(None), "path: expected a path, found None"),
        (lambda: kt3dmoseg.save("clip", "a.h5"), "clip: expected Clip, found 'clip'"),
        (lambda: kt3dmoseg.track(5), "frames: expected a path or several .*, found 5"),
        (lambda: kt3dmoseg.label_tracks(two_tracks(), None), "annotation: expected Annotation, found None"),
        (lambda: kt3dmoseg.label_tracks(two_tracks().xy, "a.json"), "found ndarray"),
        (lambda: kt3dmoseg.load_annotation(b"a.json"), "path: expected a path, found b'a.json'"),
        (lambda: kt3dmoseg.show([1, "a"]), "clip: expected a path, found list of int, str"),
        (lambda: mseg.segment(two_tracks(), None), "method: expected text or Method, found None"),
        (lambda: mseg.score(None, [1]), "truth"),
        (lambda: mseg.benchmark.predict(3, "out"), "data: expected a path, found 3"),
        (
            lambda: kt3dmoseg.choose([1], "out"),
            "recordings: expected a path or several .*, found list of int",
        ),
        (lambda: mseg.benchmark.run(methods=np.zeros(2)), "methods: expected text .*, found ndarray"),
        (lambda: mseg.benchmark.run(methods=[1]), "methods: expected text or several .*, found list of int"),
        (
            lambda: kt3dmoseg.Clip("a", two_tracks(), [0], {"label": [1]}),
            "labels: expected Labels, found dict",
        ),
        (
            lambda: kt3dmoseg.Labels([1], names={1.0: "car"}),
            "names: expected {label: name}, found {1.0: 'car'}",
        ),
        (lambda: kt3dmoseg.Labels([1], names={"car": 1}), "names: expected {label: name}"),
        (lambda: kt3dmoseg.Labels([1], names={1: None}), "names: expected {label: name}"),
        (lambda: kt3dmoseg.Labels([1], names=None), "names: expected a mapping, found None"),
        (lambda: kt3dmoseg.Clip("a", two_tracks(), [0.5], Labels([1])), "expected whole numbers, found"),
        (lambda: kt3dmoseg.Camera("a", object()), "expected numbers, found"),
    ],
)
def test_arguments_of_a_wrong_type_are_refused_in_one_line(call, message):
    with pytest.raises(InvalidValueError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_public_functions_can_be_pickled():
    assert pickle.loads(pickle.dumps(kt3dmoseg.track)) is kt3dmoseg.track


def test_masked_labels_are_refused():
    with pytest.raises(InvalidValueError, match="no masked values"):
        Labels(np.ma.array([1, 2, 9], mask=[0, 0, 1]))
