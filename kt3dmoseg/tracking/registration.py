"""Affine registration of patches with the way they looked at their start, all at once."""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np
import numpy.typing as npt

from kt3dmoseg.tracking.options import TrackOptions
from kt3dmoseg.tracking.patches import Window
from kt3dmoseg.types import Float32Array, FloatArray

CHUNK = 256  # trajectories whose arrays stay in the processor's cache
_FEW = 64  # and their products
_LEAST = 1e-3  # keeps the equations of a flat patch solvable: it then stays where it is
_AFFINE = [0, 1, 3, 4]


class Starts(NamedTuple):
    """What is known of N patches from their start.

    Attributes
    ----------
    patch : (N, 3, P) float32
        T less its weighted mean, its x- and its y-derivative.
    variance : (N,) float32
        Weighted mean of T^2.
    inverse : (N, 6, 6) float32
        Takes the right side of the equations to the change of place; see `correction`.
    """

    patch: Float32Array
    variance: Float32Array
    inverse: Float32Array

    def at(self, rows: npt.NDArray[np.intp]) -> Starts:
        """Return some of them."""
        return Starts(*(field[rows] for field in self))

    def put(self, rows: npt.NDArray[np.intp], others: Starts) -> None:
        """Put others in the place of some of them."""
        for field, values in zip(self, others, strict=True):
            field[rows] = values

    def and_more(self, count: int) -> Starts:
        """Return these and place for so many others."""
        return Starts(*(np.concatenate([f, np.zeros((count, *f.shape[1:]), f.dtype)]) for f in self))


def remember(patch: Float32Array, window: Window, options: TrackOptions) -> Starts:
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
    """H, (N, 8, 8), from the moments over the window of T, Tx, Ty and of their products."""
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
    """Where patches lie beside their start's appearance: a step of inverse compositional Lucas-Kanade.

    Minimised, over the position x, the affine map A, the gain g and the brightness b, is

        sum over offsets d of weight(d) rho(r(d)),    r(d) = I(A d + x) - (1 + g) T(d) - b,

    with the start's patch T. The change of place is sought on the side of T, whose derivatives stay the same
    (Baker and Matthews, IJCV 2004, section 3.2; gain and brightness: linear appearance variation, Baker,
    Gross and Matthews, CMU-RI-TR-03-35, 2003):

        (H + P) q = sum of w s r / sum of w,    H = sum of weight s s^T,
        s = (dx Tx, dy Tx, Tx, dx Ty, dy Ty, Ty, T, 1),

    and [A x] <- [A x] - A [B t] with the first six of q, row by row, as [B t]; g and b, which fit r best, are
    taken out of it before, so the last two of the right side are 0. rho is the Lorentzian of scale
    `anchor_scale` (Black and Anandan, CVIU 1996): w = weight / (1 + (r / scale)^2) with the r of g = 0, so
    what is hidden or belongs to another object counts less. That H is the one without rho, known from the
    start, changes the length of the step, not where it ends. P holds A where the patch does not tell:
    `anchor_stiffness` on the diagonal at B.

    Parameters
    ----------
    rest : (N, P) float32
        r for g = 0, less its weighted mean.
    start : Starts
        T, and the six rows and columns of (H + P)^-1 that belong to the place.
    window : Window
        Offsets d and their weights.
    options : TrackOptions
        `anchor_scale`.

    Returns
    -------
    (N, 2, 3) float32
        [B t], in pixels.
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
