"""What every trajectory looked like at its start: to correct where it is, and to stop it where it is gone.

Gray values are seen through an affine map in windows about points (`Window`), registered with the start
(`correction`) and compared with it (`Appearance`).
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple, TypeAlias, cast

import cv2
import numpy as np

from kt3dmoseg.compiled import compiled
from kt3dmoseg.tracking.linking import gradient
from kt3dmoseg.tracking.options import TrackOptions
from kt3dmoseg.types import BoolArray, ByteArray, Float32Array, FloatArray

View: TypeAlias = "tuple[Float32Array, np.uint32, int, int]"

_POLE = np.sqrt(8) - 3  # of the inverse of (1, 6, 1) / 8
_SHARPEN = _POLE ** np.abs(np.arange(-4, 5))
_SHARPEN = (_SHARPEN / _SHARPEN.sum()).astype(np.float32)
_EDGE = 2  # pixels beyond which `cv2.pyrUp` takes no account of the lower and right border
_LEAST = 1e-3  # keeps the equations of a flat patch solvable: it then stays where it is
_REACH = 4  # pixels on either side over which the derivatives of the flow are taken

_summed = partial(compiled, fastmath={"contract", "reassoc"})  # sums are taken in the quickest order


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


class Window:
    """A disc of P pixels with weights that fall off with the distance from its centre.

    The `weight`, (P,) float32 with sum 1, is a Gaussian of sigma R / 2: what lies beyond an outline at the
    rim counts little. `lattice` (3, P) holds x and y of the pixels from the centre, and 1.
    """

    def __init__(self, radius: int) -> None:
        side = np.arange(-radius - 1, radius + 2, dtype=np.float32)
        x, y = (axis.ravel() for axis in np.meshgrid(side, side))
        self._disc, self._side = np.flatnonzero(x**2 + y**2 <= (radius + 0.5) ** 2), len(side)
        self._square = np.stack([x, y, np.ones_like(x)])
        self.lattice = self._square.take(self._disc, axis=1)
        weight = np.exp(-2 * (self.lattice[:2] ** 2).sum(axis=0) / radius**2)
        self.weight = cast(Float32Array, weight / weight.sum())

    def look(self, image: Float32Array, pose: FloatArray) -> Float32Array:
        """Gray values (N, P) at A d + x for all offsets d in a `doubled` frame, whose edge is continued.

        `pose` (N, 2, 3) float64 holds A and x in pixels, side by side.
        """
        out = np.empty((len(pose), len(self.weight)), np.float32)
        _look(_view(image), pose, self.lattice, out)
        return out

    def start(self, image: Float32Array, xy: FloatArray) -> Float32Array:
        """Upright patches about points (N, 2) and their x- and y-derivatives, (N, 3, P)."""
        upright = np.broadcast_to(np.eye(2), (len(xy), 2, 2))
        seen = np.empty((len(xy), self._square.shape[1]), np.float32)
        _look(_view(image), np.concatenate([upright, xy[..., None]], axis=2), self._square, seen)
        out = np.empty((len(xy), 3, len(self.weight)), np.float32)
        _slopes(seen, self._disc, self._side, out)
        return out


def _view(image: Float32Array) -> View:
    """Gray values in a row, the distance of an image's lines in it, and its height and width."""
    (height, width), stride = image.shape, image.strides[0] // 4
    values = np.lib.stride_tricks.as_strided(image, ((height - 1) * stride + width,), (4,), writeable=False)
    return values, np.uint32(stride), height, width


@_summed
def _look(view: View, pose: FloatArray, lattice: Float32Array, out: Float32Array) -> None:
    at, part = np.empty(lattice.shape[1], np.uint32), np.empty((2, lattice.shape[1]), np.float32)
    for n in range(len(pose)):
        _see(view, pose[n], lattice, at, part, out[n])


@_summed
def _slopes(seen: Float32Array, disc: Any, side: int, out: Float32Array) -> None:  # noqa: ANN401
    half = np.float32(0.5)
    for n in range(len(seen)):
        row = seen[n]
        for p in range(len(disc)):
            k = disc[p]
            out[n, 0, p] = row[k]
            out[n, 1, p], out[n, 2, p] = (
                half * (row[k + 1] - row[k - 1]),
                half * (row[k + side] - row[k - side]),
            )


