"""Files of trajectories as other programs write them: read rightly, or refused by name."""

from __future__ import annotations

import dataclasses
import gzip
import os
import struct
import subprocess
import sys
import zipfile

import cv2
import h5py
import numpy as np
import pytest
import scipy.io
from io_clips import small_clip

import kt3dmoseg
from kt3dmoseg.cli import main
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.io import hdf5, load, save
from kt3dmoseg.io.fields import check_axes
from kt3dmoseg.io.point_tracks import check_on_pictures
from kt3dmoseg.types import Camera, Clip, Labels, Trajectories

WIDTH, HEIGHT, FRAMES, COUNT = 320, 240, 8, 30


@pytest.fixture
def xy(rng):
    return rng.uniform(40, 200, (COUNT, FRAMES, 2))


def fractions(xy):
    return (xy + 0.5) / (WIDTH, HEIGHT)


def tapvid(path, points, video=(FRAMES, HEIGHT, WIDTH, 3), occluded=None):
    occluded = np.zeros(np.shape(points)[:2], bool) if occluded is None else occluded
    np.savez_compressed(path, points=points, occluded=occluded, video=np.zeros(video, np.uint8))
    return path


@pytest.mark.parametrize(
    "video",
    [
        (FRAMES, HEIGHT, WIDTH, 3),
        (FRAMES, 3, HEIGHT, WIDTH),
        (FRAMES, HEIGHT, WIDTH, 4),
        (FRAMES, 1, HEIGHT, WIDTH),
        (FRAMES, HEIGHT, WIDTH),
    ],
)
def test_tapvid_fractions_become_pixels_whatever_the_layout_of_the_video(xy, tmp_path, video):
    clip = load(tapvid(tmp_path / "points.npz", fractions(xy), video))
    np.testing.assert_allclose(clip.dense.xy, xy)
    assert clip.dense.image_size == (WIDTH, HEIGHT)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda xy: xy, r"points: expected fractions of width and height, 0 to 1, found .*pixels"),
        (lambda xy: 2 * fractions(xy) - 1, "expected fractions of width and height, 0 to 1, found -"),
        (lambda xy: xy / 100, "0 to 1, found"),
    ],
    ids=["pixels", "from -1 to 1", "another scale"],
)
def test_tapvid_points_that_are_no_fractions_are_refused(xy, tmp_path, make, message):
    with pytest.raises(FileFormatError, match=message):
        load(tapvid(tmp_path / "points.npz", make(xy)))


def test_tapvid_arrays_in_another_order_are_refused(xy, tmp_path):
    points, path = fractions(xy), tmp_path / "points.npz"
    with pytest.raises(FileFormatError, match="swap tracks and frames of points and occluded"):
        load(tapvid(path, points.swapaxes(0, 1)))
    for video in ((1, FRAMES, 3, HEIGHT, WIDTH), (FRAMES, HEIGHT, WIDTH, 7), (FRAMES - 1, HEIGHT, WIDTH, 3)):
        with pytest.raises(FileFormatError, match=r"points\.npz: video: expected"):
            load(tapvid(path, points, video))
    with pytest.raises(FileFormatError, match="occluded: expected 0 or 1, found -3"):
        load(tapvid(path, points, occluded=np.linspace(-3, 3, COUNT * FRAMES).reshape(COUNT, FRAMES)))


