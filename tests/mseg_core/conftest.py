from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from kt3dmoseg.types import Clip, Labels, Trajectories

# Rotation per frame (radians), translation per frame (scene units).
_MOTIONS = ((0.01, (0.10, 0.0, 0.05)), (-0.05, (-0.3, 0.05, 0.0)), (0.06, (0.2, -0.2, 0.1)))


def rigid_clip(
    points: int = 20,
    motions: int = 2,
    frames: int = 6,
    noise: float = 0.05,
    missing: float = 0.0,
    seed: int = 0,
) -> Clip:
    """Boxes of points that turn and move on their own, seen by a pinhole camera."""
    rng = np.random.default_rng(seed)
    tracks = [_seen_by_camera(rng, points, frames, motion) for motion in range(motions)]
    xy = np.concatenate(tracks) + rng.normal(scale=noise, size=(points * motions, frames, 2))
    visible = rng.random(xy.shape[:2]) >= missing
    xy[~visible] = np.nan
    labels = Labels(np.repeat(np.arange(1, motions + 1), points))
    return Clip("tiny", Trajectories(xy, visible, image_size=(640, 480)), np.arange(len(xy)), labels)


def _seen_by_camera(rng, points, frames, motion):
    angle, step = _MOTIONS[motion]
    body = rng.uniform(-1, 1, size=(points, 3)) + np.array([2.0 * motion - 1.5, 0.5 * motion, 8.0])
    centre = body.mean(axis=0)
    out = np.empty((points, frames, 2))
    for f in range(frames):
        c, s = np.cos(angle * f), np.sin(angle * f)
        turned = (body - centre) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) + centre + f * np.array(step)
        out[:, f] = 500 * turned[:, :2] / turned[:, 2:] + (320, 240)
    return out


@pytest.fixture(scope="session")
def make_clip() -> Callable[..., Clip]:
    return rigid_clip


@pytest.fixture(scope="session")
def clip_of() -> Callable[..., Clip]:
    """Make a clip of positions (N, F, 2), NaN where invisible."""

    def make(xy: np.ndarray) -> Clip:
        visible = np.isfinite(xy).all(axis=2)
        return Clip("made", Trajectories(xy, visible), np.arange(len(xy)), Labels(np.ones(len(xy), int)))

    return make