@_summed
def _see(
    view: View, pose: FloatArray, lattice: Float32Array, at: Any, part: Float32Array, seen: Float32Array
) -> None:  # noqa: ANN401
    """Gray values (P,): where they lie is found first, in loops that are vectorised."""
    values, stride, height, width = view
    right, bottom, zero = np.float32(width - 1), np.float32(height - 1), np.float32(0)
    a, b, c = np.float32(2 * pose[0, 0]), np.float32(2 * pose[0, 1]), np.float32(2 * pose[0, 2])
    d, e, f = np.float32(2 * pose[1, 0]), np.float32(2 * pose[1, 1]), np.float32(2 * pose[1, 2])
    along, down, fx, fy = lattice[0], lattice[1], part[0], part[1]
    for p in range(len(seen)):
        x, y = a * along[p] + b * down[p] + c, d * along[p] + e * down[p] + f
        x, y = x if x > zero else zero, y if y > zero else zero  # also where it is NaN
        x, y = x if x < right else right, y if y < bottom else bottom
        j, i = min(np.int32(x), np.int32(width - 2)), min(np.int32(y), np.int32(height - 2))
        fx[p], fy[p], at[p] = x - np.float32(j), y - np.float32(i), i * stride + j
    for p in range(len(seen)):
        k = at[p]
        m = k + stride
        upper = values[k] + fx[p] * (values[k + np.uint32(1)] - values[k])
        seen[p] = upper + fy[p] * (values[m] + fx[p] * (values[m + np.uint32(1)] - values[m]) - upper)


class Starts(NamedTuple):
    """What is known of N patches from their start."""

    patch: Float32Array  # (N, 3, P): T less its weighted mean, its x- and its y-derivative
    variance: Float32Array  # (N,): weighted mean of T^2
    inverse: Float32Array  # (N, 6, 6): from the right side in `correction` to the change of pose


def prepare(patch: Float32Array, window: Window, options: TrackOptions) -> Starts:
    """Make ready for registration what `Window.start` has seen, (N, 3, P)."""
    variance, inverse = np.empty(len(patch), np.float32), np.empty((len(patch), 6, 6), np.float32)
    _prepare(patch, window.lattice, window.weight, options.anchor_stiffness, variance, inverse)
    return Starts(patch, variance, inverse)


