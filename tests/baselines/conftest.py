"""Affine scenes: trajectories on known subspaces."""

from __future__ import annotations

import numpy as np
import pytest

from kt3dmoseg.types import Clip, Labels, Trajectories


def affine_scene(
    rng: np.random.Generator,
    sizes: tuple[int, ...],
    n_frames: int = 12,
    noise: float = 0.0,
    missing: float = 0.0,
) -> Clip:
    """Rigid bodies of `sizes` points under an affine camera, some points unseen at the ends."""
    blocks = []
    for size in sizes:
        shape = np.vstack([rng.normal(size=(3, size)) * 60, np.ones(size)])
        drift = np.cumsum(rng.normal(size=(n_frames, 2, 4)) * (0.15, 0.15, 0.15, 6.0), axis=0)
        motion = rng.normal(size=(2, 4)) * (1, 1, 1, 40) + drift
        blocks.append(np.einsum("fij,jn->nfi", motion, shape))
    xy = np.concatenate(blocks) + 300
    xy += noise * rng.normal(size=xy.shape)
    visible = np.ones(xy.shape[:2], dtype=bool)
    for row in np.flatnonzero(rng.random(len(xy)) < missing):
        first = rng.integers(0, n_frames - 7)
        visible[row] = False
        visible[row, first : first + rng.integers(7, n_frames - first + 1)] = True
    xy[~visible] = np.nan
    labels = Labels(np.repeat(np.arange(1, len(sizes) + 1), sizes))
    trajectories = Trajectories(xy, visible, image_size=(640, 480))
    return Clip("scene", trajectories, np.arange(len(xy)), labels)


@pytest.fixture
def make_scene():
    return affine_scene
