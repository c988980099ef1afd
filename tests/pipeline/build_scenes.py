"""Tiny clips on disk: a textured background that shifts and a patch that moves its own way."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

WIDTH, HEIGHT, FRAMES, SIDE = 96, 64, 6, 24


def texture(rng, height, width, sigma=1.0):
    smooth = gaussian_filter(rng.random((height, width)), sigma)
    return np.rint(255 * (smooth - smooth.min()) / np.ptp(smooth)).astype(np.uint8)


def patch_corner(frame):
    return 20 + 2 * frame % (WIDTH - SIDE - 20), 20


def scene(seed=0, frames=FRAMES):
    rng = np.random.default_rng(seed)
    background, patch = texture(rng, HEIGHT, WIDTH + frames, 1.2), texture(rng, SIDE, SIDE)
    for frame in range(frames):
        picture = background[:, frame : frame + WIDTH].copy()
        x, y = patch_corner(frame)
        picture[y : y + SIDE, x : x + SIDE] = patch
        yield picture


def write_clip(folder, seed=0, frames=FRAMES, first=1):
    folder.mkdir(parents=True, exist_ok=True)
    for number, picture in enumerate(scene(seed, frames), start=first):
        cv2.imwrite(str(folder / f"{number:06d}.png"), picture)
    return folder


def write_masks(folder, first=1, identity=1):
    folder.mkdir(parents=True, exist_ok=True)
    for frame in range(FRAMES):
        mask = np.zeros((HEIGHT, WIDTH), np.uint16 if identity > 255 else np.uint8)
        x, y = patch_corner(frame)
        mask[y : y + SIDE, x : x + SIDE] = identity
        cv2.imwrite(str(folder / f"{frame + first:06d}.png"), mask)
    return folder


def on_patch(tracks):
    """Whether each track lies clearly on the patch (1), clearly off it (0), or neither (-1)."""
    start = np.argmax(tracks.visible, axis=1)
    xy = tracks.xy[np.arange(len(tracks)), start]
    corner = np.array([patch_corner(frame) for frame in start])
    inner = np.minimum(xy - corner, corner + SIDE - 1 - xy).min(axis=1)
    return np.where(inner > 3, 1, np.where(inner < -3, 0, -1))
