"""Registration with the start's patch: what is recovered, and what is left alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kt3dmoseg.tracking import TrackOptions
from kt3dmoseg.tracking.appearance import Appearance, Window, doubled

OPTIONS = TrackOptions(anchor=1.0)
SHAPE = (64, 96)
CENTRE = np.array([48.0, 32.0])
POINTS = np.array([[30.0, 20.0], [48.0, 32.0], [61.5, 40.25]])
STILL = np.zeros((*SHAPE, 2), np.float32)


def texture(x, y):
    """Gray values of a smooth texture, at any point."""
    waves = np.sin(0.7 * x + 0.3 * y) + np.sin(0.5 * y - 0.45 * x + 1) + np.sin(0.8 * y + 0.2 * x + 2)
    return 128 + 25 * waves + 10 * np.sin(0.13 * x * y / 8)


def picture(shift=(0.0, 0.0), zoom=1.0, gain=1.0, add=0.0):
    """The texture moved by `shift` and then enlarged about `CENTRE`, (H, W) float32."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    x, y = (x - CENTRE[0]) / zoom + CENTRE[0] - shift[0], (y - CENTRE[1]) / zoom + CENTRE[1] - shift[1]
    return (gain * texture(x, y) + add).astype(np.float32)


def gray(image):
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def looking_at(image, xy, options=OPTIONS):
    looks = Appearance(options)
    looks.look_at(image)
    looks.add(xy)
    return looks


def moved(looks, image, target, times=3):
    """Where points are found, when as many frames show the same."""
    looks.look_at(image)
    for _ in range(times):
        target, _ = looks.follow(STILL, target, target, np.ones(len(target), bool))
    return target


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, -0.3), (-0.7, 0.6)])
def test_a_drift_below_a_pixel_is_taken_back(shift):
    looks = looking_at(gray(picture()), POINTS, TrackOptions(anchor=1.5))
    found = moved(looks, gray(picture(shift)), POINTS, times=6)
    np.testing.assert_allclose(found, POINTS + shift, atol=0.02)


def test_a_share_of_the_correction_is_applied():
    after = gray(picture((0.6, 0.4)))
    whole, half = (
        moved(
            looking_at(gray(picture()), POINTS, TrackOptions(anchor=1.5, anchor_gain=gain)), after, POINTS, 1
        )
        for gain in (1.0, 0.5)
    )
    assert (whole - POINTS > (0.2, 0.15)).all()
    np.testing.assert_allclose(half - POINTS, (whole - POINTS) / 2, atol=1e-9)


def test_gain_and_brightness_do_not_pull():
    looks = looking_at(gray(picture()), POINTS)
    found = moved(looks, gray(picture((0.3, 0.2), gain=0.8, add=30)), POINTS, times=6)
    np.testing.assert_allclose(found - POINTS, [(0.3, 0.2)] * 3, atol=0.03)


def test_an_enlarged_patch_is_followed_by_its_affine_map():
    zoom = 1.1
    truth = (POINTS - CENTRE) * zoom + CENTRE
    looks = looking_at(gray(picture()), POINTS, TrackOptions(anchor=1.0, anchor_stiffness=0.0))
    found = moved(looks, gray(picture(zoom=zoom)), truth + 0.3, times=10)
    np.testing.assert_allclose(found, truth, atol=0.02)
    np.testing.assert_allclose(looks._affine, [zoom * np.eye(2)] * 3, atol=0.01)


def test_the_flow_carries_the_map_along():
    zoom = 1.04
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    flow = (zoom - 1) * np.stack([x - CENTRE[0], y - CENTRE[1]], axis=2).astype(np.float32)
    looks = looking_at(gray(picture()), POINTS)
    xy = POINTS
    for step in range(1, 7):
        target = (xy - CENTRE) * zoom + CENTRE + (0.2, -0.1)  # the flow is wrong by so much in every step
        looks.look_at(gray(picture(zoom=zoom**step)))
        xy, _ = looks.follow(flow, xy, target, np.ones(len(xy), bool))
    np.testing.assert_allclose(xy, (POINTS - CENTRE) * zoom**6 + CENTRE, atol=0.05)


def test_what_covers_half_of_the_patch_hardly_pulls():
    options = TrackOptions(anchor=1.0, anchor_change=4.0)
    looks = looking_at(gray(picture()), POINTS[1:2], options)
    after = picture((0.4, 0.1))
    after[:, 52:] = 250 - after[:, 52:]
    found = moved(looks, gray(after), POINTS[1:2], times=6)
    np.testing.assert_allclose(found, [[48.4, 32.1]], atol=0.15)


