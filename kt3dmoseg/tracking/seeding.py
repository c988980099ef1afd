"""Where trajectories start: on free cells of a grid where the frame has structure."""

from __future__ import annotations

from functools import lru_cache
from typing import cast

import cv2
import numpy as np
from scipy.spatial import cKDTree

from kt3dmoseg.flow.base import smooth
from kt3dmoseg.tracking.options import TrackOptions
from kt3dmoseg.types import BoolArray, ByteArray, Float32Array, FloatArray

_CENTRAL = np.array([-0.5, 0.0, 0.5], dtype=np.float32)
_ONE = np.ones(1, dtype=np.float32)
_ROUNDING = np.float32(1e-6)  # gray values squared; a single pixel that is one brighter gives 1e-3


def new_seeds(frame: ByteArray, live: FloatArray, options: TrackOptions) -> FloatArray:
    """Start points (S, 2) in a frame (H, W), where the trajectories at `live` (L, 2) are alive."""
    height, width = frame.shape
    cells = grid(height, width, options)
    column, row = cells.astype(np.intp).T
    return uncovered(cells[structured(frame, options)[row, column]], live, options.coverage)


def grid(height: int, width: int, options: TrackOptions) -> FloatArray:
    """Points (G, 2) at offset, offset + spacing, ..., strictly inside the frame less the offset, by rows."""
    x = np.arange(options.offset, width - options.offset, options.spacing, dtype=np.float64)
    y = np.arange(options.offset, height - options.offset, options.spacing, dtype=np.float64)
    return np.stack([np.tile(x, len(y)), np.repeat(y, len(x))], axis=1)


def uncovered(cells: FloatArray, live: FloatArray, radius: float) -> FloatArray:
    """Keep the cells (G, 2) that no live trajectory (L, 2) is closer to than `radius`.

    Live positions are truncated to whole pixels first: so the release's start cells come out.
    """
    if not len(live) or not len(cells):
        return cells
    tree = cKDTree(np.trunc(live), compact_nodes=False, balanced_tree=False)
    nearest, _ = tree.query(cells, distance_upper_bound=radius + 1)
    return cells[nearest >= radius]


def structured(frame: ByteArray, options: TrackOptions) -> BoolArray:
    """Pixels (H, W) where a trajectory may start.

    The smaller eigenvalue must reach a fraction of its mean over the frame (Sundaram, Brox, Keutzer
    2010, eq. 3). The fraction grows towards the border of the frame, where a track is soon lost:
    structure + border_gain * exp(-border_decay * distance).
    """
    eigenvalue = smaller_eigenvalue(frame, options.presmoothing, options.integration)
    fraction = _fraction(*frame.shape, options.structure, options.border_gain, options.border_decay)
    # The floor: of an even frame, what rounding leaves would be its mean, and every pixel structured.
    least = np.maximum(fraction * float(eigenvalue.mean(dtype=np.float64)), _ROUNDING)
    return cast(BoolArray, eigenvalue >= least)


@lru_cache(maxsize=1)  # the same for all frames of a clip
def _fraction(height: int, width: int, structure: float, gain: float, decay: float) -> Float32Array:
    across = np.minimum(np.arange(width), np.arange(width)[::-1])
    down = np.minimum(np.arange(height), np.arange(height)[::-1])
    distance = np.minimum(down[:, None], across[None, :])
    return (structure + gain * np.exp(-decay * distance)).astype(np.float32)


def smaller_eigenvalue(frame: ByteArray, presmoothing: float, integration: float) -> Float32Array:
    """Smaller eigenvalue of the structure tensor J = K * (grad I grad I^T) at every pixel.

    (Jxx + Jyy) / 2 - sqrt(((Jxx - Jyy) / 2)^2 + Jxy^2) in gray values squared, (H, W). I is the frame,
    smoothed with sigma `presmoothing`, its gradient by central differences; K smooths with `integration`.
    """
    image = smooth(frame.astype(np.float32), presmoothing)
    dx = cv2.sepFilter2D(image, cv2.CV_32F, _CENTRAL, _ONE, borderType=cv2.BORDER_REFLECT)
    dy = cv2.sepFilter2D(image, cv2.CV_32F, _ONE, _CENTRAL, borderType=cv2.BORDER_REFLECT)
    xx, xy, yy = (smooth(product, integration) for product in (dx * dx, dx * dy, dy * dy))
    twice = xx + yy  # from here in place: to fetch memory can take longer than to compute
    xx -= yy
    xy *= 2
    twice -= cv2.magnitude(xx, xy)
    twice /= 2
    return twice