@pytest.fixture(params=[(120, 160), (128, 128)], ids=["wide", "square"])
def panned(request, rng):
    """Points that follow a camera's pan: fractions (N, F, 2), and the video."""
    size, frames = request.param, 12
    scene = cv2.GaussianBlur(rng.random((size[0] + 50, size[1] + 50)), (0, 0), 2)
    scene = cv2.normalize(scene, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    video = np.stack([scene[k : k + size[0], 3 * k : 3 * k + size[1]] for k in range(frames)])
    xy = rng.uniform((40, 20), (size[1] - 10, size[0] - 10), (50, 2))[:, None]
    xy = xy - np.arange(frames)[:, None] * (3, 1)
    return (xy + 0.5) / size[::-1], video[..., None]


def test_tapvid_points_with_x_and_y_exchanged_do_not_follow_the_video(panned, tmp_path):
    points, video = panned
    arrays = {"occluded": np.zeros(points.shape[:2]), "points": points, "video": video}
    for changed in ({}, {"video": np.moveaxis(video, -1, 1)}, {"video": video[..., 0]}):
        np.savez(tmp_path / "a.npz", **arrays | changed)
        assert load(tmp_path / "a.npz").n_frames == 12
    for changed in ({"points": points[..., ::-1]}, {"video": video.swapaxes(1, 2)}):
        np.savez(tmp_path / "a.npz", **arrays | changed)
        with pytest.raises(FileFormatError, match=r"points: expected \(x, y\), .* give points"):
            load(tmp_path / "a.npz")


def test_of_several_readings_that_fit_the_best_is_named():
    rng = np.random.default_rng(1)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (96, 320)).astype(np.uint8), (0, 0), 3)
    picture[-8:] = picture[-8:] * 0.1  # a dark border, on which many points lie as (y, x)
    pictures = np.stack([picture, np.roll(picture, (3, 6), axis=(0, 1))]).astype(np.float64)
    pictures[1, :3] = pictures[0, :3]
    start = rng.integers((120, 20), (290, 35), (200, 2))
    xy = np.stack([start, start + np.array([6, 3])], axis=1) * (256 / 320, 256 / 96)
    with pytest.raises(InvalidValueError, match=r"only when scaled by \(1\.25, 0\.375\)"):
        check_on_pictures("tracks", Trajectories(xy, np.ones((200, 2), bool)), pictures, 1)


@pytest.mark.parametrize("last", [2, 12], ids=["near", "far"])
def test_tracks_of_other_frames_are_not_called_exchanged(rng, last):
    picture = cv2.GaussianBlur(rng.random((320, 320)), (0, 0), 2) * 1e3
    picture[160:, :160] = np.arange(160.0)  # even, where they lie as (y, x)
    pictures = np.stack([picture, np.roll(picture, -9, axis=1)])
    start = rng.uniform((200, 20), (300, 80), (200, 2))
    xy, seen = start[:, None] - np.linspace((0, 0), (9, 0), last + 1), np.ones((200, last + 1), bool)
    check_on_pictures("tracks", Trajectories(xy, seen), pictures, last)
    with pytest.raises(InvalidValueError, match="points that follow them no better than standing ones"):
        check_on_pictures("tracks", Trajectories(xy[:, ::-1], seen), pictures, last)


def test_tracks_and_frames_exchanged_are_noticed_by_how_points_move(panned, tmp_path):
    points, video = panned
    with pytest.raises(FileFormatError, match="points: expected paths that bend less in time than"):
        load(tapvid(tmp_path / "a.npz", points[:12].swapaxes(0, 1), video.shape))
    pixels = points * 128
    np.testing.assert_array_equal(load(cotracker(tmp_path / "b.npz", pixels)).dense.xy, pixels)
    with pytest.raises(FileFormatError, match=r"pred_tracks: .* exchange the axes of tracks and frames"):
        load(cotracker(tmp_path / "b.npz", pixels.swapaxes(0, 1)))


@pytest.mark.parametrize("suffix", [".h5", ".npz"])
def test_x_and_y_exchanged_are_noticed_where_the_size_is_known(xy, tmp_path, suffix):
    xy[..., 0] += 100
    labels, seen = Labels(np.ones(COUNT, int)), np.ones(xy.shape[:2], bool)
    for size, positions in (((WIDTH, HEIGHT), xy[..., ::-1]), ((HEIGHT, WIDTH), xy)):
        dense = Trajectories(positions, seen, image_size=size)
        save(Clip("clip", dense, np.arange(COUNT), labels), tmp_path / f"clip{suffix}")
        with pytest.raises(FileFormatError, match="are x and y exchanged, or width and height"):
            load(tmp_path / f"clip{suffix}")
    dense = Trajectories(xy, seen, image_size=(WIDTH, HEIGHT))
    save(Clip("clip", dense, np.arange(COUNT), labels), tmp_path / f"clip{suffix}")
    assert len(load(tmp_path / f"clip{suffix}").dense) == COUNT