def test_flat_patches_and_patches_that_are_gone_stay_where_the_flow_leads(rng):
    flat = np.full(SHAPE, 120, np.uint8)
    np.testing.assert_array_equal(moved(looking_at(flat, POINTS), flat, POINTS + 0.3), POINTS + 0.3)
    other = gray(255 * rng.random(SHAPE))
    np.testing.assert_array_equal(moved(looking_at(gray(picture()), POINTS), other, POINTS), POINTS)


@given(
    st.lists(
        st.tuples(st.floats(-0.5, 95.5), st.floats(-0.5, 63.5), st.floats(-9, 9), st.floats(-9, 9)),
        min_size=1,
        max_size=20,
    ),
    st.floats(0.01, 3),
    st.integers(0, 9),
)
def test_no_correction_is_larger_than_allowed_or_leaves_the_frame(rows, limit, seed):
    rows = np.array(rows)
    xy, target = rows[:, :2], np.clip(rows[:, :2] + rows[:, 2:], -0.5, np.array([95.5, 63.5]))
    rng = np.random.default_rng(seed)
    frames = gray(picture()), gray(picture((0.5, 0.5)) + 8 * rng.standard_normal(SHAPE))
    flow = rng.normal(0, 2, (*SHAPE, 2)).astype(np.float32)
    flow[rng.random(SHAPE) < 0.05] = np.nan
    looks = looking_at(frames[0], xy, TrackOptions(anchor=limit, anchor_change=1e9))
    looks.look_at(frames[1])
    found, alike = looks.follow(flow, xy, target, np.ones(len(xy), bool))
    assert np.isfinite(found).all()
    assert (np.linalg.norm(found - target, axis=1) <= limit + 1e-9).all()
    assert (found >= -0.5).all()
    assert (found <= (95.5, 63.5)).all()
    assert alike.all()


def test_many_points_give_what_single_points_give(rng):
    xy = rng.uniform((0, 0), (95, 63), (700, 2))
    after = gray(picture((0.4, -0.2)))
    every = moved(looking_at(gray(picture()), xy), after, xy)
    again = moved(looking_at(gray(picture()), xy), after, xy)
    np.testing.assert_array_equal(every, again)
    for row in (0, 255, 256, 699):
        alone = moved(looking_at(gray(picture()), xy[row : row + 1]), after, xy[row : row + 1])
        np.testing.assert_allclose(alone[0], every[row], atol=1e-6)


def test_a_start_has_its_slopes():
    y, x = np.mgrid[:30, :40].astype(float)
    window, xy = Window(2), np.array([[12.0, 10.0], [20.25, 15.5]])
    value, along_x, along_y = window.start(doubled(gray(40 + 3 * x + 2 * y)), xy).swapaxes(0, 1)
    wanted = 40 + 3 * (xy[:, :1] + window.lattice[0]) + 2 * (xy[:, 1:] + window.lattice[1])
    np.testing.assert_allclose(value, wanted, atol=0.01)
    np.testing.assert_allclose(along_x, 3, atol=0.01)
    np.testing.assert_allclose(along_y, 2, atol=0.01)


def test_the_equations_are_those_of_the_eight_slopes(rng):
    options, window = TrackOptions(anchor_stiffness=50.0), Window(3)
    patch = rng.normal(0, 20, (70, 3, len(window.weight))).astype(np.float32)
    known = window.prepare(patch.copy(), options)
    value, dx, dy = patch[69].astype(float)
    value -= value @ window.weight
    x, y, one = window.lattice
    slopes = np.stack([dx * x, dx * y, dx, dy * x, dy * y, dy, value, one])
    normal = (slopes * window.weight) @ slopes.T + np.diag([50, 50, 0, 50, 50, 0, 0, 0])
    np.testing.assert_allclose(known.inverse[69], np.linalg.inv(normal)[:6, :6], rtol=0.01, atol=1e-6)
    np.testing.assert_allclose(known.variance[69], value**2 @ window.weight, rtol=1e-4)


def test_a_doubled_ramp_is_a_ramp():
    ramp = np.add.outer(2 * np.arange(40), 3 * np.arange(50)).astype(np.uint8)
    fine = doubled(ramp)
    assert fine.shape == (80, 100)
    wanted = np.add.outer(np.arange(80), 1.5 * np.arange(100))
    np.testing.assert_allclose(fine[10:-10, 10:-10], wanted[10:-10, 10:-10], atol=2e-2)


def test_a_doubled_frame_holds_the_frame(rng):
    frame = rng.integers(0, 255, (40, 50), dtype=np.uint8)
    np.testing.assert_allclose(doubled(frame)[::2, ::2], frame, atol=0.2)


def test_the_weights_of_a_window_fall_off_and_sum_to_one():
    window = Window(5)
    assert window.weight.sum() == pytest.approx(1, abs=1e-6)
    away = np.hypot(*window.lattice[:2])
    assert away.max() <= 5.5
    order = np.argsort(away)
    assert (np.diff(window.weight[order]) <= 1e-7).all()
