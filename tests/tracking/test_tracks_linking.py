"""One step of the tracker, and each of its stops by itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from kt3dmoseg.flow import sample
from kt3dmoseg.tracking import TrackOptions
from kt3dmoseg.tracking.linking import at_boundary, consistent, inside, step

SHAPE = (48, 64)
DEFAULT = TrackOptions()


def constant(motion, shape=SHAPE):
    return np.broadcast_to(np.float32(motion), (*shape, 2)).copy()


@given(
    motion=st.tuples(st.floats(-5, 5), st.floats(-5, 5)),
    start=st.tuples(st.floats(10, 50), st.floats(10, 35)),
)
def test_constant_flow_moves_every_point_alike(motion, start):
    forward = constant(motion)
    target, alive = step(np.array([start]), forward, -forward, DEFAULT)
    np.testing.assert_allclose(target, np.add([start], np.float32(motion)), atol=1e-12)
    assert alive.all()


def test_sampling_agrees_with_scipy(rng):
    field = rng.normal(size=(*SHAPE, 2)).astype(np.float32)
    xy = rng.uniform(0, [SHAPE[1] - 1, SHAPE[0] - 1], size=(200, 2))
    wanted = [map_coordinates(field[..., c].astype(float), xy[:, ::-1].T, order=1) for c in (0, 1)]
    np.testing.assert_allclose(sample(field, xy), np.stack(wanted, axis=1), atol=1e-6)
    np.testing.assert_allclose(sample(field[..., 0], xy), wanted[0], atol=1e-6)


def test_sampling_at_pixel_centres_and_beyond_the_edge():
    field = np.arange(12.0).reshape(3, 4)
    np.testing.assert_array_equal(sample(field, [[0, 0], [3, 2], [1, 1]]), [0, 11, 5])
    np.testing.assert_array_equal(sample(field, [[-5, 0], [9, 9]]), [0, 11])
    assert sample(field, np.zeros((0, 2))).shape == (0,)


def test_a_pixel_ends_half_a_pixel_from_its_centre():
    xy = np.array([[-0.5, 0], [-0.51, 0], [63.5, 47.5], [63.51, 0], [0, 47.51]])
    assert inside(xy, SHAPE).tolist() == [True, False, True, False, False]


def test_leaving_the_frame_stops_a_track():
    forward = constant((6.0, 0.0))
    _, alive = step(np.array([[57.0, 20.0], [58.0, 20.0]]), forward, -forward, DEFAULT)
    assert alive.tolist() == [True, False]


@pytest.mark.parametrize(
    ("back", "goes_on"),
    [
        ((-10.0, 0.0), True),
        ((-8.5, 0.0), True),  # gap 2.25 < 0.01 (100 + 72.25) + 0.5 = 2.2225 is false by little: see below
        ((-8.4, 0.0), False),
        ((10.0, 0.0), False),
    ],
)
def test_consistency_follows_its_formula(back, goes_on):
    w, w_back = np.array([[10.0, 0.0]]), np.array([back])
    gap = (10.0 + back[0]) ** 2
    allowed = 0.01 * (100.0 + back[0] ** 2) + 0.5
    assert consistent(w, w_back, DEFAULT).item() == (gap < allowed)
    if abs(gap - allowed) > 0.1:
        assert (gap < allowed) == goes_on


def test_disagreement_stops_only_where_it_is():
    forward = constant((4.0, 0.0))
    backward = -forward
    backward[:, 40:] = 0
    _, alive = step(np.array([[20.0, 20.0], [44.0, 20.0]]), forward, backward, DEFAULT)
    assert alive.tolist() == [True, False]


def test_a_jump_of_the_flow_stops_tracks_near_it_only():
    forward = constant((1.0, 0.0))
    forward[:, 32:] = (3.0, 0.0)
    xy = np.array([[10.0, 20.0], [31.0, 20.0], [32.0, 20.0], [34.0, 20.0]])
    w = sample(forward, xy)
    assert at_boundary(xy, w, forward, DEFAULT).tolist() == [False, True, True, False]


def test_boundary_scales_with_the_motion():
    ramp = np.zeros((*SHAPE, 2), np.float32)
    ramp[..., 0] = 0.08 * np.arange(SHAPE[1])  # gradient squared 0.0064: 0.0006 x |w|^2 + 0.002 at x = 8
    xy = np.array([[2.0, 20.0], [40.0, 20.0]])
    assert at_boundary(xy, sample(ramp, xy), ramp, DEFAULT).tolist() == [True, False]


def test_unknown_flow_stops_a_track():
    forward = constant((1.0, 0.0))
    forward[20, 20] = np.nan
    _, alive = step(np.array([[20.0, 20.0], [40.0, 30.0]]), forward, constant((-1.0, 0.0)), DEFAULT)
    assert alive.tolist() == [False, True]


def test_no_points():
    target, alive = step(np.zeros((0, 2)), constant((1, 0)), constant((-1, 0)), DEFAULT)
    assert target.shape == (0, 2)
    assert alive.shape == (0,)
