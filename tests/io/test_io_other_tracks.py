"""Brox .dat, CoTracker and TAP-Vid arrays, predictions."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest
from io_clips import small_clip

from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.io import load, save
from kt3dmoseg.io.npz import read_npz, write_npz
from kt3dmoseg.io.predictions import read_prediction

_TRACKS = "3\n2\n{0}\n1.5 2 0\n2.5 2 1\n{1}\n7 8.25 2\n"


@pytest.mark.parametrize("heads", [("1 2", "-1 1"), ("1\n2", "-1\n1"), ("1\t2", " -1  1 ")])
def test_labels_and_lengths_on_one_line_or_two(heads, tmp_path):
    (tmp_path / "a.dat").write_text(_TRACKS.format(*heads))
    clip = load(tmp_path / "a.dat")
    assert clip.labels.label.tolist() == [1, 0]
    assert clip.dense.visible.tolist() == [[True, True, False], [False, False, True]]
    assert clip.dense.xy[1, 2].tolist() == [7.0, 8.25]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("3", "nTracks: expected a whole number >= 0, found the end of the file"),
        ("3 999999999 1 1", "found 3 frames x 999999999 tracks"),
        ("3 5 1 1 0 0 0", "nTracks: expected 1, the tracks that follow, found 5"),
        ("999999999 1 1 1 0 0 0", "nFrames: expected at most"),
        ("3 1 1 5 0 0 0", "track 0: expected 5 points, found the end"),
        ("3 1 1 1 0 0 3", r"track 0: expected frames 0\.\.2, found 3"),
        ("3 1 1 1 0 0 0.5", "track 0: expected frames"),
        ("3 1 1 2 0 0 1 5 5 1", "a frame given twice"),
        ("3 1 1 1 0 0 0 7", "track 1: length: expected a whole number >= 0, found the end"),
        ("3 1 0.5 1 0 0 0", "track 0: label: expected a whole number"),
        ("3 1 1 1 nan 0 0", "a clip"),
        ("3 1 1 1 1e999 0 0", "finite"),
    ],
)
def test_bad_dat_files(text, words, tmp_path):
    (tmp_path / "a.dat").write_text(text)
    with pytest.raises(FileFormatError, match=words) as caught:
        load(tmp_path / "a.dat")
    assert str(tmp_path / "a.dat") in str(caught.value)


@pytest.mark.parametrize("extra", [(), (1,)])
def test_cotracker(extra, rng, tmp_path):
    tracks = rng.random((1, 1, 3, 2)) * 90 + rng.random((1, 4, 3, 2))
    visible = rng.random((1, 4, 3)) > 0.5
    np.savez(tmp_path / "v.npz", pred_tracks=tracks, pred_visibility=visible.reshape(*visible.shape, *extra))
    clip = load(tmp_path / "v.npz")
    np.testing.assert_array_equal(clip.dense.visible, visible[0].T)
    np.testing.assert_array_equal(clip.dense.xy[clip.dense.visible], tracks[0].swapaxes(0, 1)[visible[0].T])


def test_tapvid_counts_from_the_outer_corner(tmp_path):
    points = np.array([[[0.5, 0.5], [0.0, 1.0]]])
    video = np.zeros((2, 100, 200, 3), np.uint8)
    np.savez(tmp_path / "v.npz", points=points, occluded=np.array([[False, True]]), video=video)
    clip = load(tmp_path / "v.npz")
    assert clip.dense.image_size == (200, 100)
    assert clip.dense.xy[0, 0].tolist() == [99.5, 49.5]
    assert clip.dense.visible.tolist() == [[True, False]]


def _tapvid(occluded, video):
    return {"points": np.zeros((3, 4, 2)), "occluded": np.ones(occluded), "video": np.zeros(video)}


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"pred_tracks": np.zeros((2, 4, 3, 2)), "pred_visibility": np.ones((2, 4, 3))}, "pred_tracks"),
        ({"pred_tracks": np.zeros((1, 4, 3, 2)), "pred_visibility": np.ones((1, 3, 4))}, "pred_visibility"),
        (
            {"points": np.zeros((3, 4, 2)), "occluded": np.ones((3, 4)), "video": np.zeros((5, 2, 2, 3))},
            "video",
        ),
        (
            {"points": np.zeros((3, 4, 2)), "occluded": np.ones((3, 5)), "video": np.zeros((4, 2, 2, 3))},
            "occluded",
        ),
        ({"a": np.zeros(3)}, "found a; the arrays of cotracker, tapir"),
        (
            {"pred_tracks": np.full((1, 4, 3, 2), "a"), "pred_visibility": np.ones((1, 4, 3))},
            "expected numbers",
        ),
        (
            {"pred_tracks": np.zeros((1, 4, 3, 2)), "pred_visibility": np.full((1, 4, 3), "a")},
            "expected numbers",
        ),
        (_tapvid((3, 4), (4, 0, 0, 3)), "image_size: expected .width, height.*found .0, 0"),
        (
            {"pred_tracks": np.zeros((1, 1 << 30, 0, 2)), "pred_visibility": np.ones((1, 1 << 30, 0))},
            "in an empty array at most",
        ),
    ],
)
def test_bad_arrays(arrays, words, tmp_path):
    np.savez(tmp_path / "v.npz", **arrays)
    with pytest.raises(FileFormatError, match=words):
        load(tmp_path / "v.npz")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"label_names": np.array('{"van": "2"}')}, "label_names: expected numbers of motions, found 'van'"),
        ({"label_names": np.array(3)}, "label_names: expected a text, found int64 of shape"),
        ({"provenance": np.array("[]")}, "provenance: expected a JSON object, found list"),
        ({"image_size": np.array([-1, 4])}, "image_size"),
        ({"image_size": np.array([1, 2, 3])}, "image_size: expected .width, height."),
        ({"background": np.array([1])}, "background: expected one value, found 1"),
        ({"xy": np.zeros((6, 5))}, "xy: expected shape"),
        ({"label": np.array([1.5])}, "label: expected whole numbers, found float64 of shape"),
        ({"background": np.array(1 << 63, dtype=np.uint64)}, "at most 9223372036854775807"),
    ],
)
def test_a_clip_in_npz_that_contradicts_itself(changes, words, tmp_path):
    save(small_clip(), tmp_path / "a.npz")
    write_npz(tmp_path / "b.npz", read_npz(tmp_path / "a.npz") | changes)
    with pytest.raises(FileFormatError, match=words):
        load(tmp_path / "b.npz")


def test_npz_reads_no_more_than_asked_for(tmp_path):
    write_npz(tmp_path / "a.npz", {"x": np.arange(3), "y": np.eye(2)})
    read = read_npz(tmp_path / "a.npz", {"y", "z"})
    assert read["x"].tolist() == [0, 1, 2]
    assert read["y"].shape == (2, 2)
    assert not read["y"].any()


def test_an_array_that_unpacks_to_far_more_than_its_file_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("tracks.npy", bytes((1 << 26) + 1))
    with pytest.raises(FileFormatError, match="packed at most 100 to 1"):
        load(tmp_path / "a.npz")


def _write(path, track, label):
    if path.suffix == ".csv":
        path.write_text("track,label\n" + "".join(f"{t},{v}\n" for t, v in zip(track, label, strict=True)))
    elif path.suffix == ".npz":
        np.savez(path, track=track, label=label)
    else:
        import h5py

        with h5py.File(path, "w") as file:
            file["track"], file["label"] = track, label


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".h5"])
def test_predictions_are_joined_by_id(suffix, tmp_path):
    path = tmp_path / f"tiny{suffix}"
    _write(path, np.array([5, 3, 2, 0]), np.array([50, 30, 20, 1]))
    assert read_prediction(path, small_clip()).tolist() == [1, 20, 50, 30]


def test_predictions_of_another_clip_are_refused(tmp_path):
    _write(tmp_path / "a.csv", [0, 2, 5], [1, 1, 1])
    with pytest.raises(
        FileFormatError, match=r"a.csv, clip tiny: .* found 1 missing \(track 3\); write one row"
    ):
        read_prediction(tmp_path / "a.csv", small_clip())
    _write(tmp_path / "a.csv", [0, 2, 3, 5, 77], [1, 1, 1, 1, 1])
    with pytest.raises(
        FileFormatError, match=r"the 4 evaluated .* found 1 that are not evaluated \(track 77\)"
    ):
        read_prediction(tmp_path / "a.csv", small_clip())
    (tmp_path / "b.csv").write_text("1\n2\n")
    with pytest.raises(FileFormatError, match="make the first line 'track,label'"):
        read_prediction(tmp_path / "b.csv", small_clip())
    with pytest.raises(InvalidValueError, match="suffix"):
        read_prediction(tmp_path / "b.txt", small_clip())


def test_everything_wrong_with_a_prediction_is_listed(tmp_path):
    _write(tmp_path / "a.csv", [0, 2, -3, 5], [1, 1, 1, -1])
    with pytest.raises(
        FileFormatError, match=r"a.csv: 1. \[negative\] .* as track.* 2. \[negative\] .* as label"
    ):
        read_prediction(tmp_path / "a.csv", small_clip())


@pytest.mark.parametrize(
    ("row", "code", "found"),
    [
        ("2,nan", "nan", "NaN in 1 of 2 rows"),
        ("2", "ragged", "line 4"),
        ("2,1,1", "ragged", "line 4"),
        ("2,1.5", "float", "such as 1.5"),
        ("2," + 30 * "9", "too-big", "1 of 2 rows"),
        ("1_0,2", "not-a-number", r"'1_0' \(line 4\)"),
    ],
)
def test_a_bad_row_of_a_prediction_is_named(row, code, found, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"track,label\n0,1\n\n{row}\n")
    with pytest.raises(FileFormatError, match=rf"\[{code}\] .*found .*{found}"):
        read_prediction(path, small_clip())


def test_brox_labels_count_from_0_where_some_are_none(tmp_path):
    path = tmp_path / "clip.dat"
    for labels, expected in (("-1 0 0 1", [0, 1, 1, 2]), ("0 1 1 2", [0, 1, 1, 2])):
        tracks = [f"{label} 2\n{k} 1 0\n{k} 2 1" for k, label in enumerate(labels.split())]
        path.write_text("\n".join(["2", "4", *tracks]) + "\n")
        assert load(path).labels.label.tolist() == expected
