"""Positions of growing trajectories, frame by frame, in memory proportional to their number."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import FloatArray, IntArray, Trajectories


class TrackStore:
    """Collect live trajectories per frame; `finish` lays them out as `Trajectories`."""

    def __init__(self) -> None:
        self._frames: list[tuple[IntArray, FloatArray]] = []

    def append(self, ids: IntArray, xy: FloatArray) -> None:
        """Add the next frame: identities (L,) and positions (L, 2) of the live trajectories."""
        self._frames.append((ids, xy))

    def finish(self, count: int, min_length: int, image_size: tuple[int, int]) -> Trajectories:
        """Lay out `count` trajectories; those visible in fewer than `min_length` frames are dropped.

        Returns
        -------
        Trajectories
            In the order of their identities, numbered anew from 0.
        """
        length = np.zeros(count, dtype=np.int64)
        for ids, _ in self._frames:
            length[ids] += 1
        kept = length >= min_length
        row = np.cumsum(kept) - 1
        xy = np.full((int(kept.sum()), len(self._frames), 2), np.nan)
        visible = np.zeros(xy.shape[:2], dtype=np.bool_)
        for frame, (ids, positions) in enumerate(self._frames):
            chosen = kept[ids]
            rows = row[ids[chosen]]
            xy[rows, frame], visible[rows, frame] = positions[chosen], True
        xy.flags.writeable = visible.flags.writeable = False  # handed over, not copied
        return Trajectories(xy, visible, image_size=image_size)
