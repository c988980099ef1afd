"""Hartley's normalisation: of the points of a frame pair, and of the models between its frames."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from kt3dmoseg.types import FloatArray, IntArray, Trajectories
from mseg.types import ModelKind

_SQRT2 = float(np.sqrt(2.0))
# More frame pairs than most clips have; a few hundred kilobytes.
_KEPT = 64


def normalise(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Move centroids of sets of points (..., P, 2) to the origin and scale mean distances from it to sqrt 2.

    Returns the points and the similarities (..., 3, 3) that do it. A set whose points coincide is only moved.
    """
    # Hartley, "In defense of the eight-point algorithm", TPAMI 1997, section 4.
    centroid = points.mean(axis=-2, keepdims=True)
    centred = points - centroid
    distance = np.sqrt(np.einsum("...pc,...pc->...p", centred, centred)).mean(axis=-1)
    scale = np.ones_like(distance)
    # Below a billionth of the coordinates the spread is rounding, not geometry.
    spread = distance > 1e-9 * (1.0 + np.abs(centroid[..., 0, :]).max(axis=-1))
    np.divide(_SQRT2, distance, out=scale, where=spread)
    transform = np.zeros((*points.shape[:-2], 3, 3))
    transform[..., 0, 0] = transform[..., 1, 1] = scale
    transform[..., :2, 2] = -scale[..., None] * centroid[..., 0, :]
    transform[..., 2, 2] = 1.0
    return centred * scale[..., None, None], transform


def inverse(transform: FloatArray) -> FloatArray:
    """Invert similarities of the form [s 0 a; 0 s b; 0 0 1], (..., 3, 3)."""
    out = np.zeros_like(transform)
    scale = transform[..., 0, 0]
    out[..., 0, 0] = out[..., 1, 1] = 1.0 / scale
    out[..., :2, 2] = -transform[..., :2, 2] / scale[..., None]
    out[..., 2, 2] = 1.0
    return out


def _before(models: FloatArray, transform: FloatArray) -> FloatArray:
    """Multiply models by similarities [s 0 a; 0 s b; 0 0 1] from the right, both (..., 3, 3).

    Written out, because products of many small matrices spend their time on calls.
    """
    scale, a, b = (transform[..., i, j, None] for i, j in ((0, 0), (0, 2), (1, 2)))
    first, second, third = models[..., 0], models[..., 1], models[..., 2]
    return np.stack([first * scale, second * scale, first * a + second * b + third], axis=-1)


def _after(transform: FloatArray, models: FloatArray) -> FloatArray:
    """Multiply models by similarities from the left; see `_before`."""
    scale, a, b = (transform[..., i, j, None] for i, j in ((0, 0), (0, 2), (1, 2)))
    first, second, third = models[..., 0, :], models[..., 1, :], models[..., 2, :]
    return np.stack([first * scale + third * a, second * scale + third * b, third], axis=-2)


def change_frame(kind: ModelKind, models: FloatArray, t1: FloatArray, t2: FloatArray) -> FloatArray:
    """Express models in new image coordinates T1 x1 and T2 x2 (similarities, one or one per model).

    Homographies and fundamental matrices come out with Frobenius norm 1, affine maps with (0 0 1).
    """
    moved = _before(models, inverse(t1))
    if kind == "fundamental":  # maps points to lines: x2^T F x1 = 0
        return unit_norm(np.swapaxes(_before(np.swapaxes(moved, -1, -2), inverse(t2)), -1, -2))
    moved = _after(t2, moved)
    return moved if kind == "affine" else unit_norm(moved)


def unit_norm(models: FloatArray) -> FloatArray:
    """Scale models (K, 3, 3) to Frobenius norm 1; a matrix of zeros stays."""
    size = np.linalg.norm(models, axis=(1, 2), keepdims=True)
    return np.asarray(models / np.where(size > 0, size, 1.0))


@dataclass(frozen=True, eq=False)
class FramePair:
    """Points visible in two frames, each side normalised by `normalise`."""

    rows: IntArray  # (P,): which trajectories they are
    x1: FloatArray  # (P, 2): normalised points
    x2: FloatArray
    t1: FloatArray  # (3, 3): the similarities that made them from pixels
    t2: FloatArray


@lru_cache(maxsize=_KEPT)
def frame_pair(trajectories: Trajectories, i: int, j: int) -> FramePair:
    """Normalise the points visible in frames i and j; the latest pairs are kept."""
    rows, x1, x2 = trajectories.pair(i, j)
    if not len(rows):
        return FramePair(rows, x1, x2, np.eye(3), np.eye(3))
    n1, t1 = normalise(x1)
    n2, t2 = normalise(x2)
    return FramePair(rows, n1, n2, t1, t2)
