"""The ordered residual kernel: points that prefer the same hypotheses belong together."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.types import BoolArray, Float32Array

_Array = npt.NDArray[Any]


def top_count(n_hypotheses: int, fraction: float) -> int:
    """Count the preferred hypotheses: the fraction rounded half up, at least 1 of any."""
    return min(n_hypotheses, max(1, int(np.floor(fraction * n_hypotheses + 0.5))))


def preferences(residuals: _Array, count: int) -> BoolArray:
    """Mark the hypotheses of least residual of every point.

    Parameters
    ----------
    residuals : (P, K) float
        Residuals of P points to K hypotheses. NaN counts as the worst.
    count : int
        How many to mark in each row, 1..K. Of equal residuals the earlier hypotheses win.

    Returns
    -------
    (P, K) bool
        Exactly `count` True in each row.
    """
    limit = np.partition(residuals, count - 1, axis=1)[:, count - 1 : count]
    chosen: BoolArray = residuals <= limit
    if np.count_nonzero(chosen) == count * len(chosen) and not np.isnan(limit).any():
        return chosen
    tied = np.flatnonzero(np.count_nonzero(chosen, axis=1) != count)
    if len(tied):
        order = np.argsort(residuals[tied], axis=1, kind="stable")[:, :count]
        rows = np.zeros((len(tied), residuals.shape[1]), dtype=np.bool_)
        np.put_along_axis(rows, order, True, axis=1)
        chosen[tied] = rows
    return chosen


def ordered_residual_kernel(residuals: _Array, *, fraction: float = 0.1) -> Float32Array:
    """Share of common hypotheses among the preferred ones of each two points.

    Parameters
    ----------
    residuals : (P, K) float
        Residuals of P points to K hypotheses.
    fraction : float
        Part of the hypotheses that a point prefers, h = fraction * K.

    Returns
    -------
    (P, P) float32
        |S_i and S_j| / h, in 0..1, with ones on the diagonal.

    References
    ----------
    Chin, Wang, Suter, "Robust fitting of multiple structures: the statistical learning approach",
    ICCV 2009, with the first window alone, as Xu, Cheong, Li (CVPR 2018, section 3.1) use it.
    """
    count = top_count(residuals.shape[1], fraction)
    marks = preferences(residuals, count).astype(np.float32)
    kernel: Float32Array = marks @ marks.T
    kernel /= np.float32(count)
    return kernel
