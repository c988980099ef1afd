"""The stop by appearance."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from kt3dmoseg.tracking import RELIABLE, TrackOptions, track
from kt3dmoseg.tracking.appearance import Appearance

OPTIONS = TrackOptions(appearance=0.8)
POINTS = np.array([[20.0, 20.0], [40.5, 30.25]])
SHIFT = np.array([5, 2])


@pytest.fixture
def picture(rng):
    noise = rng.integers(0, 255, (64, 96), dtype=np.uint8)
    return cv2.GaussianBlur(noise, (0, 0), 1.5)


def looking_at(frame, xy):
    looks = Appearance(OPTIONS)
    looks.look_at(frame)
    looks.add(xy)
    return looks


def alike(looks, frame, xy):
    looks.look_at(frame)
    still = np.zeros((*frame.shape, 2), np.float32)
    found, result = looks.follow(still, xy, xy, np.ones(len(xy), bool))
    np.testing.assert_array_equal(found, xy)  # without `anchor` nothing moves
    return result


def test_what_moved_rigidly_looks_alike(picture):
    moved = np.roll(picture, (2, 5), axis=(0, 1))
    looks = looking_at(picture, POINTS)
    assert alike(looks, moved, POINTS + SHIFT).all()
    assert not alike(looks, moved, POINTS - SHIFT).any()


def test_brightness_and_faint_noise_do_not_count(picture, rng):
    looks = looking_at(picture, POINTS)
    assert alike(looks, (picture // 2 + 90).astype(np.uint8), POINTS).all()
    flat = np.full_like(picture, 120)
    noisy = np.rint(120 + 1.5 * rng.standard_normal(picture.shape)).astype(np.uint8)
    assert alike(looking_at(flat, POINTS), noisy, POINTS).all()


def test_the_living_keep_their_own_start(picture):
    looks = looking_at(picture, POINTS)
    looks.follow(np.zeros((*picture.shape, 2), np.float32), POINTS, POINTS, np.array([False, True]))
    looks.add(POINTS[[0, 1, 0]])  # more than have ended
    assert alike(looks, picture, POINTS[[1, 0, 1, 0]]).all()
    assert not alike(looks, picture, POINTS[[0, 1, 0, 1]]).any()


def constant(a, b):
    """Three pixels to the right, and back; frames are numbered in their first pixel."""
    sign = 1 if b[0, 0] > a[0, 0] else -1
    return np.broadcast_to(np.float32((3 * sign, 0)), (*a.shape, 2)).copy()


def clip(picture, shift):
    frames = [np.roll(picture, shift * k, axis=1) for k in range(6)]
    for number, frame in enumerate(frames):
        frame[0, 0] = number
    return frames


def test_the_tracker_stops_where_the_flow_is_wrong_and_only_when_asked(picture):
    seeds = np.c_[POINTS, [0, 0]]
    right, wrong = clip(picture, 3), clip(picture, 0)
    assert track(right, constant, seeds, appearance=0.8).visible.all()
    assert track(wrong, constant, seeds).visible.all()
    assert track(wrong, constant, seeds, appearance=0.8).lengths.max() < 4


def drifting(a, b):
    """As `constant`, but a quarter of a pixel too far."""
    sign = 1 if b[0, 0] > a[0, 0] else -1
    return np.broadcast_to(np.float32((3.25 * sign, 0)), (*a.shape, 2)).copy()


def test_the_tracker_does_not_drift_when_anchored(picture):
    seeds = np.c_[POINTS, [0, 0]]
    frames = clip(picture, 3)
    plain, anchored = (track(frames, drifting, seeds, anchor=limit) for limit in (0.0, 1.0))
    np.testing.assert_allclose(plain.xy[:, 5], np.add(POINTS, (16.25, 0)), atol=1e-6)
    np.testing.assert_allclose(anchored.xy[:, 5], np.add(POINTS, (15, 0)), atol=0.05)


def test_tracks_to_rely_on_by_one_name(picture):
    seeds = np.c_[POINTS, [0, 0]]
    right, wrong = clip(picture, 3), clip(picture, 0)
    assert track(right, drifting, seeds, reliable=True, consistency_floor=0.3).visible.all()
    assert track(wrong, constant, seeds, reliable=True).lengths.max() < 4
    assert track(wrong, constant, seeds, reliable=True, anchor=0, appearance=0).visible.all()
    assert track(wrong, constant, seeds, reliable=False).visible.all()
    by_word, by_values = track(right, drifting, reliable=True), track(right, drifting, **RELIABLE)
    np.testing.assert_array_equal(by_word.xy, by_values.xy)