@_summed
def _prepare(
    patch: Float32Array,
    lattice: Float32Array,
    weight: Float32Array,
    stiffness: float,
    variance: Float32Array,
    inverse: Float32Array,
) -> None:
    slopes, normal = np.empty((8, len(weight)), np.float32), np.empty((8, 8))
    for n in range(len(patch)):
        value, mean = patch[n, 0], np.float32(0)
        for p in range(len(weight)):
            mean += weight[p] * value[p]
        for p in range(len(weight)):
            value[p] -= mean
            slopes[6, p], slopes[7, p] = value[p], 1
        for k in range(6):
            slope, axis, row = patch[n, 1 + k // 3], lattice[k % 3], slopes[k]
            for p in range(len(weight)):
                row[p] = slope[p] * axis[p]
        _multiply(slopes, weight, normal)
        variance[n] = normal[6, 6]
        for k in range(8):
            normal[k, k] += _LEAST + 1e-4 * normal[k, k] + (stiffness if k in (0, 1, 3, 4) else 0)
        _invert(normal, inverse[n])


@_summed
def _multiply(slopes: Float32Array, weight: Float32Array, normal: FloatArray) -> None:
    for i in range(8):
        for j in range(i + 1):
            one, other, total = slopes[i], slopes[j], np.float32(0)
            for p in range(len(weight)):
                total += weight[p] * one[p] * other[p]
            normal[i, j] = normal[j, i] = total


@_summed
def _invert(normal: FloatArray, inverse: Float32Array) -> None:
    """Write the upper left of an inverse (8, 8): Gauss-Jordan needs no pivots, the matrix is positive definite."""
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
def _correct(
    rest: Float32Array,
    start: Float32Array,
    inverse: Float32Array,
    lattice: Float32Array,
    weight: Float32Array,
    scale: np.float32,
    pull: Float32Array,
    step: FloatArray,
) -> None:
    """Find how far a patch is off from its start, `step` (2, 3), by inverse compositional Lucas-Kanade.

    Minimised, over the position x, the affine map A, the gain g and the brightness b, is

        sum over offsets d of weight(d) rho(r(d)),    r(d) = I(A d + x) - (1 + g) T(d) - b,

    with the start's patch T. The change of pose is sought on the side of T, whose derivatives stay the same
    (Baker and Matthews, IJCV 2004, section 3.2; gain and brightness: linear appearance variation, Baker,
    Gross and Matthews, CMU-RI-TR-03-35, 2003):

        (H + P) q = sum of w s r / sum of w,    H = sum of weight s s^T,
        s = (dx Tx, dy Tx, Tx, dx Ty, dy Ty, Ty, T, 1),

    and [A x] <- [A x] - A [B t] with the first six of q as [B t], which is returned; g and b, which fit r
    best, are taken out of it before. `rest` (P,) is r for g = 0, less its weighted mean. rho is the
    Lorentzian of scale `anchor_scale` (Black and Anandan, CVIU 1996): w = weight / (1 + (r / scale)^2) with
    that r, so what is hidden or belongs to another object counts less; H without rho changes the length of
    the step, not where it ends. P holds A where the patch does not determine it: `anchor_stiffness` at B.
    """
    one, total, texture, contrast = np.float32(1), np.float32(0), np.float32(0), np.float32(_LEAST)
    value, mixed, mean = start[0], np.float32(0), np.float32(0)
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
        slope, axis, right = start[1 + k // 3], lattice[k % 3], np.float32(0)
        for p in range(len(weight)):
            right += pull[p] * slope[p] * axis[p]
        for m in range(6):
            step[m // 3, m % 3] += inverse[m, k] * right / total


@_summed
def _compare(
    view: View,
    pose: FloatArray,
    start: tuple[Float32Array, Float32Array, Float32Array],
    lattice: Float32Array,
    weight: Float32Array,
    limits: tuple[float, float, float, float, float, float],
    alike: BoolArray,
) -> None:
    """Correct poses (N, 2, 3) in place where that is better; which patches look alike (N,)."""
    patch, variance, inverse = start
    anchor, anchor_change, anchor_gain, anchor_scale, appearance, floor = limits
    at, part = np.empty(len(weight), np.uint32), np.empty((2, len(weight)), np.float32)
    rest, step, tried = np.empty(len(weight), np.float32), np.empty((2, 3)), np.empty((2, 3))
    for n in range(len(pose)):
        here, mine = pose[n], patch[n]
        change = _change(view, here, mine[0], lattice, weight, at, part, rest)
        if anchor > 0:
            _correct(rest, mine, inverse[n], lattice, weight, np.float32(anchor_scale), part[0], step)
            for i in range(2):
                for j in range(3):
                    tried[i, j] = here[i, j] - (here[i, 0] * step[0, j] + here[i, 1] * step[1, j])
            x, y = tried[0, 2], tried[1, 2]
            near = np.hypot(x - here[0, 2], y - here[1, 2]) <= anchor
            if near and -0.5 <= x <= view[3] / 2 - 0.5 and -0.5 <= y <= view[2] / 2 - 0.5:
                after = _change(view, tried, mine[0], lattice, weight, at, part, rest)
                if after < min(change, anchor_change * variance[n] + floor):
                    change = after
                    for i in range(2):
                        for j in range(3):
                            here[i, j] += anchor_gain * (tried[i, j] - here[i, j])
        alike[n] = change <= appearance * variance[n] + floor


@_summed
def _change(
    view: View,
    pose: FloatArray,
    start: Float32Array,
    lattice: Float32Array,
    weight: Float32Array,
    at: Any,  # noqa: ANN401
    part: Float32Array,
    rest: Float32Array,
) -> np.float32:
    """Find what differs from a start, less its weighted mean, (P,), and return the weighted mean of its square."""
    _see(view, pose, lattice, at, part, rest)
    mean, square = np.float32(0), np.float32(0)
    for p in range(len(weight)):
        mean += weight[p] * rest[p]
    for p in range(len(weight)):
        rest[p] -= mean + start[p]
        square += weight[p] * rest[p] * rest[p]
    return square


class Appearance:
    """The patches in which the live trajectories started, and how each has been deformed since.

    The errors of single steps add up along a trajectory; the patch in which it started does not change
    (Shi and Tomasi, CVPR 1994, compare with the first frame for this reason). And where forward and
    backward flow agree on an error, as beyond the outline of an object, what the point shows changes.
    """

    def __init__(self, options: TrackOptions) -> None:
        self.options, self.window = options, Window(options.patch_radius)
        nothing = np.zeros((0, 3, len(self.window.weight)), dtype=np.float32)
        self._starts, self._row = prepare(nothing, self.window, options), np.arange(0)
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
        live, old, options = np.flatnonzero(alive), len(self._row), self.options
        image, start = self._new
        new = prepare(self.window.start(image, start[live[live >= old] - old]), self.window, options)
        row = self._row[live[live < old]]
        self._starts = Starts(*(np.concatenate([kept[row], more]) for kept, more in zip(self._starts, new)))
        affine = np.concatenate(
            [self._affine[live[live < old]], np.broadcast_to(np.eye(2), (len(new.variance), 2, 2))]
        )
        affine = (np.eye(2) + gradient(forward, xy[live], _REACH)) @ affine
        pose, alike = np.concatenate([affine, target[live, :, None]], axis=2), np.empty(len(live), np.bool_)
        limits = options.anchor, options.anchor_change, options.anchor_gain, options.anchor_scale
        limits += options.appearance or np.inf, options.appearance_floor
        _compare(
            _view(self._image),
            pose,
            tuple(self._starts),
            self.window.lattice,
            self.window.weight,
            limits,
            alike,
        )
        target, alive = target.copy(), alive.copy()
        target[live], alive[live] = pose[..., 2], alike
        self._row, self._affine, self._new = (
            np.flatnonzero(alike),
            pose[alike, :, :2],
            (self._image, np.zeros((0, 2))),
        )
        return target, alive
