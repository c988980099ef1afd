"""Ray casting, patterns and motion, each against a slow or closed-form answer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kt3dmoseg.synthetic.materials import _TABLE, Noise, Patch, Plain, _cells, _mosaic, band, stripes
from kt3dmoseg.synthetic.render import SKY, Mesh, box, cast, expose, gather, ray_offsets, respond
from kt3dmoseg.synthetic.vehicles import Drive

GREY = Plain(100.0)


def test_a_box_straight_ahead_has_the_expected_depth_and_outline():
    mesh = Mesh.of(box((-1, -1, 4), (1, 1, 6), GREY))
    x = np.linspace(-0.5, 0.5, 101)
    depth, face = cast(mesh, x[None], x[:, None])
    inside = (np.abs(x[:, None]) <= 0.25) & (np.abs(x) <= 0.25)  # the front at z = 4 is 2 m wide
    assert np.array_equal(face != SKY, inside)
    assert np.allclose(depth[inside], 4.0)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_convex_bodies_are_hit_where_the_half_spaces_say(seed):
    """Nearest hit of a closed convex body = where the ray enters all its half-spaces (slab method)."""
    rng = np.random.default_rng(seed)
    low, size = rng.uniform([-4, -3, 2], [2, 1, 9]), rng.uniform(0.5, 3, 3)
    inset = tuple(rng.uniform(-0.2, 0.2, 3))
    faces = box(low, low + size, GREY, inset, floor=Plain(50.0))
    mesh = Mesh.of(faces)
    x, y = rng.uniform(-1, 1, (2, 200))
    depth, face = cast(mesh, x, y)
    normals = np.cross(mesh.eu, mesh.ev)
    direction = np.stack([x, y, np.ones(200)])
    along, offset = normals @ direction, np.einsum("fi,fi->f", normals, mesh.origin)[:, None]
    with np.errstate(divide="ignore"):
        at = offset / along
    enter = np.where(along < 0, at, -np.inf).max(axis=0)
    leave = np.where(along > 0, at, np.inf).min(axis=0)
    clear = np.abs(enter - leave) > 1e-6
    hit = (enter < leave) & (enter > 0.1)
    assert np.array_equal((face != SKY)[clear], hit[clear])
    assert np.allclose(depth[hit & clear], enter[hit & clear])


def test_grid_and_points_agree(scene):
    mesh, (x, y) = scene._mesh_at(2), scene._pixels()
    depth, face = cast(mesh, x, y)
    flat_depth, flat_face = cast(mesh, *(part.ravel() for part in np.broadcast_arrays(x, y)))
    assert np.array_equal(depth.ravel(), flat_depth)
    assert np.array_equal(face.ravel(), flat_face)


@given(st.floats(-20, 20), st.floats(0.5, 5), st.floats(-3, 3), st.floats(0.05, 0.95), st.floats(0.01, 12))
def test_stripes_are_the_mean_of_the_indicator(x, period, start, share, width):
    samples = x + width * ((np.arange(20_000) + 0.5) / 20_000 - 0.5)
    inside = np.mod(samples - start, period) < share * period
    got = stripes(np.array([x]), period, start, share * period, np.array([width]))[0]
    assert got == pytest.approx(inside.mean(), abs=2e-3)


def test_band_is_the_mean_of_the_indicator():
    x = np.array([-1.0, 0.0, 0.5, 1.0, 3.0])
    assert band(x, 0.0, 1.0, np.full(5, 0.5)).tolist() == [0.0, 0.5, 1.0, 0.5, 0.0]
    assert band(np.array([0.5]), 0.0, 1.0, np.array([4.0]))[0] == pytest.approx(0.25)


def test_noise_is_periodic_normalised_and_fades_with_distance():
    noise = Noise(np.random.default_rng(1), 1.0)
    rng = np.random.default_rng(2)
    u, v = rng.uniform(-50, 50, (2, 4000))
    sharp = np.full(4000, 1e-4)
    near = noise.sample(u, v, sharp, sharp, 4.0)
    assert near.std() == pytest.approx(1.0, rel=0.15)
    assert np.allclose(near, noise.sample(u + 4.0, v - 8.0, sharp, sharp, 4.0), atol=1e-3)
    spreads = [noise.sample(u, v, sharp * 10**k, sharp * 10**k, 4.0).std() for k in (0, 3, 4, 5)]
    assert spreads == sorted(spreads, reverse=True)
    assert spreads[-1] < 1e-3


def test_a_drive_moves_at_its_speed_and_turns_at_its_rate():
    drive = Drive(1.0, 2.0, yaw=0.3, speed=8.0, yaw_rate=0.1)
    step = 1e-4
    before, now, after = drive.pose(-step), drive.pose(0.0), drive.pose(step)
    assert now[:3, 3].tolist() == [1.0, 0.0, 2.0]
    velocity = (after - before)[:3, 3] / (2 * step)
    assert np.allclose(velocity, 8.0 * np.array([np.sin(0.3), 0, np.cos(0.3)]), atol=1e-4)
    heading = [np.arctan2(pose[0, 2], pose[2, 2]) for pose in (before, after)]
    assert (heading[1] - heading[0]) / (2 * step) == pytest.approx(0.1, rel=1e-3)
    assert Drive(0.0, 0.0, speed=5.0).pose(2.0)[:3, 3].tolist() == [0.0, 0.0, 10.0]


@given(st.floats(0, 30), st.floats(-0.5, 0.5), st.floats(-60, 60))
def test_a_drive_keeps_to_its_lane(speed, rate, time):
    assert abs(Drive(0.0, 0.0, speed=speed, yaw_rate=rate).pose(time)[0, 3]) <= 1.2 + 1e-9


def test_a_mosaic_is_the_mean_of_its_cells():
    noise = Noise(np.random.default_rng(0), 1.0)
    rng = np.random.default_rng(3)
    size, width, steps = (2.3, 5.9), (0.7, 1.9), (np.arange(400) + 0.5) / 400 - 0.5
    for _ in range(20):
        u, v = rng.uniform(-30, 30, 2)
        one = Patch(*(np.array([x]) for x in (u, v, *width)), noise, noise)
        across, along = np.meshgrid((u + width[0] * steps) / size[0], (v + width[1] * steps) / size[1])
        expected = _cells(across.ravel(), along.ravel(), 4.0, _TABLE).mean()
        assert _mosaic(one, size, 4.0)[0] == pytest.approx(expected, abs=0.01)


def test_a_far_mosaic_fades_to_its_mean():
    noise = Noise(np.random.default_rng(0), 1.0)
    u, v = np.random.default_rng(3).uniform(-100, 100, (2, 500))
    wide = np.full(500, 60.0)
    far = _mosaic(Patch(u, v, wide, wide, noise, noise), (2.3, 5.9), 4.0)
    assert np.abs(far - _TABLE.mean()).max() < 0.01


def gathered(light, samples, height=9, width=12):
    """What pixels see of a scene whose light is a function of x and y."""
    offsets = ray_offsets(samples)
    x, y = np.arange(-1.0, width + 1), np.arange(-1.0, height + 1)[:, None]
    return np.mean([gather(light(x + dx, y + dy), np.array([dx, dy])) for dx, dy in offsets], axis=0)


@pytest.mark.parametrize("samples", [1, 2, 3, 4])
def test_pixels_keep_a_linear_ramp(samples):
    image = gathered(lambda x, y: 3 * x + 2 * y + 100, samples)
    assert np.allclose(image, 3 * np.arange(12) + 2 * np.arange(9)[:, None] + 100)


@pytest.mark.parametrize("samples", [2, 3, 5])
@pytest.mark.parametrize("across", [True, False])
def test_edges_move_over_pixels_in_steps_of_one_ray(samples, across):
    """The summed light of a row of pixels gives the place of an edge, to 1 / samples^2 of a pixel."""
    for edge in np.random.default_rng(1).uniform(4, 6, 30):
        image = gathered(lambda x, y, at=edge: 1.0 * ((x if across else y) + 0 * (x + y) > at), samples)
        seen = (11.5 if across else 8.5) - image.sum(axis=int(across)).mean()
        assert abs(seen - edge) <= 0.5 / samples**2 + 1e-9


def test_the_response_keeps_order_and_saturates():
    light = np.linspace(-5, 260, 500)
    grey = respond(light)
    assert (np.diff(grey) >= 0).all()
    assert (grey[0], grey[-1]) == (0.0, 255.0)
    assert 60 < respond(np.array(92.0)) < 100
    dark, bright = (np.diff(respond(np.array([g, g + 1.0])))[0] for g in (40.0, 160.0))
    assert dark < 1 < bright


def test_noise_is_added_after_the_response():
    flat = expose(np.full((200, 200), 100.0), 2.0, np.random.default_rng(0)).astype(float)
    assert flat.std() == pytest.approx(2.0, rel=0.05)
    assert flat.mean() == pytest.approx(respond(np.array(100.0)), abs=0.1)
