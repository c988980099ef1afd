"""Where trajectories start, how they follow the flow, and where they stop.

Equations are those of Sundaram, Brox, Keutzer, ECCV 2010 (SBK).
"""

from typing import cast

import cv2
import numpy as np
from scipy.spatial import cKDTree

from kt3dmoseg.flow import sample, smooth
from kt3dmoseg.tracking import TrackOptions
from kt3dmoseg.types import BoolArray, ByteArray, Float32Array, FloatArray

_CENTRAL = np.array([-0.5, 0.0, 0.5], dtype=np.float32)
_ONE = np.ones(1, dtype=np.float32)
_ROUNDING = np.float32(1e-6)  # gray values squared; a single pixel that is one brighter gives 1e-3


def new_seeds(frame: ByteArray, live: FloatArray, options: TrackOptions) -> FloatArray:
    """Start points (S, 2) in a frame (H, W), where the trajectories at `live` (L, 2) are alive."""
    cells = grid(frame.shape[0], frame.shape[1], options)
    cells = cells[structured(frame, cells, options)]
    return cells[uncovered(cells, live, options)]


def grid(height: int, width: int, options: TrackOptions) -> FloatArray:
    """Points (G, 2) at offset, offset + spacing, ..., strictly inside the frame less the offset, by rows."""
    first, step = float(options.offset), options.spacing
    sides = (np.arange(first, side - first, step) for side in (width, height))
    return np.stack(np.meshgrid(*sides), axis=2).reshape(-1, 2)


def uncovered(cells: FloatArray, live: FloatArray, options: TrackOptions) -> BoolArray:
    """Whether no live trajectory (L, 2) is closer to a cell (G, 2) than `coverage`, (G,).

    Live positions are truncated to whole pixels first: so the release's start cells come out.
    """
    tree = cKDTree(np.trunc(live), balanced_tree=False, compact_nodes=False)  # it is used once
    nearest, _ = tree.query(cells, distance_upper_bound=options.coverage)
    return np.asarray(np.isinf(nearest))


def structured(frame: ByteArray, cells: FloatArray, options: TrackOptions) -> BoolArray:
    """Whether a trajectory may start at whole pixels (G, 2) of a frame (H, W).

    The smaller eigenvalue must reach a fraction of its mean over the frame (SBK eq. 3). The fraction grows
    towards the border, where a track is soon lost: structure + border_gain * exp(-border_decay * distance).
    """
    column, row = cells.astype(np.intp).T
    distance = np.minimum.reduce([column, row, frame.shape[1] - 1 - column, frame.shape[0] - 1 - row])
    gain = options.border_gain * np.exp(-options.border_decay * distance)
    fraction = np.asarray(options.structure + gain, dtype=np.float32)
    eigenvalue = smaller_eigenvalue(frame, options.presmoothing, options.integration)
    # The floor: of an even frame, what rounding leaves would be its mean, and every pixel structured.
    least = np.maximum(fraction * cv2.mean(eigenvalue)[0], _ROUNDING)
    return cast(BoolArray, eigenvalue[row, column] >= least)


def smaller_eigenvalue(frame: ByteArray, presmoothing: float, integration: float) -> Float32Array:
    """Smaller eigenvalue of the structure tensor J = K * (grad I grad I^T) at every pixel.

    (Jxx + Jyy) / 2 - sqrt(((Jxx - Jyy) / 2)^2 + Jxy^2) in gray values squared, (H, W). I is the frame,
    smoothed with sigma `presmoothing`, its gradient by central differences; K smooths with `integration`.
    """
    image = smooth(frame.astype(np.float32), presmoothing)
    dx = cv2.sepFilter2D(image, cv2.CV_32F, _CENTRAL, _ONE, borderType=cv2.BORDER_REFLECT)
    dy = cv2.sepFilter2D(image, cv2.CV_32F, _ONE, _CENTRAL, borderType=cv2.BORDER_REFLECT)
    xx, yy = np.asarray(dx, np.float32), np.asarray(dy, np.float32)
    xy = np.multiply(xx, yy, out=image)  # from here in place: to fetch memory can take longer than to compute
    xx *= xx
    yy *= yy
    for product in (xx, xy, yy):
        smooth(product, integration, product)
    twice = xx + yy
    xx -= yy
    xy *= 2
    twice -= cv2.magnitude(xx, xy, yy)
    twice /= 2
    return twice


def step(
    xy: FloatArray, forward: Float32Array, backward: Float32Array, options: TrackOptions
) -> tuple[FloatArray, BoolArray]:
    """Follow the forward flow from points (N, 2) of one frame to the next; the flows are (H, W, 2).

    Returns the targets (N, 2), x + w(x) with w interpolated bilinearly (SBK eq. 2), and which are alive (N,):
    trajectories stop outside the frame, where the backward flow disagrees, and at motion boundaries.
    """
    w = sample(forward, xy)
    target = xy + w
    alive = inside(target, forward.shape[:2])
    alive &= consistent(w, sample(backward, target), options)
    alive &= ~at_boundary(xy, w, forward, options)
    return target, alive


def inside(xy: FloatArray, shape: tuple[int, ...]) -> BoolArray:
    """Whether points (N, 2) lie on a pixel of a frame of shape (H, W); a pixel is 1 wide about its centre."""
    return cast(BoolArray, ((xy >= -0.5) & (xy <= np.array(shape[::-1]) - 0.5)).all(axis=1))


def consistent(w: FloatArray, back: FloatArray, options: TrackOptions) -> BoolArray:
    """Whether the way there and back ends near its start.

    |w + w'|^2 < consistency * (|w|^2 + |w'|^2) + consistency_floor (SBK eq. 5), with forward flow w (N, 2) at
    the point and backward flow w' (N, 2) at its target.
    """
    gap, length = ((w + back) ** 2).sum(axis=1), (w**2).sum(axis=1) + (back**2).sum(axis=1)
    return cast(BoolArray, gap < options.consistency * length + options.consistency_floor)


def at_boundary(xy: FloatArray, w: FloatArray, forward: Float32Array, options: TrackOptions) -> BoolArray:
    """Whether the flow changes so fast at the points that they sit on a motion boundary.

    |grad u|^2 + |grad v|^2 > boundary * |w|^2 + boundary_floor (SBK eq. 6), at the nearest pixel.
    """
    change = (gradient(forward, xy, 1) ** 2).sum(axis=(1, 2))
    return cast(BoolArray, change > options.boundary * (w**2).sum(axis=1) + options.boundary_floor)


def gradient(forward: Float32Array, xy: FloatArray, reach: int) -> FloatArray:
    """Differentiate a flow's components along x and y, (N, 2, 2); 0 where the flow is not known.

    By differences between the pixels `reach` to either side of the nearest one, at the border of the picture
    the last one, over twice the reach.
    """
    height, width = forward.shape[:2]
    x, y = np.rint(xy).astype(np.intp).T
    x, y, vectors = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1), forward.reshape(-1, 2)
    ends = [
        vectors.take(np.clip(y + down, 0, height - 1) * width + np.clip(x + right, 0, width - 1), axis=0)
        for right, down in ((reach, 0), (-reach, 0), (0, reach), (0, -reach))
    ]
    return np.nan_to_num(np.stack([ends[0] - ends[1], ends[2] - ends[3]], axis=2) / (2 * reach))
