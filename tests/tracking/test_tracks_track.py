"""The complete tracker, on flow that is known exactly."""

from __future__ import annotations

import tracemalloc
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

import kt3dmoseg
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, UnknownNameError
from kt3dmoseg.tracking import TrackOptions, track

MOTION = (3.0, 1.0)


@dataclass(frozen=True)
class Constant:
    """Forward flow `MOTION`, backward its opposite; distinguished by the frames' first pixel."""

    motion: tuple[float, float] = MOTION

    def __call__(self, a, b):
        sign = 1 if int(b[0, 0]) > int(a[0, 0]) else -1
        return np.broadcast_to(np.float32(self.motion) * sign, (*a.shape, 2)).copy()


def frames(count=8, height=64, width=96, seed=0):
    noise = np.random.default_rng(seed).integers(0, 255, (height, width), dtype=np.uint8)
    picture = cv2.GaussianBlur(noise, (0, 0), 1.5)
    out = []
    for number in range(count):
        frame = picture.copy()
        frame[0, 0] = number
        out.append(frame)
    return out


def test_tracks_are_straight_under_constant_flow():
    tracks = track(frames(), Constant())
    assert tracks.image_size == (96, 64)
    assert tracks.n_frames == 8
    steps = np.diff(tracks.xy, axis=1)
    both = tracks.visible[:, 1:] & tracks.visible[:, :-1]
    np.testing.assert_allclose(steps[both], np.broadcast_to(MOTION, (both.sum(), 2)), atol=1e-6)


def test_tracks_have_no_gap_and_are_long_enough():
    tracks = track(frames(), Constant(), min_length=4)
    changes = np.abs(np.diff(tracks.visible.astype(int), axis=1)).sum(axis=1)
    outside = 2 - tracks.visible[:, 0].astype(int) - tracks.visible[:, -1].astype(int)
    np.testing.assert_array_equal(changes, outside)
    assert tracks.lengths.min() >= 4
    assert len(track(frames(), Constant(), min_length=8)) < len(tracks)


def test_starts_lie_on_the_grid_and_away_from_live_tracks():
    tracks = track(frames(), Constant(), min_length=1)
    first = tracks.visible.argmax(axis=1)
    starts = tracks.xy[np.arange(len(tracks)), first]
    np.testing.assert_array_equal(starts % 8, 4)
    assert (first > 0).any()
    for row in np.flatnonzero(first > 0):
        live = np.trunc(tracks.xy[first < first[row], first[row]])
        gap = np.linalg.norm(live - starts[row], axis=1)
        assert np.nanmin(gap) >= 8


def test_rows_are_in_the_order_of_their_start():
    tracks = track(frames(), Constant())
    first = tracks.visible.argmax(axis=1)
    assert (np.diff(first) >= 0).all()
    np.testing.assert_array_equal(tracks.track_id, np.arange(len(tracks)))


def test_seeds_are_tracked_row_by_row_and_never_dropped():
    seeds = np.array([[50.25, 20.5, 3], [10, 10, 0], [95, 30, 0], [20, 20, 7]])
    tracks = track(frames(), Constant(), seeds=seeds)
    assert len(tracks) == 4
    for row, (x, y, frame) in enumerate(seeds):
        np.testing.assert_array_equal(tracks.xy[row, int(frame)], [x, y])
        assert not tracks.visible[row, : int(frame)].any()
    assert tracks.lengths.tolist() == [5, 8, 1, 1]
    np.testing.assert_allclose(tracks.xy[0, 7], np.add([50.25, 20.5], np.multiply(MOTION, 4)))


def test_no_seeds_give_no_tracks():
    assert len(track(frames(3), Constant(), seeds=np.zeros((0, 3)))) == 0


@pytest.mark.parametrize(
    ("seeds", "message"),
    [
        ([[10, 10]], r"shape \(S, 3\)"),
        ([[10, 10, 0], [10, 10, 9]], "seed 1: expected a frame number below 8"),
        ([[10, 10, 1.5]], "whole frame number"),
        ([[10, np.nan, 1]], "finite"),
        ([[10, 10, -1]], ">= 0"),
        ([[200, 10, 0]], "a point in the 96x64 frame"),
    ],
)
def test_bad_seeds(seeds, message):
    with pytest.raises(InvalidValueError, match=message):
        track(frames(), Constant(), seeds=seeds)