@pytest.mark.parametrize("channels", [3, 4])
def test_the_channels_of_one_picture_are_no_video(xy, tmp_path, channels):
    points, path = fractions(xy[:, :channels]), tmp_path / "points.npz"
    with pytest.raises(FileFormatError, match=r"video: .* found shape .* give video\[\.\.\., None\]"):
        load(tapvid(path, points, (channels, HEIGHT, WIDTH)))
    assert load(tapvid(path, points, (channels, HEIGHT, WIDTH, 1))).n_frames == channels
    with pytest.raises(InvalidValueError, match=r"few frames list\(frames\)"):
        kt3dmoseg.track(np.zeros((channels, HEIGHT, WIDTH), np.uint8))


def test_a_point_a_little_over_the_border_is_no_pixel(xy, tmp_path):
    xy[0, 0] = -2, HEIGHT + 2
    np.testing.assert_allclose(load(tapvid(tmp_path / "points.npz", fractions(xy))).dense.xy, xy)


def cotracker(path, tracks, visibility=None):
    visibility = np.ones(tracks.shape[:2]) if visibility is None else visibility
    np.savez(path, pred_tracks=tracks.swapaxes(0, 1)[None], pred_visibility=visibility.T[None])
    return path


def test_cotracker_needs_pixels_and_probabilities(xy, tmp_path):
    path = tmp_path / "tracks.npz"
    np.testing.assert_array_equal(load(cotracker(path, xy)).dense.xy, xy)
    for tracks in (fractions(xy), 2 * fractions(xy) - 1):
        with pytest.raises(FileFormatError, match="pred_tracks: expected pixels, found at most"):
            load(cotracker(path, tracks))
    with pytest.raises(FileFormatError, match="pred_visibility: expected 0 to 1, found -4 to 4"):
        load(cotracker(path, xy, np.linspace(-4, 4, COUNT * FRAMES).reshape(COUNT, FRAMES)))


@pytest.fixture
def release(xy):
    rows = np.arange(1, COUNT, 3)
    homogeneous = np.concatenate([xy, np.ones((COUNT, FRAMES, 1))], axis=2).transpose(2, 0, 1)
    data = {"yAll": homogeneous, "visibleAll": np.ones((COUNT, FRAMES)), "ySparse": homogeneous[:, rows - 1]}
    data |= {"visibleSparse": np.ones((len(rows), FRAMES)), "SparseIndex": rows, "GtLabel": 1 + rows % 2}
    return data | {"nFrames": FRAMES, "nAllPoints": COUNT, "nSparsePoints": len(rows)}


@pytest.mark.parametrize("turn", [np.ravel, lambda v: v[:, None], lambda v: v[None]])
def test_vectors_of_a_mat_file_may_be_rows_or_columns(release, xy, tmp_path, turn):
    changed = {name: turn(release[name]) for name in ("SparseIndex", "GtLabel")}
    scipy.io.savemat(tmp_path / "clip.mat", {"Data": release | changed})
    clip = load(tmp_path / "clip.mat")
    np.testing.assert_array_equal(clip.dense.xy, xy)
    np.testing.assert_array_equal(clip.evaluated, release["SparseIndex"] - 1)
    np.testing.assert_array_equal(clip.labels.label, release["GtLabel"])


