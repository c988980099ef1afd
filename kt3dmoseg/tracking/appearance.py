"""What every trajectory looked like at its start: to correct where it is, and to stop it where it is gone.

Gray values are seen through an affine map in windows about points (`Window`), registered with the start
and compared with it (`Appearance`). The loops over patches are compiled. There a patch has P pixels; `window`
(4, P) holds their x and y from its centre, 1, and their weight.
"""

from functools import partial
from typing import NamedTuple, TypeAlias, cast

import cv2
import numpy as np
import numpy.typing as npt

from kt3dmoseg.compiled import compiled
from kt3dmoseg.tracking import TrackOptions
from kt3dmoseg.tracking.linking import gradient
from kt3dmoseg.types import BoolArray, ByteArray, FloatArray
from kt3dmoseg.types import Float32Array as Array

Indices: TypeAlias = npt.NDArray[np.uint32]

_POLE = np.sqrt(8) - 3  # of the inverse of (1, 6, 1) / 8
_SHARPEN = _POLE ** np.abs(np.arange(-4, 5))
_SHARPEN = (_SHARPEN / _SHARPEN.sum()).astype(np.float32)
_EDGE = 2  # pixels beyond which `cv2.pyrUp` takes no account of the lower and right border
_REACH = 4  # pixels on either side over which the derivatives of the flow are taken
_LEAST = 1e-3  # keeps the equations of a flat patch solvable: it then stays where it is

_summed = partial(compiled, fastmath={"contract", "reassoc"})  # sums are taken in the quickest order


def doubled(frame: ByteArray) -> Array:
    """Interpolate a frame (H, W) at every half pixel, (2H, 2W).

    By a cubic spline: `cv2.pyrUp` refines the spline's coefficients, which a filter with the inverse of its
    kernel finds first (Unser, IEEE Signal Processing Magazine 1999). Bilinear look-up in the result errs far
    less than in the frame, and unlike OpenCV's bicubic one (a = -0.75), which is up to 0.05 px off, it is
    exact on a ramp.
    """
    height, width = frame.shape
    around = cv2.copyMakeBorder(frame, 0, _EDGE, 0, _EDGE, cv2.BORDER_REFLECT_101)
    coefficients = cv2.sepFilter2D(around, cv2.CV_32F, _SHARPEN, _SHARPEN, borderType=cv2.BORDER_REFLECT_101)
    return cast(Array, cv2.pyrUp(coefficients)[: 2 * height, : 2 * width])


class Starts(NamedTuple):
    """What is known of N patches from their start."""

    patch: Array  # (N, 3, P): T less its weighted mean, its x- and its y-derivative
    variance: Array  # (N,): weighted mean of T^2
    inverse: Array  # (N, 6, 6): from the right side in `_correct` to the change of pose


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
        self.weight = cast(Array, weight / weight.sum())
        self.pixels = np.array([*self.lattice, self.weight])

    def start(self, image: Array, xy: FloatArray) -> Array:
        """Upright patches about points (N, 2) and their x- and y-derivatives, (N, 3, P)."""
        patch = np.empty((len(xy), 3, len(self.weight)), np.float32)
        _begin(image, xy, self._square, self.pixels, patch)
        return patch

    def prepare(self, patch: Array, options: TrackOptions) -> Starts:
        """Make ready for registration what `start` has seen, (N, 3, P)."""
        count = len(patch)
        known = Starts(patch, np.empty(count, np.float32), np.empty((count, 6, 6), np.float32))
        _prepare(patch, self.pixels, options.anchor_stiffness, *known[1:])
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
        self, forward: Array, xy: FloatArray, target: FloatArray, alive: BoolArray
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
        _compare(self._image, pose, *self._starts, self.window.pixels, limits, alike)
        target, alive = target.copy(), alive.copy()
        target[live], alive[live] = pose[..., 2], alike
        self._row, self._affine = np.flatnonzero(alike), pose[alike, :, :2]
        self._new = self._image, start[:0]
        return target, alive


