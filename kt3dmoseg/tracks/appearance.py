"""A stop by appearance: a trajectory ends where it no longer looks like its start."""

from __future__ import annotations

from typing import cast

import numpy as np

from kt3dmoseg.flow.sampling import sample
from kt3dmoseg.flow.smoothing import smooth
from kt3dmoseg.tracks.options import TrackOptions
from kt3dmoseg.types import BoolArray, ByteArray, FloatArray

_RADIUS = 3
_SIDE = np.arange(-_RADIUS, _RADIUS + 1, dtype=np.float64)
_OFFSETS = np.stack(np.meshgrid(_SIDE, _SIDE), axis=2).reshape(-1, 2)


class Appearance:
    """What every live trajectory looked like at its start; forward and backward flow may agree on an error.

    The flow of an object reaches some pixels beyond its outline, in both directions, so that points of
    the ground beside it move along with it and pass the consistency test. What they show changes.

    Parameters
    ----------
    options : TrackOptions
        `presmoothing` of the frames; `appearance` and `appearance_floor` of the test.
    """

    def __init__(self, options: TrackOptions) -> None:
        self.options = options
        self._starts: FloatArray = np.zeros((0, len(_OFFSETS)))

    def add(self, frame: ByteArray, xy: FloatArray) -> None:
        """Remember how new trajectories (N, 2) look; they come after all that are alive."""
        self._starts = np.concatenate([self._starts, self._patches(frame, xy)])

    def keep(self, alive: BoolArray) -> None:
        """Forget the trajectories (L,) that are not alive."""
        self._starts = self._starts[alive]

    def alike(self, frame: ByteArray, xy: FloatArray) -> BoolArray:
        """Whether the patches at `xy` (L, 2) look like those at the starts, in the same order, (L,).

        With both patches less their means, so that a change of brightness does not count:
        mean (p - q)^2 <= appearance * (var p + var q) / 2 + appearance_floor. Without the floor this is
        a correlation of at least 1 - appearance / 2, for patches of equal variance.
        """
        now = self._patches(frame, xy)
        change = ((now - self._starts) ** 2).mean(axis=1)
        variance = (now.var(axis=1) + self._starts.var(axis=1)) / 2
        allowed = self.options.appearance * variance + self.options.appearance_floor
        return cast(BoolArray, change <= allowed)

    def _patches(self, frame: ByteArray, xy: FloatArray) -> FloatArray:
        """Seven by seven gray values about each point, less their mean, (N, 49)."""
        image = smooth(frame.astype(np.float32), self.options.presmoothing)
        values = sample(image, xy[:, None] + _OFFSETS).reshape(len(xy), len(_OFFSETS))
        return cast(FloatArray, values - values.mean(axis=1, keepdims=True))
