"""What every trajectory looked like at its start: to correct where it is, and to stop it where it is gone."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kt3dmoseg.tracking.linking import gradient, inside
from kt3dmoseg.tracking.options import TrackOptions
from kt3dmoseg.tracking.patches import Window, doubled
from kt3dmoseg.tracking.registration import CHUNK, Starts, correction, remember
from kt3dmoseg.types import BoolArray, ByteArray, Float32Array, FloatArray

_REACH = 4  # pixels on either side over which the derivatives of the flow are taken


class Appearance:
    """The patches in which the live trajectories started, and how each has been deformed since.

    The errors of single steps add up along a trajectory; the patch in which it started does not change
    (Shi and Tomasi, CVPR 1994, compare with the first frame for this reason). And where forward and
    backward flow agree on an error, as beyond the outline of an object, what the point shows changes.

    Parameters
    ----------
    options : TrackOptions
        `patch_radius`, `anchor` and the names that begin with it, `appearance` and `appearance_floor`.
    """

    def __init__(self, options: TrackOptions) -> None:
        self.options, self.window = options, Window(options.patch_radius)
        nothing = np.zeros((0, 3, len(self.window.weight)), dtype=np.float32)
        self._starts = remember(nothing, self.window, options)
        self._row: npt.NDArray[np.intp] = np.zeros(0, dtype=np.intp)  # of the live ones, in `_starts`
        self._affine: FloatArray = np.zeros((0, 2, 2))
        self._image: Float32Array = np.zeros((0, 0), dtype=np.float32)
        self._size: tuple[int, ...] = (0, 0)

    def see(self, frame: ByteArray) -> None:
        """Look at the next frame (H, W) uint8; what follows happens in it."""
        self._image, self._size = doubled(frame), frame.shape

    def add(self, xy: FloatArray) -> None:
        """Remember how new trajectories (N, 2) look; they come after all that are alive."""
        rows = self._free_rows(len(xy))
        self._starts.put(rows, remember(self.window.start(self._image, xy), self.window, self.options))
        self._row = np.concatenate([self._row, rows])
        self._affine = np.concatenate([self._affine, np.broadcast_to(np.eye(2), (len(xy), 2, 2))])

    def _free_rows(self, count: int) -> npt.NDArray[np.intp]:
        """Rows of `_starts` that no live trajectory has, of which more are made where there are too few."""
        free = np.ones(len(self._starts.variance), dtype=np.bool_)
        free[self._row] = False
        if free.sum() < count:
            self._starts = self._starts.and_more(count)
            free = np.concatenate([free, np.ones(count, dtype=np.bool_)])
        return np.flatnonzero(free)[:count]

    def keep(self, alive: BoolArray) -> None:
        """Forget the trajectories (L,) that are not alive."""
        self._row, self._affine = self._row[alive], self._affine[alive]

    def follow(
        self, forward: Float32Array, xy: FloatArray, target: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Correct the step of the live trajectories into this frame, and say which look like their start.

        The affine map from the start's patch to the present one is carried along by the flow,
        A <- (1 + grad w) A: a camera that drives forward enlarges what it sees by some percent per frame.
        With `anchor`, position and map are then registered with the start. The result is taken where it lies
        at most `anchor` pixels off, and the change of the patch has fallen, and to `anchor_change` *
        variance + `appearance_floor` at most; elsewhere the flow's point stays. Of the way from the flow's
        point to the result the trajectory goes the share `anchor_gain`. Patches are alike where change <=
        `appearance` * variance + `appearance_floor`. The change is the weighted mean of (I - T)^2, the
        variance that of T^2, with the present patch I and the start's T, both less their means.

        Parameters
        ----------
        forward : (H, W, 2) float32
            Flow from the frame before to this one.
        xy, target : (L, 2) float64
            Positions in the frame before, and where the flow leads.

        Returns
        -------
        xy : (L, 2) float64
            Positions in this frame.
        alike : (L,) bool
            All True when `appearance` is 0.
        """
        affine = (np.eye(2) + gradient(forward, xy, _REACH)) @ self._affine
        place, alike = np.concatenate([affine, target[..., None]], axis=2), np.ones(len(xy), dtype=np.bool_)
        for first in range(0, len(xy), CHUNK):
            part = slice(first, first + CHUNK)
            place[part], alike[part] = self._compared(place[part], self._starts.at(self._row[part]))
        self._affine = place[..., :2]
        return place[..., 2].copy(), alike

    def _compared(self, place: FloatArray, start: Starts) -> tuple[FloatArray, BoolArray]:
        floor = self.options.appearance_floor
        rest = self._rest(place, start)
        change = rest**2 @ self.window.weight
        if self.options.anchor:
            step = -place[..., :2] @ correction(rest, start, self.window, self.options)
            after = self._rest(place + step, start) ** 2 @ self.window.weight
            better = after < np.minimum(change, self.options.anchor_change * start.variance + floor)
            better &= np.hypot(*step[..., 2].T) <= self.options.anchor
            better &= inside(place[..., 2] + step[..., 2], self._size)
            place = place + self.options.anchor_gain * np.where(better[:, None, None], step, 0)
            change = np.where(better, after, change)
        if not self.options.appearance:
            return place, np.ones(len(place), dtype=np.bool_)
        return place, change <= self.options.appearance * start.variance + floor

    def _rest(self, place: FloatArray, start: Starts) -> Float32Array:
        return self.window.centred(self.window.look(self._image, place)) - start.patch[:, 0]
