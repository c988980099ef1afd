"""Bundle adjustment and triangulation of rigid bodies on scenes of known cameras."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mseg.geometry import rigid

NOISE = 2e-4


def body(rng, *, points=60, frames=10, speed=(0.02, 0.005, 0.05), turn=0.004, depths=(0.2, 1.0)):
    """Images (n, F, 2) of random points in front of a moving camera, with noise."""
    rays = np.column_stack([rng.uniform(-0.5, 0.5, points), rng.uniform(-0.2, 0.2, points), np.ones(points)])
    inverse = rng.uniform(*depths, points)
    images = []
    for frame in range(frames):
        rotation = Rotation.from_rotvec([0, turn * frame, 0]).as_matrix()
        seen = rays @ rotation.T - inverse[:, None] * np.array(speed) * frame
        images.append(seen[:, :2] / seen[:, 2:])
    return np.stack(images, axis=1) + rng.normal(0, NOISE, (points, frames, 2))


def rms(cameras, image):
    _, residual = rigid.triangulate(cameras, image)
    return np.sqrt(residual / np.maximum(np.isfinite(image[..., 0]).sum(axis=1), 1))


def adjust(image, rng):
    return rigid.adjust(image, rng, noise=NOISE)


def test_a_body_explains_its_own_trajectories_and_no_others():
    rng = np.random.default_rng(0)
    first, second = body(rng), body(rng, speed=(-0.04, 0.0, 0.02), turn=-0.006)
    for own, other in ((first, second), (second, first)):
        cameras = adjust(own, rng)
        assert np.median(rms(cameras, own)) < 2 * NOISE
        assert np.median(rms(cameras, other)) > 20 * NOISE


def test_motion_along_the_epipolar_line_stands_out_over_many_frames():
    # The car ahead drives where the camera drives, at half its speed: each pair of frames has one epipolar
    # geometry for both, but no depth puts the car's points where they are in all frames.
    rng = np.random.default_rng(1)
    scene = body(rng, speed=(0, 0, 0.1), turn=0.0)
    inverse = rng.uniform(0.3, 0.5, 12)
    rays = np.column_stack([rng.uniform(-0.1, 0.1, (12, 2)), np.ones(12)])
    speeds = 0.1 * np.arange(10) - 0.008 * np.arange(10) ** 2
    car = np.stack([rays[:, :2] / (1 - inverse * s)[:, None] for s in speeds], axis=1)
    assert np.median(rms(adjust(scene, rng), car)) > 10 * NOISE


def test_outliers_do_not_move_the_cameras():
    rng = np.random.default_rng(2)
    image = body(rng)
    image[:15] = body(rng, speed=(0.05, 0.03, 0.0), points=15)
    assert np.median(rms(adjust(image, rng), image[15:])) < 2 * NOISE


@pytest.mark.parametrize("axis", [(0, 1, 0), (0.4, 0.9, 0.2)])
def test_a_body_that_turns_far_before_the_camera(axis):
    # From cameras that do not move the descent ends beside a turn of 70 degrees.
    rng = np.random.default_rng(5)
    shape = rng.uniform(-0.25, 0.25, (60, 3))
    unit = np.array(axis) / np.linalg.norm(axis)
    images = []
    for frame in range(10):
        seen = shape @ Rotation.from_rotvec(np.radians(7.8) * frame * unit).as_matrix().T + [0.1, 0, 1.5]
        images.append(seen[:, :2] / seen[:, 2:])
    image = np.stack(images, axis=1) + rng.normal(0, NOISE, (60, 10, 2))
    assert np.median(rms(adjust(image, rng), image)) < 2 * NOISE


@pytest.mark.parametrize("hidden", [0.3, 0.5])
def test_trajectories_with_gaps(hidden):
    rng = np.random.default_rng(3)
    image = body(rng)
    image[rng.random((60, 10)) < hidden] = np.nan
    cameras = adjust(image, rng)
    points, _ = rigid.triangulate(cameras, image)
    assert points.shape == (60, 3)
    assert np.isfinite(points).all()
    assert np.median(rms(cameras, image)) < 2 * NOISE


def test_cameras_are_rotations():
    rng = np.random.default_rng(4)
    rotation = adjust(body(rng), rng)[:, :, :3]
    product = rotation @ rotation.swapaxes(1, 2)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=1e-9)


@pytest.mark.parametrize("length", [0.6, 1.1, 2.1])
def test_bodies_cost_least_under_their_focal_length(length):
    rng, lengths = np.random.default_rng(5), (0.6, 0.8, 1.1, 1.5, 2.1)
    images = [length * body(rng, points=32, turn=0.03), length * body(rng, points=32, turn=-0.02)]
    costs = rigid.focal_costs(images, rng, noise=length * NOISE, lengths=lengths)
    assert costs.shape == (2, 5)
    assert lengths[costs.sum(axis=0).argmin()] == length
