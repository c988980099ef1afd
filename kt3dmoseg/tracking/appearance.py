"""What every trajectory looked like at its start: to correct where it is, and to stop it where it is gone.

Gray values are seen through an affine map in windows about points (`Window`), registered with the start
(`correction`) and compared with it (`Appearance`).
"""

from __future__ import annotations

from typing import NamedTuple, cast

import cv2
import numpy as np

from kt3dmoseg.tracking.linking import gradient, inside
from kt3dmoseg.tracking.options import TrackOptions
from kt3dmoseg.types import BoolArray, ByteArray, Float32Array, FloatArray

_ROWS = 4096  # OpenCV's remap takes fewer than 32,768
_POLE = np.sqrt(8) - 3  # of the inverse of (1, 6, 1) / 8
_SHARPEN = _POLE ** np.abs(np.arange(-4, 5))
_SHARPEN = (_SHARPEN / _SHARPEN.sum()).astype(np.float32)
_EDGE = 2  # pixels beyond which `cv2.pyrUp` takes no account of the lower and right border
_CHUNK = 256  # trajectories whose arrays stay in the processor's cache
_FEW = 64  # and their products
_LEAST = 1e-3  # keeps the equations of a flat patch solvable: it then stays where it is
_AFFINE = [0, 1, 3, 4]
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
        self.lattice = self._square[:, self._disc]
        weight = np.exp(-2 * (self.lattice[:2] ** 2).sum(axis=0) / radius**2)
        self.weight = cast(Float32Array, weight / weight.sum())

    def look(self, image: Float32Array, pose: FloatArray, square: bool = False) -> Float32Array:
        """Gray values (N, P) at A d + x for all offsets d in a `doubled` frame, whose edge is continued.

        `pose` (N, 2, 3) float64 holds A and x in pixels, side by side. Of a `square`, it is all pixels of the
        square about the disc.
        """
        lattice = self._square if square else self.lattice
        # What takes rows A, x to the positions A d + x in the doubled image, x and y in turns.
        spread = (2 * np.eye(2, dtype=np.float32)[:, None, None] * lattice[..., None]).reshape(6, -1)
        rows = pose.reshape(-1, 6).astype(np.float32)
        out = np.empty((len(rows), lattice.shape[1]), dtype=np.float32)
        for first in range(0, len(rows), _ROWS):
            part = slice(first, first + _ROWS)
            at = (rows[part] @ spread).reshape(-1, lattice.shape[1], 2)
            out[part] = cv2.remap(  # type: ignore[call-overload]  # the stubs lack the form with one map
                image, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
        return out

    def start(self, image: Float32Array, xy: FloatArray) -> Float32Array:
        """Upright patches about points (N, 2) and their x- and y-derivatives, (N, 3, P)."""
        upright = np.broadcast_to(np.eye(2), (len(xy), 2, 2))
        seen = self.look(image, np.concatenate([upright, xy[..., None]], axis=2), square=True)
        disc = self._disc
        slopes = ((seen[:, disc + step] - seen[:, disc - step]) / 2 for step in (1, self._side))
        return np.ascontiguousarray(np.stack([seen[:, disc], *slopes], axis=1))

    def centred(self, patch: Float32Array) -> Float32Array:
        """Patches (N, P) less their weighted means, so that a change of brightness does not count."""
        return cast(Float32Array, patch - (patch @ self.weight)[:, None])


class Starts(NamedTuple):
    """What is known of N patches from their start."""

    patch: Float32Array  # (N, 3, P): T less its weighted mean, its x- and its y-derivative
    variance: Float32Array  # (N,): weighted mean of T^2
    inverse: Float32Array  # (N, 6, 6): from the right side in `correction` to the change of pose


def prepare(patch: Float32Array, window: Window, options: TrackOptions) -> Starts:
    """Make ready for registration what `Window.start` has seen, (N, 3, P)."""
    patch[:, 0] = window.centred(patch[:, 0])
    parts = [_normal(patch[first : first + _FEW], window) for first in range(0, len(patch), _FEW)]
    normal = np.concatenate([np.zeros((0, 8, 8)), *parts])
    variance = normal[:, 6, 6].astype(np.float32)
    diagonal = np.einsum("nii->ni", normal)
    diagonal *= 1 + 1e-4
    diagonal += _LEAST
    diagonal[:, _AFFINE] += options.anchor_stiffness
    return Starts(patch, variance, np.linalg.inv(normal)[:, :6, :6].astype(np.float32))


def _normal(patch: Float32Array, window: Window) -> FloatArray:
    """H (N, 8, 8) from the moments over the window of T, Tx, Ty and of their products."""
    count, pixels = len(patch), len(window.weight)
    weighted = window.lattice * window.weight
    second = (window.lattice[:, None] * weighted).reshape(9, pixels).T
    products = (patch[:, :, None] * patch[:, None]).reshape(-1, pixels)
    pairs = (products @ second).reshape(count, 3, 3, 3, 3)
    singles = (patch.reshape(-1, pixels) @ weighted.T).reshape(count, 3, 3)
    out = np.empty((count, 8, 8))
    out[:, :6, :6] = pairs[:, 1:, 1:].swapaxes(2, 3).reshape(count, 6, 6)
    out[:, 6, :6] = out[:, :6, 6] = pairs[:, 0, 1:, 2].reshape(count, 6)
    out[:, 7, :6] = out[:, :6, 7] = singles[:, 1:].reshape(count, 6)
    out[:, 6:, 6:] = [[0, 0], [0, 1]]
    out[:, 6, 6] = pairs[:, 0, 0, 2, 2]
    return out


def correction(rest: Float32Array, start: Starts, window: Window, options: TrackOptions) -> Float32Array:
    """How far patches are off from their start, (N, 2, 3): a step of inverse compositional Lucas-Kanade.

    Minimised, over the position x, the affine map A, the gain g and the brightness b, is

        sum over offsets d of weight(d) rho(r(d)),    r(d) = I(A d + x) - (1 + g) T(d) - b,

    with the start's patch T. The change of pose is sought on the side of T, whose derivatives stay the same
    (Baker and Matthews, IJCV 2004, section 3.2; gain and brightness: linear appearance variation, Baker,
    Gross and Matthews, CMU-RI-TR-03-35, 2003):

        (H + P) q = sum of w s r / sum of w,    H = sum of weight s s^T,
        s = (dx Tx, dy Tx, Tx, dx Ty, dy Ty, Ty, T, 1),

    and [A x] <- [A x] - A [B t] with the first six of q as [B t], which is returned; g and b, which fit r
    best, are taken out of it before. `rest` (N, P) is r for g = 0, less its weighted mean. rho is the
    Lorentzian of scale `anchor_scale` (Black and Anandan, CVIU 1996): w = weight / (1 + (r / scale)^2) with
    that r, so what is hidden or belongs to another object counts less; H without rho changes the length of
    the step, not where it ends. P holds A where the patch does not determine it: `anchor_stiffness` at B.
    """
    weight = window.weight / (1 + (rest / options.anchor_scale) ** 2)
    total, texture, pull = weight.sum(axis=1), weight * start.patch[:, 0], weight * rest
    gain = _dot(texture, rest) / (_dot(texture, start.patch[:, 0]) + _LEAST)
    pull -= gain[:, None] * texture
    pull -= (pull.sum(axis=1) / total)[:, None] * weight
    weighted = (start.patch[:, 1:] * pull[:, None]).reshape(-1, len(window.weight))
    right = (weighted @ window.lattice.T).reshape(-1, 6, 1)
    return cast(Float32Array, (start.inverse @ right).reshape(-1, 2, 3) / total[:, None, None])


def _dot(a: Float32Array, b: Float32Array) -> Float32Array:
    return cast(Float32Array, np.einsum("np,np->n", a, b))


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
        self._size: tuple[int, ...] = (0, 0)

    def look_at(self, frame: ByteArray) -> None:
        """Look at the next frame (H, W) uint8; what follows happens in it."""
        self._image, self._size = doubled(frame), frame.shape

    def add(self, xy: FloatArray) -> None:
        """Keep how new trajectories (N, 2) look; they come after all that are alive."""
        new = prepare(self.window.start(self._image, xy), self.window, self.options)
        both = zip(self._starts, new, strict=True)
        self._starts = Starts(*(np.concatenate([old[self._row], more]) for old, more in both))
        self._row = np.arange(len(self._row) + len(xy))
        self._affine = np.concatenate([self._affine, np.broadcast_to(np.eye(2), (len(xy), 2, 2))])

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
        live = np.flatnonzero(alive)
        affine = (np.eye(2) + gradient(forward, xy[live], _REACH)) @ self._affine[live]
        pose, alike = np.concatenate([affine, target[live, :, None]], axis=2), np.ones(len(live), np.bool_)
        for first in range(0, len(live), _CHUNK):
            part = slice(first, first + _CHUNK)
            start = Starts(*(field[self._row[live[part]]] for field in self._starts))
            pose[part], alike[part] = self._compared(pose[part], start)
        target, alive = target.copy(), alive.copy()
        target[live], alive[live] = pose[..., 2], alike
        self._row, self._affine = self._row[live[alike]], pose[alike, :, :2]
        return target, alive

    def _compared(self, pose: FloatArray, start: Starts) -> tuple[FloatArray, BoolArray]:
        options, floor, rest = self.options, self.options.appearance_floor, self._rest(pose, start)
        change = rest**2 @ self.window.weight
        if options.anchor:
            step = -pose[..., :2] @ correction(rest, start, self.window, options)
            after = self._rest(pose + step, start) ** 2 @ self.window.weight
            better = after < np.minimum(change, options.anchor_change * start.variance + floor)
            better &= np.hypot(*step[..., 2].T) <= options.anchor
            better &= inside(pose[..., 2] + step[..., 2], self._size)
            pose = pose + options.anchor_gain * np.where(better[:, None, None], step, 0)
            change = np.where(better, after, change)
        limit = options.appearance * start.variance + floor if options.appearance else np.inf
        return pose, change <= limit

    def _rest(self, pose: FloatArray, start: Starts) -> Float32Array:
        return self.window.centred(self.window.look(self._image, pose)) - start.patch[:, 0]
