"""Structure and the start cells."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from kt3dmoseg.flow import smooth
from kt3dmoseg.tracking import TrackOptions
from kt3dmoseg.tracking.linking import grid, new_seeds, smaller_eigenvalue, structured, uncovered

DEFAULT = TrackOptions()


def test_the_grid_of_a_kitti_frame():
    cells = grid(375, 1242, DEFAULT)
    assert cells[0].tolist() == [4, 4]
    assert cells[1].tolist() == [12, 4]
    assert cells.max(axis=0).tolist() == [1236, 364]
    assert len(cells) == 155 * 46


def test_covered_means_closer_than_the_radius_to_the_truncated_position():
    cell = grid(64, 64, DEFAULT).tolist().index([12, 12])
    live = {(20.0, 12.0): True, (20.9, 12.9): True, (19.99, 12.0): False, (6.4, 17.7): False, (6, 6): True}
    for position, free in live.items():
        assert uncovered(grid(64, 64, DEFAULT), np.array([position]), DEFAULT)[cell] == free, position


def test_no_live_track_covers_nothing():
    assert uncovered(grid(64, 64, DEFAULT), np.zeros((0, 2)), DEFAULT).all()


def test_eigenvalue_of_a_plane_wave_and_of_a_corner():
    x = np.arange(64)
    stripes = np.tile(np.uint8(128 + 60 * np.sin(x / 3)), (64, 1))
    assert np.abs(smaller_eigenvalue(stripes, 0.8, 1.0)).max() < 1e-2
    corner = np.zeros((64, 64), np.uint8)
    corner[32:, 32:] = 200
    peak = np.unravel_index(smaller_eigenvalue(corner, 0.8, 1.0).argmax(), corner.shape)
    assert np.abs(np.subtract(peak, 32)).max() <= 1


def test_eigenvalue_is_that_of_the_tensor(rng):
    frame = cv2.GaussianBlur(rng.integers(0, 255, (40, 50), dtype=np.uint8), (0, 0), 1)
    image = smooth(frame.astype(np.float32), 0.8)
    dy, dx = np.gradient(image)
    xx, xy, yy = (smooth(p.astype(np.float32), 1.0) for p in (dx * dx, dx * dy, dy * dy))
    tensors = np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)
    wanted = np.linalg.eigvalsh(tensors)[..., 0]
    got = smaller_eigenvalue(frame, 0.8, 1.0)
    np.testing.assert_allclose(got[12:-12, 12:-12], wanted[12:-12, 12:-12], rtol=1e-3, atol=1e-3)


def test_smoothing_keeps_constants_and_has_its_width():
    constant = np.full((40, 40), 7, np.float32)
    np.testing.assert_allclose(smooth(constant, 1.3), constant, rtol=1e-5)
    spike = np.zeros((81, 81), np.float32)
    spike[40, 40] = 1
    line = smooth(spike, 2.0).sum(axis=0)
    spread = np.sqrt((line * (np.arange(81) - 40) ** 2).sum() / line.sum())
    assert spread == pytest.approx(1.418 * 2.0, rel=0.02)
    assert smooth(spike, 0) is spike


def test_flat_frames_have_nothing_to_start_on(rng):
    half = np.full((96, 128), 100, np.uint8)
    half[:, 64:] = cv2.GaussianBlur(rng.integers(0, 255, (96, 64), dtype=np.uint8), (0, 0), 1.5)
    seeds = new_seeds(half, np.zeros((0, 2)), DEFAULT)
    assert len(seeds) > 20
    assert (seeds[:, 0] > 56).all()


def everywhere(frame, **options):
    """Whether each pixel is structured, (H, W)."""
    pixels = np.argwhere(np.ones(frame.shape))[:, ::-1]
    return structured(frame, pixels, TrackOptions(**options)).reshape(frame.shape)


@pytest.mark.parametrize("value", [0, 7, 100, 255])
def test_an_even_frame_has_no_structure(value):
    frame = np.full((96, 128), value, np.uint8)
    assert not everywhere(frame).any()
    frame[40, 60] = value ^ 1  # the least that a frame can hold
    assert everywhere(frame)[36:45, 56:65].any()


def test_the_border_requires_more_structure(rng):
    frame = cv2.GaussianBlur(rng.integers(0, 255, (96, 128), dtype=np.uint8), (0, 0), 1.5)
    with_border = everywhere(frame)
    without = everywhere(frame, border_gain=0.0)
    assert (with_border <= without).all()
    assert with_border[:4].mean() < without[:4].mean()
