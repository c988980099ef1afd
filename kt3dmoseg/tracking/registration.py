"""Patches seen through affine maps and registered with how they looked at their start, compiled.

A patch has P pixels; `window` (4, P) holds their x and y from its centre, 1, and their weight.
"""

from functools import partial
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.compiled import compiled
from kt3dmoseg.types import BoolArray, FloatArray
from kt3dmoseg.types import Float32Array as Array

Indices: TypeAlias = npt.NDArray[np.uint32]

_LEAST = 1e-3  # keeps the equations of a flat patch solvable: it then stays where it is

_summed = partial(compiled, fastmath={"contract", "reassoc"})  # sums are taken in the quickest order


@_summed
def _see(image: Array, pose: FloatArray, window: Array, at: Indices, part: Array, seen: Array) -> None:
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
def begin(image: Array, xy: FloatArray, square: Array, window: Array, patch: Array) -> None:
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
def prepare(patch: Array, window: Array, stiffness: float, variance: Array, inverse: Array) -> None:
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
def compare(
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
    image: Array, pose: FloatArray, start: Array, window: Array, at: Indices, part: Array, rest: Array
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
    rest: Array, start: Array, inverse: Array, window: Array, scale: np.float32, pull: Array, step: FloatArray
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