@_summed
def _see(
    image: Array,
    pose: FloatArray,
    window: Array,
    at: Indices,
    part: Array,
    seen: Array,
) -> None:
    """Gray values (P,) at A d + x for all offsets d; `pose` (2, 3) is [A x]. The edge is continued.

    Where they lie is found first, in a loop that is vectorised.
    """
    height, width = image.shape
    right, bottom, zero = np.float32(width - 1), np.float32(height - 1), np.float32(0)
    a, b, c = np.float32(2 * pose[0, 0]), np.float32(2 * pose[0, 1]), np.float32(2 * pose[0, 2])
    d, e, f = np.float32(2 * pose[1, 0]), np.float32(2 * pose[1, 1]), np.float32(2 * pose[1, 2])
    along, down, fx, fy, row, column = window[0], window[1], part[0], part[1], at[0], at[1]
    for p in range(len(seen)):
        x, y = a * along[p] + b * down[p] + c, d * along[p] + e * down[p] + f
        x, y = x if x > zero else zero, y if y > zero else zero  # also where it is NaN
        x, y = x if x < right else right, y if y < bottom else bottom
        row[p], column[p] = min(np.int32(y), np.int32(height - 2)), min(np.int32(x), np.int32(width - 2))
        fx[p], fy[p] = x - np.float32(column[p]), y - np.float32(row[p])
    one = np.uint32(1)
    for p in range(len(seen)):
        i, k = row[p], column[p]
        upper = image[i, k] + fx[p] * (image[i, k + one] - image[i, k])
        lower = image[i + one, k] + fx[p] * (image[i + one, k + one] - image[i + one, k])
        seen[p] = upper + fy[p] * (lower - upper)


@_summed
def _begin(image: Array, xy: FloatArray, square: Array, window: Array, patch: Array) -> None:
    """Upright patches about points (N, 2) and their x- and y-derivatives, from the `square` about them."""
    size, side, half = square.shape[1], round(np.sqrt(square.shape[1])), np.float32(0.5)
    at, part, seen = np.empty((2, size), np.uint32), np.empty((2, size), np.float32), np.empty_like(square[0])
    index, pose = np.empty(window.shape[1], np.int64), np.eye(2, 3)
    for p in range(len(index)):
        index[p] = size // 2 + side * window[1, p] + window[0, p]
    for n in range(len(xy)):
        pose[0, 2], pose[1, 2] = xy[n, 0], xy[n, 1]
        _see(image, pose, square, at, part, seen)
        value, right, down = patch[n, 0], patch[n, 1], patch[n, 2]
        for p in range(len(index)):
            k = index[p]
            value[p], right[p] = seen[k], half * (seen[k + 1] - seen[k - 1])
            down[p] = half * (seen[k + side] - seen[k - side])


