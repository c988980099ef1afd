"""Low-rank completion of a matrix with gaps, by Levenberg-Marquardt on the Grassmannian.

Only the column space is sought. For each candidate space the best coefficients of every column
follow in closed form from its seen entries, so that the objective is a function of the subspace
alone (variable projection). The objective is invariant to the choice of basis; its Gauss-Newton
model is therefore restricted to directions orthogonal to the space, and steps return to orthonormal
bases by QR.

References
----------
Chen, "Optimization algorithms on subspaces: revisiting missing data problem in low-rank matrix",
IJCV 80, 2008. Kaufman, "A variable projection method for solving separable nonlinear least squares
problems", BIT 15, 1975 (the Jacobian without its second-order term).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import BoolArray, FloatArray
from mseg.errors import TooFewPointsError
from mseg.iteration import Convergence, iterate

_CHUNK_BYTES = 64 << 20
_DAMPING = 1e-3
_MOST_DAMPING = 1e12


@dataclass(frozen=True, eq=False)
class Completion:
    """A matrix without gaps.

    Parameters
    ----------
    matrix : (D, N) float64
        Seen entries as given, the others from the fitted subspace.
    rank : int
        Dimension of the subspace.
    rms : float
        Root mean square misfit at the seen entries, in the units of the matrix.
    undetermined : int
        Number of columns with fewer seen entries than `rank`; the ridge decides them.
    convergence : Convergence
        Relative decrease of the objective in the last step against its tolerance.
    """

    matrix: FloatArray
    rank: int
    rms: float
    undetermined: int
    convergence: Convergence


def complete(
    matrix: FloatArray,
    rank: int,
    *,
    ridge: float = 1e-7,
    tolerance: float = 1e-5,
    max_iterations: int = 200,
) -> Completion:
    """Fill the gaps of a matrix from its best-fitting low-rank subspace.

    The mean of the seen entries of each row is taken out first and put back at the end, and the
    rest is scaled to unit root mean square: the ridge and the damping then mean the same for any
    data. Minimised over orthonormal U (D, r), with P_j picking the seen rows of column j:

        sum_j min_c |P_j (x_j - U c)|^2 + ridge |c|^2

    One step costs ``V D^2 r^2 + (D r)^3 / 3`` operations for V distinct patterns of visibility.

    Parameters
    ----------
    matrix : (D, N) float64
        NaN where missing. Every row needs at least one seen entry.
    rank : int
        Dimension r >= 1; clipped to the smaller side of the matrix.
    ridge : float
        Penalty of the coefficients. Zero is the published objective; a small value keeps columns
        seen in few rows finite and moves determined ones by about that fraction.
    tolerance : float
        Stop when a step lowers the objective by at most this fraction.
    max_iterations : int
        Cap on steps.

    Returns
    -------
    Completion
        A matrix without gaps is returned as it is.

    Raises
    ------
    TooFewPointsError
        When a row has no seen entry.
    InvalidValueError
        When `rank` or `ridge` makes no sense.
    """
    seen = np.isfinite(matrix)
    if rank < 1 or ridge < 0:
        raise InvalidValueError("rank, ridge", expected="rank >= 1, ridge >= 0", found=f"{rank}, {ridge}")
    rank = min(rank, *matrix.shape)
    undetermined = int((seen.sum(axis=0) < rank).sum())
    if seen.all():
        return Completion(matrix, rank, 0.0, 0, Convergence(True, 0, 0.0))
    if not seen.any(axis=1).all():
        empty = int(np.flatnonzero(~seen.any(axis=1))[0])
        raise TooFewPointsError(f"row {empty}", expected="at least one seen entry", found="none")
    mean = np.nanmean(matrix, axis=1, keepdims=True)
    centred = np.where(seen, matrix - mean, 0.0)
    scale = float(np.sqrt((centred**2).sum() / seen.sum())) or 1.0
    search = _Search(centred / scale, seen, rank, ridge)
    convergence = iterate(search.step, tolerance=tolerance, max_iterations=max_iterations)
    fit = search.basis @ search.solution.coefficients * scale
    rms = float(np.sqrt((((fit - centred) * seen) ** 2).sum() / seen.sum()))
    return Completion(np.where(seen, matrix, fit + mean), rank, rms, undetermined, convergence)


@dataclass(frozen=True, eq=False)
class _Solution:
    """Best coefficients (r, N) for a basis, the residual (D, N) they leave, and the objective."""

    coefficients: FloatArray
    residual: FloatArray
    inverse: FloatArray
    objective: float


class _Search:
    """State of the Levenberg-Marquardt search over subspaces."""

    def __init__(self, data: FloatArray, seen: BoolArray, rank: int, ridge: float) -> None:
        self.data, self.seen, self.rank, self.ridge = data, seen, rank, ridge
        patterns, pattern_of = np.unique(seen.T, axis=0, return_inverse=True)
        self.patterns, self.pattern_of = patterns.astype(np.float64), pattern_of.ravel()
        left, _, _ = np.linalg.svd(data, full_matrices=False)
        self.basis = np.ascontiguousarray(left[:, :rank])
        self.solution = self._solve(self.basis)
        self.damping = _DAMPING

    def step(self) -> float:
        """Take one descent step and return the relative decrease of the objective."""
        before = self.solution.objective
        gradient = self._tangent(self.solution.residual @ self.solution.coefficients.T)
        hessian = self._hessian()
        unit = float(np.trace(hessian)) / len(hessian)
        while before > 0 and unit > 0 and self.damping < _MOST_DAMPING:
            basis, _ = np.linalg.qr(self.basis + _damped_solve(hessian, gradient, self.damping * unit))
            trial = self._solve(basis)
            if trial.objective < before:
                self.basis, self.solution = basis, trial
                self.damping = max(self.damping / 10, 1e-9)
                return (before - trial.objective) / before
            self.damping *= 10
        return 0.0

    def _solve(self, basis: FloatArray) -> _Solution:
        """Eliminate the coefficients: one small system per pattern of visibility."""
        r = self.rank
        outer = (basis[:, :, None] * basis[:, None, :]).reshape(len(basis), r * r)
        gram = (self.patterns @ outer).reshape(-1, r, r) + self.ridge * np.eye(r)
        inverse: FloatArray = np.asarray(np.linalg.pinv(gram, hermitian=True), dtype=np.float64)
        coefficients = np.einsum("jab,jb->aj", inverse[self.pattern_of], self.data.T @ basis)
        residual = np.where(self.seen, self.data - basis @ coefficients, 0.0)
        objective = float((residual**2).sum() + self.ridge * (coefficients**2).sum())
        return _Solution(coefficients, residual, inverse, objective)

    def _tangent(self, direction: FloatArray) -> FloatArray:
        """Remove the part of (D, ...) inside the space: it only changes the basis."""
        inside = np.tensordot(self.basis.T, direction, axes=1)
        return np.asarray(direction - np.tensordot(self.basis, inside, axes=1))

    def _hessian(self) -> FloatArray:
        """Gauss-Newton matrix (D r, D r) of the tangent: sum over columns of Q_j kron c_j c_j^T.

        Q_j projects onto what the seen rows of the basis cannot explain.
        """
        depth, r = self.basis.shape
        order = np.argsort(self.pattern_of, kind="stable")
        start = np.searchsorted(self.pattern_of[order], np.arange(len(self.patterns)))
        coefficients = self.solution.coefficients.T[order]
        outer = np.add.reduceat(coefficients[:, :, None] * coefficients[:, None, :], start)
        total = np.zeros((depth * depth, r * r))
        chunk = max(1, _CHUNK_BYTES // (8 * depth * depth))
        for first in range(0, len(self.patterns), chunk):
            part = slice(first, first + chunk)
            masked = self.patterns[part, :, None] * self.basis
            explained = masked @ self.solution.inverse[part] @ masked.transpose(0, 2, 1)
            total -= explained.reshape(-1, depth * depth).T @ outer[part].reshape(-1, r * r)
        total[:: depth + 1] += np.tensordot(self.patterns.T, outer, axes=1).reshape(depth, r * r)
        hessian = self._tangent(total.reshape(depth, depth, r * r))
        hessian = self._tangent(hessian.transpose(1, 0, 2)).reshape(depth, depth, r, r)
        return np.ascontiguousarray(hessian.transpose(0, 2, 1, 3)).reshape(depth * r, depth * r)


def _damped_solve(hessian: FloatArray, gradient: FloatArray, damping: float) -> FloatArray:
    system = hessian.copy()
    system.flat[:: len(system) + 1] += damping
    try:
        factor = cho_factor(system, overwrite_a=True, check_finite=False)
    except LinAlgError:
        return np.zeros_like(gradient)
    return np.asarray(cho_solve(factor, gradient.ravel()).reshape(gradient.shape))
