"""One step of all trajectories along the flow, and the tests that stop them."""

from __future__ import annotations

from typing import cast

import numpy as np

from kt3dmoseg.flow import sample
from kt3dmoseg.tracking.options import TrackOptions
from kt3dmoseg.types import BoolArray, Float32Array, FloatArray


def step(
    xy: FloatArray, forward: Float32Array, backward: Float32Array, options: TrackOptions
) -> tuple[FloatArray, BoolArray]:
    """Follow the forward flow from points (N, 2) of one frame to the next; the flows are (H, W, 2).

    Returns the targets (N, 2), x + w(x) with w interpolated bilinearly (Sundaram, Brox, Keutzer 2010, eq. 2),
    and which are alive (N,): trajectories stop outside the frame, where the backward flow disagrees, and at
    motion boundaries.
    """
    w = sample(forward, xy)
    target = xy + w
    alive = inside(target, forward.shape[:2])
    alive &= consistent(w, sample(backward, target), options)
    alive &= ~at_boundary(xy, w, forward, options)
    return target, alive


def inside(xy: FloatArray, shape: tuple[int, ...]) -> BoolArray:
    """Whether points (N, 2) lie on a pixel of a frame of shape (H, W); a pixel is 1 wide about its centre."""
    height, width = shape
    x, y = xy[:, 0], xy[:, 1]
    return (x >= -0.5) & (y >= -0.5) & (x <= width - 0.5) & (y <= height - 0.5)


def consistent(w: FloatArray, back: FloatArray, options: TrackOptions) -> BoolArray:
    """Whether the way there and back ends near its start.

    |w + w'|^2 < consistency * (|w|^2 + |w'|^2) + consistency_floor (Sundaram, Brox, Keutzer 2010,
    eq. 5), with forward flow w (N, 2) at the point and backward flow w' (N, 2) at its target.
    """
    gap = ((w + back) ** 2).sum(axis=1)
    length = (w**2).sum(axis=1) + (back**2).sum(axis=1)
    return cast(BoolArray, gap < options.consistency * length + options.consistency_floor)


def at_boundary(xy: FloatArray, w: FloatArray, forward: Float32Array, options: TrackOptions) -> BoolArray:
    """Whether the flow changes so fast at the points that they sit on a motion boundary.

    |grad u|^2 + |grad v|^2 > boundary * |w|^2 + boundary_floor (Sundaram, Brox, Keutzer 2010, eq. 6);
    gradients by central differences at the nearest pixel.
    """
    change = (gradient(forward, xy, 1) ** 2).sum(axis=(1, 2))
    return cast(BoolArray, change > options.boundary * (w**2).sum(axis=1) + options.boundary_floor)


def gradient(forward: Float32Array, xy: FloatArray, reach: int) -> FloatArray:
    """Differentiate a flow's components along x and y, (N, 2, 2); 0 where the flow is not known.

    By differences between the pixels `reach` to either side of the nearest one.
    """
    height, width = forward.shape[:2]
    column = np.clip(np.rint(xy[:, 0]).astype(np.intp), 0, width - 1)
    row = np.clip(np.rint(xy[:, 1]).astype(np.intp), 0, height - 1)
    left, right = np.maximum(column - reach, 0), np.minimum(column + reach, width - 1)
    above, below = np.maximum(row - reach, 0), np.minimum(row + reach, height - 1)
    flat = forward.reshape(-1, 2)
    along_x = flat.take(row * width + right, axis=0) - flat.take(row * width + left, axis=0)
    along_y = flat.take(below * width + column, axis=0) - flat.take(above * width + column, axis=0)
    return np.nan_to_num(np.stack([along_x, along_y], axis=2) / (2 * reach))
