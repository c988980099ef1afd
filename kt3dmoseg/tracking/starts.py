"""Where trajectories start: on free cells of a grid where the frame has structure, or at given points."""

from __future__ import annotations

from functools import lru_cache
from typing import cast

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.flow.base import smooth
from kt3dmoseg.tracking.linking import inside
from kt3dmoseg.tracking.options import TrackOptions
from kt3dmoseg.types import BoolArray, ByteArray, Float32Array, FloatArray, IntArray

_CENTRAL = np.array([-0.5, 0.0, 0.5], dtype=np.float32)
_ONE = np.ones(1, dtype=np.float32)
_ROUNDING = np.float32(1e-6)  # gray values squared; a single pixel that is one brighter gives 1e-3


def smaller_eigenvalue(frame: ByteArray, presmoothing: float, integration: float) -> Float32Array:
    """Smaller eigenvalue of the structure tensor J = K * (grad I grad I^T) at every pixel.

    Parameters
    ----------
    frame : (H, W) uint8
        Gray frame I; smoothed before its central differences are taken.
    presmoothing, integration : float
        Sigma in pixels of the smoothing of I, and of K; see `kt3dmoseg.flow.base.smooth`.

    Returns
    -------
    (H, W) float32
        (Jxx + Jyy) / 2 - sqrt(((Jxx - Jyy) / 2)^2 + Jxy^2), in gray values squared.
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


def structured(frame: ByteArray, options: TrackOptions) -> BoolArray:
    """Pixels where a trajectory may start.

    The smaller eigenvalue must reach a fraction of its mean over the frame (Sundaram, Brox, Keutzer
    2010, eq. 3). The fraction grows towards the border of the frame, where a track is soon lost:
    structure + border_gain * exp(-border_decay * distance).

    Returns
    -------
    (H, W) bool
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


def grid(height: int, width: int, options: TrackOptions) -> FloatArray:
    """Seed grid: offset, offset + spacing, ..., strictly inside the frame less the offset.

    Returns
    -------
    (G, 2) float64
        (x, y), row by row.
    """
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


class GridStarts:
    """Starts on the structured cells of the grid that are not covered; `count` of them so far."""

    def __init__(self, options: TrackOptions) -> None:
        self.options, self.count = options, 0

    def next(self, frame: ByteArray, live: FloatArray) -> tuple[IntArray, FloatArray]:
        """Identities and positions of what starts in the next frame, where `live` (L, 2) are alive."""
        height, width = frame.shape
        cells = grid(height, width, self.options)
        column, row = cells.astype(np.intp).T
        xy = uncovered(cells[structured(frame, self.options)[row, column]], live, self.options.coverage)
        ids = np.arange(self.count, self.count + len(xy))
        self.count += len(xy)
        return ids, xy

    def check_end(self, frames: int) -> None:
        """Grid seeds start in whatever frames there are."""


class GivenStarts:
    """Starts that the caller chose, (S, 3): x, y, frame.

    Raises
    ------
    InvalidValueError
        For seeds of another shape; at a frame, for one outside it; at the end, for one after it.
    """

    def __init__(self, seeds: npt.ArrayLike) -> None:
        self.seeds = np.asarray(seeds, dtype=np.float64)
        if self.seeds.ndim != 2 or self.seeds.shape[1] != 3:
            raise InvalidValueError(
                "seeds", expected="shape (S, 3): x, y, frame", found=f"{self.seeds.shape}"
            )
        whole = np.isfinite(self.seeds).all(axis=1) & (self.seeds[:, 2] == np.trunc(self.seeds[:, 2]))
        self._reject(~whole | (self.seeds[:, 2] < 0), "finite x, y and a whole frame number >= 0")
        self.count, self._frame = len(self.seeds), 0

    def next(self, frame: ByteArray, live: FloatArray) -> tuple[IntArray, FloatArray]:
        """Identities and positions of what starts in the next frame."""
        now = self.seeds[:, 2] == self._frame
        height, width = frame.shape
        self._reject(now & ~inside(self.seeds[:, :2], frame.shape), f"a point in the {width}x{height} frame")
        self._frame += 1
        ids = np.flatnonzero(now)
        return ids, self.seeds[ids, :2]

    def check_end(self, frames: int) -> None:
        """Reject starts beyond the last of so many frames."""
        self._reject(self.seeds[:, 2] >= frames, f"a frame number below {frames}, the number of frames")

    def _reject(self, bad: npt.NDArray[np.bool_], expected: str) -> None:
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            raise InvalidValueError(f"seed {row}", expected=expected, found=str(self.seeds[row].tolist()))
