"""Bundle adjustment and triangulation of rigid bodies on scenes of known cameras."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mseg.geometry import rigid

NOISE = 2e-4


def body(rng, *, points=60, frames=10, speed=(0.02, 0.005, 0.05), turn=0.004, depths=(0.2, 1.0)):
    """Images (F, n, 2) of random points in front of a moving camera, with noise."""
    rays = np.column_stack([rng.uniform(-0.5, 0.5, points), rng.uniform(-0.2, 0.2, points), np.ones(points)])
    inverse = rng.uniform(*depths, points)
    images = []
    for frame in range(frames):
        rotation = Rotation.from_rotvec([0, turn * frame, 0]).as_matrix()
        seen = rays @ rotation.T - inverse[:, None] * np.array(speed) * frame
        images.append(seen[:, :2] / seen[:, 2:])
    return np.array(images) + rng.normal(0, NOISE, (frames, points, 2))


def rms(residual, visible):
    return np.sqrt(residual / np.maximum(visible.sum(axis=0), 1))


def test_a_body_explains_its_own_trajectories_and_no_others():
    rng = np.random.default_rng(0)
    first, second = body(rng), body(rng, speed=(-0.04, 0.0, 0.02), turn=-0.006)
    image, visible = np.stack([first, second]), np.ones((2, 10, 60), dtype=bool)
    cameras, cost = rigid.adjust(image, visible, rng, noise=NOISE)
    assert cost.shape == (2,)
    both = np.concatenate([first, second], axis=1)
    _, residual = rigid.triangulate(cameras, both, np.ones((10, 120), dtype=bool))
    spread = rms(residual, np.ones((10, 120)))
    for k, own in enumerate((slice(0, 60), slice(60, 120))):
        other = slice(60, 120) if k == 0 else slice(0, 60)
        assert np.median(spread[k, own]) < 2 * NOISE
        assert np.median(spread[k, other]) > 20 * NOISE


def test_motion_along_the_epipolar_line_stands_out_over_many_frames():
    # The car ahead drives where the camera drives, at half its speed: each pair of frames has one epipolar
    # geometry for both, but no depth puts the car's points where they are in all frames.
    rng = np.random.default_rng(1)
    scene = body(rng, speed=(0, 0, 0.1), turn=0.0)
    inverse = rng.uniform(0.3, 0.5, 12)
    rays = np.column_stack([rng.uniform(-0.1, 0.1, (12, 2)), np.ones(12)])
    speeds = 0.1 * np.arange(10) - 0.008 * np.arange(10) ** 2
    car = np.array([rays[:, :2] / (1 - inverse * s)[:, None] for s in speeds])
    cameras, _ = rigid.adjust(scene[None], np.ones((1, 10, 60), dtype=bool), rng, noise=NOISE)
    _, residual = rigid.triangulate(cameras, car, np.ones((10, 12), dtype=bool))
    assert np.median(rms(residual[0], np.ones((10, 12)))) > 10 * NOISE


def test_outliers_do_not_move_the_cameras():
    rng = np.random.default_rng(2)
    image = body(rng)
    image[:, :15] = body(rng, speed=(0.05, 0.03, 0.0), points=15)
    cameras, _ = rigid.adjust(image[None], np.ones((1, 10, 60), dtype=bool), rng, noise=NOISE)
    _, residual = rigid.triangulate(cameras, image[:, 15:], np.ones((10, 45), dtype=bool))
    assert np.median(rms(residual[0], np.ones((10, 45)))) < 2 * NOISE


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
    image = np.array(images) + rng.normal(0, NOISE, (10, 60, 2))
    cameras, _ = rigid.adjust(image[None], np.ones((1, 10, 60), dtype=bool), rng, noise=NOISE)
    _, residual = rigid.triangulate(cameras, image, np.ones((10, 60), dtype=bool))
    assert np.median(rms(residual[0], np.ones((10, 60)))) < 2 * NOISE


@pytest.mark.parametrize("hidden", [0.3, 0.5])
def test_trajectories_with_gaps(hidden):
    rng = np.random.default_rng(3)
    image = body(rng)
    visible = rng.random((10, 60)) > hidden
    cameras, _ = rigid.adjust(image[None], visible[None], rng, noise=NOISE)
    points, residual = rigid.triangulate(cameras, np.where(visible[..., None], image, 1e6), visible)
    assert points.shape == (1, 60, 3)
    assert np.isfinite(points).all()
    assert np.median(rms(residual[0], visible)) < 2 * NOISE


def test_cameras_are_rotations():
    rng = np.random.default_rng(4)
    cameras, _ = rigid.adjust(body(rng)[None], np.ones((1, 10, 60), dtype=bool), rng, noise=NOISE)
    product = cameras.rotation @ cameras.rotation.swapaxes(-1, -2)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(cameras.rotation), 1, atol=1e-9)