def test_every_way_to_give_frames_is_the_same(tmp_path):
    arrays = frames()
    for number, frame in enumerate(arrays):
        cv2.imwrite(str(tmp_path / f"{number:06d}.png"), frame)
    paths = sorted(tmp_path.iterdir())
    wanted = track(arrays, Constant())
    for source in (tmp_path, str(tmp_path), paths, list(map(str, paths)), iter(arrays), np.stack(arrays)):
        got = kt3dmoseg.track(source, Constant())
        np.testing.assert_array_equal(got.xy, wanted.xy)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ([], "at least 2 frames, found 0"),
        (frames(1), "at least 2 frames, found 1"),
        ([frames(1)[0], frames(1, width=97)[0]], "frame 1: expected 96x64 .* found 97x64"),
        ([frames(1)[0], np.zeros((64, 96, 3), np.uint8)], "frame 1: expected a gray frame"),
        ([frames(1)[0], frames(1)[0].astype(float)], "frame 1: expected a gray frame"),
        ([np.zeros((20, 96), np.uint8)] * 2, "at least 32 pixels"),
        (
            np.zeros((64, 96, 40), np.uint8),
            r"expected \(F, H, W\), found \(64, 96, 40\); of \(H, W, F\) give",
        ),
        (
            np.zeros((8, 3, 64, 96), np.uint8),
            r"frame 0: expected a gray frame, .* found uint8 of shape \(3, 64",
        ),
    ],
)
def test_bad_frames(source, message):
    with pytest.raises(InvalidValueError, match=message):
        track(source, "dis_medium")


def test_bad_folders(tmp_path):
    with pytest.raises(InputFileError):
        track(tmp_path / "absent")
    for number in range(3):
        (tmp_path / f"{number:06d}.png").write_bytes(b"not a picture")
    with pytest.raises(FileFormatError, match=r"000000\.png"):
        track(tmp_path)


def test_unknown_names_and_values():
    with pytest.raises(UnknownNameError, match="did you mean 'spacing'"):
        track(frames(), Constant(), spacng=4)
    with pytest.raises(UnknownNameError, match="unknown flow"):
        track(frames(), "flownet")
    with pytest.raises(InvalidValueError, match="min_length"):
        track(frames(), Constant(), min_length=0)


def test_progress_counts_frames():
    seen = []
    track(frames(3), Constant(), progress=lambda done, total: seen.append((done, total)))
    track(iter(frames(3)), Constant(), progress=lambda done, total: seen.append((done, total)))
    assert seen == [(1, 3), (2, 3), (3, 3), (1, None), (2, None), (3, None)]


def test_cache_changes_nothing(tmp_path):
    plain = track(frames(4), "dis_medium")
    for _ in range(2):
        cached = track(frames(4), "dis_medium", cache=tmp_path)
        np.testing.assert_array_equal(plain.xy, cached.xy)
    assert len(list(Path(tmp_path).rglob("*.npz"))) == 6


def test_memory_does_not_grow_with_the_length():
    """Beyond its trajectories: the seeds' positions are all that a longer clip adds."""

    def peak(count):
        def stream():
            for number in range(count):
                frame = np.zeros((64, 96), np.uint8)
                frame[0, 0] = number % 2
                yield frame

        tracemalloc.start()
        track(stream(), Constant((0.0, 0.0)), seeds=[[40, 30, 0]])
        top = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return top

    peak(5)
    assert peak(400) - peak(20) < 400 * 1024  # one frame and its two flow fields are 102 kB


def test_options_are_all_explained():
    from kt3dmoseg.options import describe

    assert all(text for _, _, text in describe(TrackOptions))


def test_paths_in_the_order_of_their_letters_are_refused(tmp_path):
    paths = [tmp_path / f"frame{number}.png" for number in range(8, 12)]
    for path, frame in zip(paths, frames(4), strict=True):
        cv2.imwrite(str(path), frame)
    assert len(track(paths, Constant())) == len(track(paths[::-1], Constant()))
    with pytest.raises(InvalidValueError, match=r"found frame11\.png before frame8\.png; sort them"):
        track(sorted(paths), Constant())


def test_masked_pixels_are_refused():
    masked = [np.ma.masked_less(frame, 9) for frame in frames(4)]
    with pytest.raises(InvalidValueError, match="frame 0: expected no masked pixels"):
        track(masked, Constant())


@pytest.mark.parametrize(
    "names", [["9.975304", "10.011214"], ["f1_640x480", "f2_640x480"], ["im_left", "im_right"]], ids=str
)
def test_paths_in_their_order_are_taken(tmp_path, names):
    paths = [tmp_path / f"{name}.png" for name in names]
    for path, frame in zip(paths, frames(2), strict=True):
        cv2.imwrite(str(path), frame)
    assert len(track(paths, Constant(), min_length=2))
