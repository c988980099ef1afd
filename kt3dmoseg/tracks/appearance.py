"""What every trajectory looked like at its start: to correct where it is, and to stop it where it is gone."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.flow.sampling import sample
from kt3dmoseg.tracks.linking import inside
from kt3dmoseg.tracks.options import TrackOptions
from kt3dmoseg.tracks.patches import Window, doubled
from kt3dmoseg.tracks.registration import register
from kt3dmoseg.types import BoolArray, ByteArray, Float32Array, FloatArray

_REACH = 4.0  # pixels on either side over which the derivatives of the flow are taken
_STEPS = _REACH * np.array([[1.0, 0.0], [0.0, 1.0]])
_STAR = np.array([[0.0, 0.0], [-0.5, 0.0], [0.5, 0.0], [0.0, -0.5], [0.0, 0.5]])


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
        self._start: Float32Array = np.zeros((0, 3, self.window.offset.shape[1]), dtype=np.float32)
        self._affine: FloatArray = np.zeros((0, 2, 2))
        self._image: Float32Array = np.zeros((0, 0), dtype=np.float32)

    def see(self, frame: ByteArray) -> None:
        """Look at the next frame (H, W) uint8; what follows happens in it."""
        self._image = doubled(frame)

    def add(self, xy: FloatArray) -> None:
        """Remember how new trajectories (N, 2) look; they come after all that are alive."""
        upright = np.broadcast_to(np.eye(2), (len(xy), 2, 2))
        value, left, right, above, below = (
            self.window.look(self._image, xy + step, upright) for step in _STAR
        )
        start = np.stack([value, right - left, below - above], axis=1)
        self._start = np.concatenate([self._start, start])
        self._affine = np.concatenate([self._affine, upright])

    def keep(self, alive: BoolArray) -> None:
        """Forget the trajectories (L,) that are not alive."""
        self._start, self._affine = self._start[alive], self._affine[alive]

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
        `appearance` * variance + `appearance_floor`; see `Window.unlike`.

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
        self._affine = (np.eye(2) + _gradient(forward, xy)) @ self._affine
        seen = self.window.look(self._image, target, self._affine)
        if self.options.anchor:
            target, seen = self._anchored(target, seen)
        if not self.options.appearance:
            return target, np.ones(len(target), dtype=np.bool_)
        return target, self._alike(seen, self.options.appearance)

    def _anchored(self, target: FloatArray, seen: Float32Array) -> tuple[FloatArray, Float32Array]:
        limit, image = self.options.anchor, self._image
        xy, affine = register(image, seen, target, self._affine, self._start, self.window, self.options)
        found = self.window.look(image, xy, affine)
        better = (np.hypot(*(xy - target).T) <= limit) & self._alike(found, self.options.anchor_change)
        better &= self._change(found)[0] < self._change(seen)[0]
        better &= inside(xy, (image.shape[0] // 2, image.shape[1] // 2))
        row = better[:, None]
        gain = self.options.anchor_gain
        self._affine += gain * np.where(row[..., None], affine - self._affine, 0)
        return target + gain * np.where(row, xy - target, 0), np.where(row, found, seen)

    def _alike(self, seen: Float32Array, share: float) -> BoolArray:
        change, variance = self._change(seen)
        return change <= share * variance + self.options.appearance_floor

    def _change(self, seen: Float32Array) -> tuple[FloatArray, FloatArray]:
        return self.window.unlike(seen, self._start[:, 0])


def _gradient(field: Float32Array, xy: FloatArray) -> FloatArray:
    """Differentiate a flow's components along x and y, (N, 2, 2); 0 where the flow is not known."""
    along = [(sample(field, xy + step) - sample(field, xy - step)) / (2 * _REACH) for step in _STEPS]
    return np.nan_to_num(np.stack(along, axis=2))
