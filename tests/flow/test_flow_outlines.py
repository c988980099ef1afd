"""Motion that has spread over an outline is taken back, and nothing else is touched."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from kt3dmoseg import flow
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.flow.pyramid import sharpen

SETTINGS = {name: getattr(flow.create("dis"), name) for name in ("reach", "share", "floor")}
GROUND, OBJECT = (0.0, 0.0), (7.0, 2.0)
WHERE = slice(40, 90), slice(60, 120)


def texture(seed, low, high, shape=(128, 192)):
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=shape), (0, 0), 1.2)
    return cv2.normalize(noise, None, low, high, cv2.NORM_MINMAX)


@pytest.fixture(scope="module")
def scene():
    """A bright rectangle moves over a dark ground at rest: both frames and the exact field."""
    ground, patch = texture(0, 10, 120), texture(1, 120, 240)
    frames = []
    for x, y in (GROUND, OBJECT):
        frame = ground.copy()
        rows, columns = (slice(s.start + int(m), s.stop + int(m)) for s, m in zip(WHERE, (y, x), strict=True))
        frame[rows, columns] = patch[WHERE]
        frames.append(
            np.clip(frame + np.random.default_rng(9).normal(0, 1.5, frame.shape), 0, 255).astype(np.uint8)
        )
    exact = np.zeros((*ground.shape, 2), np.float32)
    exact[WHERE] = OBJECT
    return *frames, exact


def wrong(field, exact, where):
    return (np.linalg.norm(field - exact, axis=2) > 1)[where].mean()


def test_motion_spread_over_an_outline_is_taken_back(scene):
    a, b, exact = scene
    spread = exact.copy()
    spread[35:95, 55:120] = OBJECT  # 5 px too far to the left, above and below: ground that stays visible
    ring = np.zeros(a.shape, bool)
    ring[35:95, 55:60] = True
    assert wrong(spread, exact, ring) == 1
    assert wrong(sharpen(a, b, spread, **SETTINGS), exact, ring) < 0.35


def test_an_object_gets_its_margin_back(scene):
    a, b, exact = scene
    eaten = exact.copy()
    eaten[40:90, 60:64] = GROUND
    ring = np.zeros(a.shape, bool)
    ring[44:86, 60:64] = True
    assert wrong(sharpen(a, b, eaten, **SETTINGS), exact, ring) < 0.2


def test_a_right_field_stays_as_it_is(scene):
    a, b, exact = scene
    covered = np.zeros(a.shape, bool)  # ground that the object hides in b has no right motion
    covered[40:95, 118:132] = covered[88:97, 60:132] = True
    changed = (sharpen(a, b, exact, **SETTINGS) != exact).any(axis=2)
    assert changed[~covered].mean() < 0.002


def test_small_errors_are_left_to_the_refinement(scene):
    a, b, exact = scene
    off = exact + np.float32(0.2)
    assert (sharpen(a, b, off, **SETTINGS) == off).mean() > 0.97


def test_the_field_given_is_not_written_to(scene):
    a, b, exact = scene
    spread = exact.copy()
    spread[35:95, 55:120] = OBJECT
    before = spread.copy()
    sharpen(a, b, spread, **SETTINGS)
    np.testing.assert_array_equal(spread, before)


def test_the_default_flow_gains_at_outlines(scene):
    a, b, exact = scene
    ring = np.zeros(a.shape, bool)
    ring[30:100, 50:120] = True
    ring[46:84, 66:114] = False
    plain, sharp = (flow.create("dis", reach=reach)(a, b) for reach in ((), SETTINGS["reach"]))
    assert wrong(sharp, exact, ring) < wrong(plain, exact, ring)


def test_a_distance_of_nothing_is_refused():
    with pytest.raises(InvalidValueError, match="reach"):
        flow.create("dis", reach=(0, 5))