def test_vectors_of_hopkins_may_be_rows(xy, tmp_path):
    y = np.concatenate([xy, np.ones((COUNT, FRAMES, 1))], axis=2).transpose(2, 0, 1)
    fields = {"y": y, "s": np.ones((1, COUNT)), "K": np.eye(3), "width": WIDTH, "height": HEIGHT}
    scipy.io.savemat(tmp_path / "a_truth.mat", fields)
    np.testing.assert_array_equal(load(tmp_path / "a_truth.mat").dense.xy, xy)
    scipy.io.savemat(tmp_path / "a_truth.mat", fields | {"y": y.swapaxes(1, 2)})
    with pytest.raises(
        FileFormatError, match="y: expected 3 x 30 points x 8 frames, found 3 x 8 x 30; permute"
    ):
        load(tmp_path / "a_truth.mat")


@pytest.mark.parametrize(
    ("name", "order", "message"),
    [
        ("ySparse", (1, 0, 2), "ySparse: expected 3 x any x any, found 10 x 3 x 8; is it transposed"),
        ("yAll", (2, 1, 0), "yAll: expected 3 x any x 8, found 8 x 30 x 3; is it transposed"),
        ("yAll", (0, 2, 1), "yAll: expected 3 x any x 8, found 3 x 8 x 30"),
        ("visibleAll", (1, 0), "visibleAll: expected 30 x 8, found 8 x 30; is it transposed"),
        ("GtLabel", None, "GtLabel: expected a vector of 10, found 2 x 5"),
    ],
)
def test_matrices_in_another_order_are_refused_with_their_shape(release, tmp_path, name, order, message):
    value = release[name]
    changed = value.reshape(2, 5) if order is None else value.transpose(order)
    scipy.io.savemat(tmp_path / "clip.mat", {"Data": release | {name: changed}})
    with pytest.raises(FileFormatError, match=message):
        load(tmp_path / "clip.mat")


def test_everything_with_points_and_frames_swapped_is_refused(release, tmp_path):
    names = ("yAll", "ySparse", "visibleAll", "visibleSparse")
    swapped = {name: release[name].swapaxes(-1, -2) for name in names}
    kept = {name: release[name] for name in ("SparseIndex", "GtLabel")}
    scipy.io.savemat(tmp_path / "clip.mat", {"Data": swapped | kept})
    with pytest.raises(FileFormatError, match="ySparse: expected 3 x 10 points x 8 frames, found 3 x 8 x 10"):
        load(tmp_path / "clip.mat")


def test_older_and_newer_mat_files_texts_and_pages_are_named(tmp_path):
    path = tmp_path / "clip.mat"
    scipy.io.savemat(path, {"y": np.ones((3, 4))}, format="4")
    refused(path, "a MATLAB version 4 MAT-file; save it in MATLAB with the option '-v7'")
    path.write_bytes(struct.pack(">5i", 1000, 2, 2, 0, 2) + b"y\0" + bytes(32))
    refused(path, "version 4")
    path.write_text("  1.0e+00  2.0e+00\n")  # save -ascii
    refused(path, "a text file; save it in MATLAB with the option '-v7'")
    path.write_text("name,label\n1,2\n")  # no variable of MATLAB
    refused(path, "a text file with 'name,label'$")
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n")
    refused(path, "version 7.3 .*'-v7'")
    with h5py.File(path, "w") as file:
        file["Data/yAll"] = np.ones(3)
    refused(path, "a MATLAB 7.3 MAT-file .*'-v7'")
    path.write_text("<!DOCTYPE html><html>moved</html>")
    refused(path, "a web page; fetch the file itself")
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:00\n")
    refused(path, "a Git LFS pointer; .*git lfs pull")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(200))
    refused(path, r"starts with b'\\x89PNG")
    path.write_bytes(gzip.compress(bytes(200)))
    refused(path, "a compressed file; unpack it")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a/clip.mat", b"x")
    refused(path, r"found a/clip\.mat; unpack the archive")


def refused(path, message):
    with pytest.raises(FileFormatError, match=message) as caught:
        load(path)
    assert "is the file complete" not in str(caught.value)


