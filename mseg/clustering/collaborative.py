"""Sparse self-expression in several views that agree on who expresses whom."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kt3dmoseg.types import Float32Array, FloatArray, IntArray
from mseg.clustering.self_expressive import Representation
from mseg.iteration import Convergence, iterate

# Points whose coefficients are sought together: their state stays in the processor's cache.
_BLOCK = 32


def collaborative_representation(
    views: Sequence[FloatArray],
    *,
    alpha: float = 8000.0,
    penalty: float = 50.0,
    tolerance: float = 2e-3,
    max_iterations: int = 200,
) -> Representation:
    """Express every point by few others, the same ones in all views, by ADMM.

        min sum_v alpha/2 |W_v - W_v C_v|_F^2 + sum_ij |(C_1(i, j), ..., C_V(i, j))|_2,  diag C_v = 0

    The programme falls apart into one for each column of C; they are solved a few at a time, in single
    precision.

    Parameters
    ----------
    views : sequence of (D, N) float64
        Points as columns, at unit length; a column of zeros is a point that the view does not see. It
        neither expresses nor is expressed there.
    alpha : float
        Weight of the fit.
    penalty : float
        Penalty of the splitting of C into a fitted and a sparse copy; changes the way, not the solution.
    tolerance : float
        Stop when the copies differ, and the sparse one has moved, by no more than this in any entry.
    max_iterations : int
        Cap; an iteration costs O(V N^2 D).

    Returns
    -------
    Representation
        Coefficients (N, N): over the views the sum of magnitudes. The convergence is that of the block of
        columns that took longest.

    References
    ----------
    Li, Guo, Cheong, Zhou, "Perspective motion segmentation via collaborative clustering", ICCV 2013,
    section 3 (mixed norm); splitting as in Elhamifar and Vidal, TPAMI 2013, algorithm 2.
    """
    n = views[0].shape[1]
    _, values, right = np.linalg.svd(np.sqrt(alpha) * np.stack(views), full_matrices=False)
    gain = (values**2 / (values**2 + penalty))[:, None, :].astype(np.float32)
    coefficients = np.empty((n, n))
    ends = []
    for start in range(0, n, _BLOCK):
        block = _Columns(right.astype(np.float32), gain, penalty, np.arange(start, min(start + _BLOCK, n)))
        ends.append(iterate(block.step, tolerance=tolerance, max_iterations=max_iterations))
        coefficients[:, block.columns] = np.abs(block.sparse).sum(axis=0).T
    return Representation(coefficients, _slowest(ends))


class _Columns:
    """ADMM of some columns of C, kept as rows: arrays are (V, columns, N).

    With ``W = L S V^T`` the fitted copy ``(alpha W^T W + p I)^-1 (alpha W^T w_j + p q)`` is
    ``q + V h (v_j - V^T q)``, v_j row j of V and ``h = alpha S^2 / (alpha S^2 + p)``.
    """

    def __init__(self, right: Float32Array, gain: Float32Array, penalty: float, columns: IntArray) -> None:
        self.columns = columns
        self.right, self.left = right, np.ascontiguousarray(right.transpose(0, 2, 1))
        self.gain, self.penalty = gain, np.float32(penalty)
        self.sparse = np.zeros((len(right), len(columns), right.shape[2]), dtype=np.float32)
        # The sparse copy before it is shrunk: multipliers and fitted copy together.
        self.raw = np.zeros_like(self.sparse)

    def step(self) -> float:
        fitted = 2 * self.sparse - self.raw
        fitted += ((self.left[:, self.columns] - fitted @ self.left) * self.gain) @ self.right
        self.raw += fitted - self.sparse
        size = np.sqrt(np.einsum("vjn,vjn->jn", self.raw, self.raw))
        keep = np.maximum(1 - 1 / np.maximum(self.penalty * size, 1), 0)
        keep[np.arange(len(self.columns)), self.columns] = 0
        before, self.sparse = self.sparse, self.raw * keep
        return max(float(np.abs(fitted - self.sparse).max()), float(np.abs(self.sparse - before).max()))


def _slowest(ends: Sequence[Convergence]) -> Convergence:
    return Convergence(
        all(end.converged for end in ends),
        max(end.iterations for end in ends),
        max(end.residual for end in ends),
    )
