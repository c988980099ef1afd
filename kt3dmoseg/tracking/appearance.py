"""What every trajectory looked like at its start: to correct where it is, and to stop it where it is gone.

Gray values are seen through an affine map in windows about points (`Window`), registered with the start
(`correction`) and compared with it (`Appearance`).
"""

from typing import NamedTuple, cast

import cv2
import numpy as np

from kt3dmoseg.tracking.linking import gradient
from kt3dmoseg.tracking.options import TrackOptions
from kt3dmoseg.tracking.registration import begin, compare, prepare
from kt3dmoseg.types import BoolArray, ByteArray, Float32Array, FloatArray

_POLE = np.sqrt(8) - 3  # of the inverse of (1, 6, 1) / 8
_SHARPEN = _POLE ** np.abs(np.arange(-4, 5))
_SHARPEN = (_SHARPEN / _SHARPEN.sum()).astype(np.float32)
_EDGE = 2  # pixels beyond which `cv2.pyrUp` takes no account of the lower and right border
_REACH = 4  # pixels on either side over which the derivatives of the flow are taken


def doubled(frame: ByteArray) -> Float32Array:
    """Interpolate a frame (H, W) at every half pixel, (2H, 2W).

    By a cubic spline: `cv2.pyrUp` refines the spline's coefficients, which a filter with the inverse of its
    kernel finds first (Unser, IEEE Signal Processing Magazine 1999). Bilinear look-up in the result errs far
    less than in the frame, and unlike OpenCV's bicubic one (a = -0.75), which is up to 0.05 px off, it is
    exact on a ramp.
    """
    height, width = frame.shape
    around = cv2.copyMakeBorder(frame, 0, _EDGE, 0, _EDGE, cv2.BORDER_REFLECT_101)
    coefficients = cv2.sepFilter2D(around, cv2.CV_32F, _SHARPEN, _SHARPEN, borderType=cv2.BORDER_REFLECT_101)
    return cast(Float32Array, cv2.pyrUp(coefficients)[: 2 * height, : 2 * width])


class Starts(NamedTuple):
    """What is known of N patches from their start."""

    patch: Float32Array  # (N, 3, P): T less its weighted mean, its x- and its y-derivative
    variance: Float32Array  # (N,): weighted mean of T^2
    inverse: Float32Array  # (N, 6, 6): from the right side in `_correct` to the change of pose


class Window:
    """A disc of P pixels with weights that fall off with the distance from its centre.

    The `weight`, (P,) float32 with sum 1, is a Gaussian of sigma R / 2: what lies beyond an outline at the
    rim counts little. `lattice` (3, P) holds x and y of the pixels from the centre, and 1.
    """

    def __init__(self, radius: int) -> None:
        side = np.arange(-radius - 1, radius + 2, dtype=np.float32)
        x, y = (axis.ravel() for axis in np.meshgrid(side, side))
        self._square = np.array([x, y, np.ones_like(x)])
        self.lattice = self._square[:, x**2 + y**2 <= (radius + 0.5) ** 2]
        weight = np.exp(-2 * (self.lattice[:2] ** 2).sum(axis=0) / radius**2)
        self.weight = cast(Float32Array, weight / weight.sum())
        self.pixels = np.array([*self.lattice, self.weight])

    def start(self, image: Float32Array, xy: FloatArray) -> Float32Array:
        """Upright patches about points (N, 2) and their x- and y-derivatives, (N, 3, P)."""
        patch = np.empty((len(xy), 3, len(self.weight)), np.float32)
        begin(image, xy, self._square, self.pixels, patch)
        return patch

    def prepare(self, patch: Float32Array, options: TrackOptions) -> Starts:
        """Make ready for registration what `start` has seen, (N, 3, P)."""
        count = len(patch)
        known = Starts(patch, np.empty(count, np.float32), np.empty((count, 6, 6), np.float32))
        prepare(patch, self.pixels, options.anchor_stiffness, *known[1:])
        return known


class Appearance:
    """The patches in which the live trajectories started, and how each has been deformed since.

    The errors of single steps add up along a trajectory; the patch in which it started does not change
    (Shi and Tomasi, CVPR 1994, compare with the first frame for this reason). And where forward and
    backward flow agree on an error, as beyond the outline of an object, what the point shows changes.
    """

    def __init__(self, options: TrackOptions) -> None:
        self.options, self.window = options, Window(options.patch_radius)
        nothing = np.zeros((0, 3, len(self.window.weight)), dtype=np.float32)
        self._starts, self._row = self.window.prepare(nothing, options), np.arange(0)
        self._affine: FloatArray = np.zeros((0, 2, 2))

    def look_at(self, frame: ByteArray) -> None:
        """Look at the next frame (H, W) uint8; what follows happens in it."""
        self._image = doubled(frame)

    def add(self, xy: FloatArray) -> None:
        """Keep how new trajectories (N, 2) look; they come after all that are alive."""
        self._new = self._image, xy  # half of them do not live to the next frame: only then are they seen

    def follow(
        self, forward: Float32Array, xy: FloatArray, target: FloatArray, alive: BoolArray
    ) -> tuple[FloatArray, BoolArray]:
        """Correct the step of the trajectories into this frame; keep those alive that look like their start.

        `forward` (H, W, 2) is the flow from the frame before, `xy` (L, 2) are the positions there, `target`
        (L, 2) where it leads, and `alive` (L,) says which have not stopped; the last two are new arrays.

        The affine map from the start's patch to the present one is carried along by the flow,
        A <- (1 + grad w) A: a camera that drives forward enlarges what it sees by some percent per frame.
        With `anchor`, position and map are then registered with the start. The result is taken where it lies
        at most `anchor` pixels off, and the change of the patch has fallen, and to `anchor_change` *
        variance + `appearance_floor` at most; elsewhere the flow's point stays. With `appearance`, patches
        look alike where change <= `appearance` * variance + `appearance_floor`. The change is the weighted
        mean of (I - T)^2 with the present patch I and the start's T, both less their means.
        """
        live, count, options = np.flatnonzero(alive), len(self._row), self.options
        old, (image, start) = live[live < count], self._new
        new = self.window.prepare(self.window.start(image, start[live[len(old) :] - count]), options)
        pairs = zip(self._starts, new, strict=True)
        self._starts = Starts(*(np.concatenate([kept[self._row[old]], more]) for kept, more in pairs))
        affine = np.concatenate([self._affine[old], np.broadcast_to(np.eye(2), (len(new.patch), 2, 2))])
        affine = (np.eye(2) + gradient(forward, xy[live], _REACH)) @ affine
        pose, alike = np.concatenate([affine, target[live, :, None]], axis=2), np.empty(len(live), np.bool_)
        trust = options.anchor, options.anchor_change, options.anchor_gain, options.anchor_scale
        limits = *trust, options.appearance, options.appearance_floor
        compare(self._image, pose, *self._starts, self.window.pixels, limits, alike)
        target, alive = target.copy(), alive.copy()
        target[live], alive[live] = pose[..., 2], alike
        self._row, self._affine = np.flatnonzero(alike), pose[alike, :, :2]
        self._new = self._image, start[:0]
        return target, alive