def test_only_damage_is_answered_with_fetch_it_again(tmp_path):
    (tmp_path / "clip.h5").write_bytes(b"")
    with pytest.raises(FileFormatError, match="an empty file; is the file complete"):
        load(tmp_path / "clip.h5")
    (tmp_path / "clip.h5").write_bytes(bytes(3000))
    with pytest.raises(FileFormatError, match=r"zeros, .*; is the file complete"):
        load(tmp_path / "clip.h5")
    (tmp_path / "tracks.dat").write_text("track x y")
    refused(tmp_path / "tracks.dat", "a text file with 'track'")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("2\n1\n1 1\n0.5 nan 0\n", "a text file with 'nan'"),
        ("2\n1\n1 1\n0.5 1 0\nend\n", "a text file with 'end'"),
        ("2\n1\n1 1\n0.5 1.2.3 0\n", r"value 6: .* found '1\.2\.3'"),
        ("2\n1\n1 1\n0.5 " + "9" * 400 + " 0\n", "value 6: expected finite numbers"),
        ("2\n1\n1 1\n0.5 1e999 0\n", "value 6: .* found '1e999'"),
        ("2\n1\n1 1\n0.5 --- 0\n", "value 6: .* found '---'"),
    ],
)
def test_a_bad_number_in_a_text_is_shown(tmp_path, text, message):
    (tmp_path / "tracks.dat").write_text(text)
    with pytest.raises(FileFormatError, match=message):
        load(tmp_path / "tracks.dat")


@pytest.mark.parametrize("background", [1, 2, None])
@pytest.mark.parametrize("suffix", [".h5", ".mat", ".npz", ".dat"])
def test_the_background_keeps_its_motion_number_or_is_reported(tmp_path, capsys, xy, background, suffix):
    label = np.arange(COUNT) % 3
    clip = Clip(
        "clip", Trajectories(xy, np.ones(xy.shape[:2], bool)), np.arange(COUNT), Labels(label, background)
    )
    save(clip, tmp_path / "clip.h5")
    target = tmp_path / f"other{suffix}"
    assert main(["convert", str(tmp_path / "clip.h5"), str(target)]) == 0
    found, lost = load(target).labels, "which label is the background" in capsys.readouterr().err
    np.testing.assert_array_equal(found.label, label)
    assert (found.background, lost) in [(background, False), (None, background is not None)]
    assert suffix == ".dat" or found.background == background
    again = tmp_path / "again.mat"
    assert main(["convert", str(target), str(again)]) == 0
    assert load(again).labels.background == found.background


_OPEN = """
import h5py, sys
with h5py.File(sys.argv[1], "r+") as file:
    print("open", flush=True)
    sys.stdin.readline()
"""


