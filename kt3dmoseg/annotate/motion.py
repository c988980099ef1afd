"""How the image moves inside a region from one frame to the next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from kt3dmoseg.annotate.polygons import bounds, signed_distance
from kt3dmoseg.types import Float32Array, FloatArray, Trajectories

# Correspondences below which a similarity is not worth fitting: it has four unknowns.
_ENOUGH = 4
_ROUNDS = 12
# Residuals smaller than this many pixels are tracking noise, not another motion.
_NOISE = 0.3
# Strength of the prior "no turn, no growth", in square pixels of spread: a few close points tell
# the translation of a region but not its scale.
_PRIOR = 100.0


class ImageMotion(Protocol):
    """Where points of the image went."""

    def matches(self, region: Sequence[FloatArray], i: int, j: int) -> tuple[FloatArray, FloatArray]:
        """Correspondences of the region's content between frame `i` and a neighbouring frame `j`.

        Parameters
        ----------
        region : sequence of (P, 2) float64
            Polygons in frame `i`, pixels.
        i, j : int
            Frames, ``abs(i - j) == 1``.

        Returns
        -------
        x1, x2 : (n, 2) float64
            Positions in frame `i` and in frame `j`; possibly none.
        """
        ...


class TrackMotion:
    """The image motion as told by trajectories inside the region."""

    def __init__(self, trajectories: Trajectories) -> None:
        self.trajectories = trajectories

    def matches(self, region: Sequence[FloatArray], i: int, j: int) -> tuple[FloatArray, FloatArray]:
        """Trajectories inside the region in frame `i` that are visible in `j`; see `ImageMotion`."""
        _, x1, x2 = self.trajectories.pair(i, j)
        left, top, right, bottom = bounds(region)
        near = ((x1 >= (left, top)) & (x1 <= (right, bottom))).all(axis=1)
        x1, x2 = x1[near], x2[near]
        kept = signed_distance(x1, region) >= 0
        return x1[kept], x2[kept]


class FlowMotion:
    """The image motion as told by optical flow.

    Parameters
    ----------
    flow : callable
        ``flow(i, j)`` gives the displacement field of frame `i` towards its neighbour `j`,
        (H, W, 2) in pixels, NaN where unknown.
    spacing : float
        Distance of the sampled points in pixels.
    """

    def __init__(self, flow: Callable[[int, int], Float32Array], spacing: float = 2.0) -> None:
        self.flow, self.spacing = flow, spacing

    @classmethod
    def from_stack(cls, forward: Sequence[Float32Array]) -> FlowMotion:
        """Make it from the fields of frames t to t + 1 only.

        Backwards, the field at a point is taken as minus the forward field that ends nearby.
        """

        def flow(i: int, j: int) -> Float32Array:
            return forward[i] if j > i else _reversed(forward[j])

        return cls(flow)

    def matches(self, region: Sequence[FloatArray], i: int, j: int) -> tuple[FloatArray, FloatArray]:
        """Points on a grid in the region and where the flow takes them; see `ImageMotion`."""
        field = self.flow(i, j)
        height, width = field.shape[:2]
        left, top, right, bottom = bounds(region)
        xs = np.arange(max(0.0, np.ceil(left)), min(width - 1.0, right) + 1e-9, self.spacing)
        ys = np.arange(max(0.0, np.ceil(top)), min(height - 1.0, bottom) + 1e-9, self.spacing)
        grid = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
        x1 = grid[signed_distance(grid, region) >= 0]
        column, row = np.rint(x1).astype(np.int64).T
        x2 = x1 + field[row, column]
        known = np.isfinite(x2).all(axis=1)
        return x1[known], x2[known]


class NoMotion:
    """No knowledge of the image: regions between key frames are interpolated."""

    def matches(self, region: Sequence[FloatArray], i: int, j: int) -> tuple[FloatArray, FloatArray]:
        """No correspondence; see `ImageMotion`."""
        del region, i, j
        return np.empty((0, 2)), np.empty((0, 2))


def fit_similarity(x1: FloatArray, x2: FloatArray) -> FloatArray | None:
    """Fit a similarity robustly: ``x2 = A x1 + t`` with A a scaled rotation.

    Iteratively reweighted least squares with Tukey's biweight (Beaton and Tukey 1974), started at
    the median displacement, so that up to nearly half of the points may follow another motion.

    Parameters
    ----------
    x1, x2 : (n, 2) float64
        Corresponding points in pixels.

    Returns
    -------
    (2, 3) float64 or None
        ``[A | t]``; None for fewer than 4 correspondences.
    """
    if len(x1) < _ENOUGH:
        return None
    model = np.column_stack([np.eye(2), np.median(x2 - x1, axis=0)])
    for _ in range(_ROUNDS):
        residual = np.hypot(*(x2 - apply(model, x1)).T)
        # 1.4826 * MAD estimates the standard deviation; 4.685 gives 95 % efficiency (Huber 1981).
        cut = 4.685 * max(_NOISE, 1.4826 * float(np.median(residual)))
        weight = np.where(residual < cut, (1 - (residual / cut) ** 2) ** 2, 0.0)
        if np.count_nonzero(weight) < _ENOUGH:
            break
        model = _weighted_similarity(x1, x2, weight)
    return model


def apply(model: FloatArray, points: FloatArray) -> FloatArray:
    """Map (n, 2) points by a (2, 3) model."""
    return np.asarray(points @ model[:, :2].T + model[:, 2])


def _weighted_similarity(x1: FloatArray, x2: FloatArray, weight: FloatArray) -> FloatArray:
    """Regularised least squares in complex numbers: ``z2 - m2 = a (z1 - m1)`` with a near 1."""
    z1, z2 = x1[:, 0] + 1j * x1[:, 1], x2[:, 0] + 1j * x2[:, 1]
    total = weight.sum()
    m1, m2 = (weight * z1).sum() / total, (weight * z2).sum() / total
    spread = (weight * np.abs(z1 - m1) ** 2).sum()
    a = ((weight * np.conj(z1 - m1) * (z2 - m2)).sum() + _PRIOR) / (spread + _PRIOR)
    t = m2 - a * m1
    return np.array([[a.real, -a.imag, t.real], [a.imag, a.real, t.imag]])


def _reversed(forward: Float32Array) -> Float32Array:
    height, width = forward.shape[:2]
    rows, columns = np.mgrid[0:height, 0:width]
    back = np.full_like(forward, np.nan)
    known = np.isfinite(forward).all(axis=2)
    x = np.rint(columns + np.where(known, forward[..., 0], 0)).astype(np.int64)
    y = np.rint(rows + np.where(known, forward[..., 1], 0)).astype(np.int64)
    kept = known & (x >= 0) & (x < width) & (y >= 0) & (y < height)
    back[y[kept], x[kept]] = -forward[kept]
    return back
