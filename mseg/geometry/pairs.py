"""The points of a frame pair, normalised; every view asks for the same ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from kt3dmoseg.types import FloatArray, IntArray, Trajectories
from mseg.geometry import hartley

# More than the frames of most clips; a few hundred kilobytes.
_KEPT = 64


@dataclass(frozen=True, eq=False)
class FramePair:
    """Points visible in two frames, each side normalised by `hartley.normalise`.

    Parameters
    ----------
    rows : (P,) int64
        Which trajectories they are.
    x1, x2 : (P, 2) float64
        Normalised points.
    t1, t2 : (3, 3) float64
        The similarities that made them from pixels.
    """

    rows: IntArray
    x1: FloatArray
    x2: FloatArray
    t1: FloatArray
    t2: FloatArray


@lru_cache(maxsize=_KEPT)
def frame_pair(trajectories: Trajectories, i: int, j: int) -> FramePair:
    """Normalise the points visible in frames i and j; the latest pairs are remembered."""
    rows, x1, x2 = trajectories.pair(i, j)
    if not len(rows):
        return FramePair(rows, x1, x2, np.eye(3), np.eye(3))
    n1, t1 = hartley.normalise(x1)
    n2, t2 = hartley.normalise(x2)
    return FramePair(rows, n1, n2, t1, t2)