@_summed
def _prepare(patch: Array, window: Array, stiffness: float, variance: Array, inverse: Array) -> None:
    """Take the mean from patches, and fill in the rest of what `Starts` holds of them."""
    slopes, normal, weight = np.empty((8, window.shape[1]), np.float32), np.empty((8, 8)), window[3]
    for n in range(len(patch)):
        value, mean = patch[n, 0], np.float32(0)
        for p in range(len(weight)):
            mean += weight[p] * value[p]
        for p in range(len(weight)):
            value[p] -= mean
            slopes[6, p], slopes[7, p] = value[p], 1
        for k in range(6):
            slope, axis, row = patch[n, 1 + k // 3], window[k % 3], slopes[k]
            for p in range(len(weight)):
                row[p] = slope[p] * axis[p]
        _multiply(slopes, weight, normal)
        variance[n] = normal[6, 6]
        for k in range(8):
            normal[k, k] += _LEAST + 1e-4 * normal[k, k] + (stiffness if k in (0, 1, 3, 4) else 0)
        _invert(normal, inverse[n])


@_summed
def _multiply(slopes: Array, weight: Array, normal: FloatArray) -> None:
    for i in range(8):
        for j in range(i + 1):
            one, other, total = slopes[i], slopes[j], np.float32(0)
            for p in range(len(weight)):
                total += weight[p] * one[p] * other[p]
            normal[i, j] = normal[j, i] = total


@_summed
def _invert(normal: FloatArray, inverse: Array) -> None:
    """Write the upper left of the inverse: by Gauss-Jordan without pivots, for it is positive definite."""
    for k in range(8):
        pivot, normal[k, k] = normal[k, k], 1
        for j in range(8):
            normal[k, j] /= pivot
        for i in range(8):
            factor, normal[i, k] = (0.0, normal[i, k]) if i == k else (normal[i, k], 0.0)
            for j in range(8):
                normal[i, j] -= factor * normal[k, j]
    for i in range(6):
        for j in range(6):
            inverse[i, j] = normal[i, j]


@_summed
def _compare(
    image: Array,
    pose: FloatArray,
    patch: Array,
    variance: Array,
    inverse: Array,
    window: Array,
    limits: tuple[float, ...],
    alike: BoolArray,
) -> None:
    """Correct poses (N, 2, 3) in place where that is better; which patches look alike (N,).

    The starts are those of `Starts`, the limits those of `Appearance.follow`.
    """
    anchor, anchor_change, gain, scale, appearance, floor = limits
    at, part = np.empty((2, window.shape[1]), np.uint32), np.empty((2, window.shape[1]), np.float32)
    rest, step, tried = np.empty(window.shape[1], np.float32), np.empty((2, 3)), np.empty((2, 3))
    for n in range(len(pose)):
        start, here = patch[n], pose[n]
        change = _change(image, here, start[0], window, at, part, rest)
        if anchor > 0:
            _correct(rest, start, inverse[n], window, np.float32(scale), part[0], step)
            for k in range(6):
                i, j = k // 3, k % 3
                tried[i, j] = here[i, j] - here[i, 0] * step[0, j] - here[i, 1] * step[1, j]
            x, y = tried[0, 2], tried[1, 2]
            near = np.hypot(x - here[0, 2], y - here[1, 2]) <= anchor
            if near and -1 <= 2 * x <= image.shape[1] - 1 and -1 <= 2 * y <= image.shape[0] - 1:
                after = _change(image, tried, start[0], window, at, part, rest)
                if after < min(change, anchor_change * variance[n] + floor):
                    change = after
                    for k in range(6):
                        here[k // 3, k % 3] += gain * (tried[k // 3, k % 3] - here[k // 3, k % 3])
        alike[n] = appearance <= 0 or change <= appearance * variance[n] + floor


@_summed
def _change(
    image: Array,
    pose: FloatArray,
    start: Array,
    window: Array,
    at: Indices,
    part: Array,
    rest: Array,
) -> np.float32:
    """Find what differs from a start, less its weighted mean; return its weighted mean square."""
    _see(image, pose, window, at, part, rest)
    weight = window[3]
    mean, square = np.float32(0), np.float32(0)
    for p in range(len(weight)):
        mean += weight[p] * rest[p]
    for p in range(len(weight)):
        rest[p] -= mean + start[p]
        square += weight[p] * rest[p] * rest[p]
    return square


@_summed
def _correct(
    rest: Array,
    start: Array,
    inverse: Array,
    window: Array,
    scale: np.float32,
    pull: Array,
    step: FloatArray,
) -> None:
    """Find how far a patch is off from its start, [B t]: a step of inverse compositional Lucas-Kanade.

    Minimised, over the position x, the affine map A, the gain g and the brightness b, is

        sum over offsets d of weight(d) rho(r(d)),    r(d) = I(A d + x) - (1 + g) T(d) - b,

    with the start's patch T. The change of pose is sought on the side of T, whose derivatives stay the same
    (Baker and Matthews, IJCV 2004, section 3.2; gain and brightness: linear appearance variation, Baker,
    Gross and Matthews, CMU-RI-TR-03-35, 2003):

        (H + P) q = sum of w s r / sum of w,    H = sum of weight s s^T,
        s = (dx Tx, dy Tx, Tx, dx Ty, dy Ty, Ty, T, 1),

    and [A x] <- [A x] - A [B t] with the first six of q as [B t]; g and b, which fit r best, are taken out
    of it before. `rest` (P,) is r for g = 0, less its weighted mean. rho is the Lorentzian of scale
    `anchor_scale` (Black and Anandan, CVIU 1996): w = weight / (1 + (r / scale)^2) with that r, so what is
    hidden or belongs to another object counts less; H without rho changes the length of the step, not where
    it ends. P holds A where the patch does not determine it: `anchor_stiffness` at B.
    """
    one, total, texture, contrast = np.float32(1), np.float32(0), np.float32(0), np.float32(_LEAST)
    value, weight, mixed, mean = start[0], window[3], np.float32(0), np.float32(0)
    for p in range(len(weight)):
        ratio = rest[p] / scale
        pull[p] = weight[p] / (one + ratio * ratio)
    for p in range(len(weight)):
        total, mean, texture = total + pull[p], mean + pull[p] * rest[p], texture + pull[p] * value[p]
        contrast, mixed = contrast + pull[p] * value[p] * value[p], mixed + pull[p] * value[p] * rest[p]
    gain = mixed / contrast
    mean = (mean - gain * texture) / total
    for p in range(len(weight)):
        pull[p] *= rest[p] - gain * value[p] - mean
    step[:] = 0
    for k in range(6):
        slope, axis, right = start[1 + k // 3], window[k % 3], np.float32(0)
        for p in range(len(weight)):
            right += pull[p] * slope[p] * axis[p]
        for m in range(6):
            step[m // 3, m % 3] += inverse[m, k] * right / total