def test_a_file_that_another_program_writes_is_called_open_not_damaged(tmp_path, capsys):
    path = tmp_path / "clip.h5"
    save(small_clip(), path)
    command = [sys.executable, "-c", _OPEN, str(path)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as other:
        assert other.stdout.readline() == "open\n"
        with pytest.raises(
            InputFileError, match="expected a finished file, found one that another program has open"
        ):
            load(path)
        assert main(["info", str(path)]) == 2
        assert "damage" not in capsys.readouterr().err
        other.communicate("\n")
    assert load(path).name == "tiny"


def test_every_flipped_bit_of_the_content_is_noticed_before_a_file_counts_as_up_to_date(tmp_path, rng):
    path = tmp_path / "clip.h5"
    save(small_clip(), path)
    content, intact = path.read_bytes(), dict(small_clip().provenance)
    assert hdf5.provenance(path) == intact
    noticed = 0
    for at in rng.integers(0, len(content), 60):
        damaged = bytearray(content)
        damaged[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            found = hdf5.provenance(path)
        except (FileFormatError, InputFileError):
            noticed += 1
        else:  # an unused byte
            assert found == intact
            assert repr(load(path)) == repr(small_clip("tiny"))
            np.testing.assert_array_equal(load(path).dense.xy, small_clip().dense.xy)
    assert noticed > 30


def test_links_that_lead_nowhere_are_no_missing_clips(tmp_path):
    save(small_clip(), tmp_path / "data" / "a.h5")
    (tmp_path / "data" / "b.h5").symlink_to(tmp_path / "gone.h5")
    with pytest.raises(InputFileError, match=r"b\.h5: expected .* found a link that leads nowhere"):
        kt3dmoseg.load_dataset(tmp_path / "data")


def test_a_name_that_is_no_utf8_is_refused_where_a_file_would_hold_it(tmp_path, capsys):
    path = os.fsdecode(os.fsencode(tmp_path) + b"/clip\xff.mat")
    save(small_clip(), path)
    assert main(["info", path]) == 0
    assert r"clip\udcff" in capsys.readouterr().out
    for target in ("copy.h5", "copy.npz"):
        assert main(["convert", path, str(tmp_path / target)]) == 2
        assert r"name: expected text in UTF-8, found 'clip\udcff'" in capsys.readouterr().err
        assert not (tmp_path / target).exists()
    clip = small_clip()
    for changed in ({"provenance": {"a": "\ud800"}}, {"camera": Camera("\ud800")}):
        with pytest.raises(InvalidValueError, match="expected text in UTF-8"):
            save(dataclasses.replace(clip, **changed), tmp_path / "copy.h5")


def test_an_object_that_moves_further_than_its_size_is_read_in_the_right_order(tmp_path):
    start = np.random.default_rng(0).uniform(0, 100, (60, 1, 2))
    xy = start + np.arange(40)[:, None] * (10.0, 0.3)
    seen = np.ones(xy.shape[:2], dtype=bool)
    for tracks, visible in ((xy, seen), (xy.swapaxes(0, 1), seen.T), (xy.swapaxes(0, 1)[None], seen.T[None])):
        np.savez(tmp_path / "a.npz", tracks=tracks, visibility=visible)
        np.testing.assert_array_equal(load(tmp_path / "a.npz").dense.xy, xy)
    check_axes("xy", xy, seen)
    with pytest.raises(InvalidValueError, match="exchange the axes"):
        check_axes("xy", xy.swapaxes(0, 1), seen.T)
    noise = np.random.default_rng(0).uniform(0, 100, (9, 9, 2))
    np.savez(tmp_path / "a.npz", tracks=noise, visibility=seen[:9, :9])
    with pytest.raises(FileFormatError, match="name them pred_tracks"):
        load(tmp_path / "a.npz")


def test_tracks_in_even_rows_are_no_exchanged_axes_when_the_camera_shakes(tmp_path):
    row = np.stack([np.linspace(10, 200, 20), np.full(20, 50.0)], axis=1)[:, None]
    shake = np.random.default_rng(0).normal(0, 1, (12, 2)) + np.arange(12)[:, None]
    seen = np.ones((20, 12), dtype=bool)
    for xy in (row + shake, row + np.arange(12)[:, None] * (1.3, 0.7)):
        check_axes("xy", xy, seen)
    far = row + shake
    far[3, 4], seen[3, 4] = 1e308, False
    check_axes("xy", far, seen)


@pytest.mark.parametrize("shape", [(200, 2), (2, 200), (50, 2), (2, 50), (1, 9), (9, 1)])
def test_two_frames_and_single_tracks_are_read_in_the_right_order(tmp_path, shape):
    tracks, frames = max(shape), min(shape)
    if frames == 1:
        tracks, frames = frames, tracks
    start = np.random.default_rng(0).uniform(0, 300, (tracks, 1, 2))
    xy = start + np.arange(frames)[:, None] * (2.0, 1.0)
    given = xy if xy.shape[:2] == shape else xy.swapaxes(0, 1)
    np.savez(tmp_path / "a.npz", tracks=given, visibility=np.ones(shape, dtype=bool))
    np.testing.assert_array_equal(load(tmp_path / "a.npz").dense.xy, xy)
