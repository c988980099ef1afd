"""Affine registration of patches with the way they looked at their start, all at once."""

from __future__ import annotations

from typing import cast

import numpy as np

from kt3dmoseg.tracks.options import TrackOptions
from kt3dmoseg.tracks.patches import Window
from kt3dmoseg.types import Float32Array, FloatArray

_CHUNK = 256  # trajectories whose arrays stay in the processor's cache
_LEAST = 1e-3  # keeps the equations of a flat patch solvable: it then stays where it is
_AFFINE = slice(2, 6)


def register(
    image: Float32Array,
    seen: Float32Array,
    xy: FloatArray,
    affine: FloatArray,
    start: Float32Array,
    window: Window,
    options: TrackOptions,
) -> tuple[FloatArray, FloatArray]:
    """Refine where patches are by their appearance at the start, by inverse compositional Lucas-Kanade.

    Minimises, over the position x, the affine map A, the gain g and the brightness b,

        sum over offsets d of weight(d) rho(I(x + A d) - (1 + g) T(d) - b),

    with the start's patch T. In every iteration the change of x and A is sought on the side of T,
    whose derivatives stay the same (Baker and Matthews, IJCV 2004, section 3.2; gain and brightness: linear
    appearance variation, Baker, Gross and Matthews, CMU-RI-TR-03-35, 2003):

        (sum w s s^T + P) q = sum w s r,    r = I(x + A d) - T(d),
        s = (Tx, Ty, dx Tx, dy Tx, dx Ty, dy Ty, T, 1),

    and A <- A (1 + B)^-1, x <- x - A t with the t and B in q. rho is the Lorentzian of scale
    `anchor_scale` (Black and Anandan, CVIU 1996): w = weight / (1 + (r / scale)^2), r less its mean, so what
    is hidden or belongs to another object counts less. P holds A where the patch does not tell:
    `anchor_stiffness` on the diagonal at B.

    Parameters
    ----------
    image : (2H, 2W) float32
        The frame I, `doubled`.
    seen : (N, P) float32
        What it shows at the first guess.
    xy : (N, 2) float64
        First guess of x, in pixels.
    affine : (N, 2, 2) float64
        First guess of A.
    start : (N, 3, P) float32
        T, its x- and its y-derivative.
    window : Window
        Offsets d and their weights.
    options : TrackOptions
        `anchor` (no iteration moves farther), `anchor_iterations`, `anchor_scale`, `anchor_stiffness`.

    Returns
    -------
    xy : (N, 2) float64
        Wherever the iterations have led, which can be far off.
    affine : (N, 2, 2) float64
    """
    xy, affine = xy.copy(), affine.copy()
    for first in range(0, len(xy), _CHUNK):
        part = slice(first, first + _CHUNK)
        slopes = _slopes(start[part], window)
        for iteration in range(options.anchor_iterations):
            now = window.look(image, xy[part], affine[part]) if iteration else seen[part]
            rest = now - start[part, 0]
            q = _solve(slopes, rest, window, options)
            affine[part] = affine[part] @ _inverse(q[:, _AFFINE].reshape(-1, 2, 2))
            move = (affine[part] @ q[:, :2, None])[..., 0]
            xy[part] -= np.clip(move, -options.anchor, options.anchor)
    return xy, affine


def _slopes(start: Float32Array, window: Window) -> Float32Array:
    """How the residual changes with each of the eight parameters, (N, 8, P)."""
    value, dx, dy = start.swapaxes(0, 1)
    x, y = window.offset
    value = value - value.mean(axis=1, keepdims=True)
    return np.stack([dx, dy, dx * x, dx * y, dy * x, dy * y, value, np.ones_like(dx)], axis=1)


def _solve(slopes: Float32Array, rest: Float32Array, window: Window, options: TrackOptions) -> FloatArray:
    centred = rest - (rest @ window.weight)[:, None]
    weighted = slopes * (window.weight / (1 + (centred / options.anchor_scale) ** 2))[:, None]
    normal = (weighted @ slopes.swapaxes(1, 2)).astype(np.float64)
    right = (weighted @ rest[..., None]).astype(np.float64)
    diagonal = np.einsum("nii->ni", normal)
    diagonal *= 1 + 1e-4
    diagonal += _LEAST
    diagonal[:, _AFFINE] += options.anchor_stiffness
    return cast(FloatArray, np.linalg.solve(normal, right)[..., 0])


def _inverse(change: FloatArray) -> FloatArray:
    """(1 + B)^-1, or 1 where B turns the patch over or shrinks it to nothing."""
    matrix = np.eye(2) + change
    matrix[np.linalg.det(matrix) < 0.25] = np.eye(2)
    return cast(FloatArray, np.linalg.inv(matrix))
