"""Missing and corrupted positions in a trajectory matrix: one subspace, robust principal components."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from kt3dmoseg.types import BoolArray, FloatArray
from mseg.iteration import Convergence, iterate

# Price of coefficients, which keeps columns seen in few rows finite and moves determined ones
# by about that fraction; damping of its steps; size of what is multiplied at once.
_RIDGE, _DAMPING, _MOST_DAMPING, _CHUNK_BYTES = 1e-7, 1e-3, 1e12, 64 << 20


@dataclass(frozen=True, eq=False)
class Completion:
    """A matrix without gaps."""

    matrix: FloatArray  # (D, N): seen entries as given, the others from the fitted subspace
    rank: int  # dimension of the subspace
    rms: float  # root mean square misfit at the seen entries, in the units of the matrix
    undetermined: int  # columns with fewer seen entries than `rank`; the ridge decides them
    convergence: Convergence  # relative decrease of the objective in the last step


def complete(
    matrix: FloatArray, rank: int, *, tolerance: float = 1e-5, max_iterations: int = 200
) -> Completion:
    """Fill the gaps of a matrix (D, N) from its best-fitting subspace of a rank, by Levenberg-Marquardt.

    Gaps are NaN, every row has a seen entry, and the rank is clipped to the smaller side. The mean of the
    seen entries of each row is taken out first and put back at the end, and the rest is scaled to unit root
    mean square: the ridge and the damping then mean the same for any data. Minimised over orthonormal
    U (D, r), with P_j picking the seen rows of column j:

        sum_j min_c |P_j (x_j - U c)|^2 + ridge |c|^2

    For each U the coefficients follow in closed form, so that the objective is one of the subspace alone
    (variable projection). Its Gauss-Newton model is restricted to directions orthogonal to the space, and
    steps return to orthonormal bases by QR, until one lowers the objective by at most the fraction
    `tolerance`. A step costs ``V D^2 r^2 + (D r)^3 / 3`` operations for V distinct patterns of visibility.
    """
    # Source: Chen, "Optimization algorithms on subspaces: revisiting missing data problem in low-rank
    # matrix", IJCV 80, 2008. Jacobian, without its second-order term: Kaufman, "A variable projection method
    # for solving separable nonlinear least squares problems", BIT 15, 1975.
    seen = np.isfinite(matrix)
    rank = min(rank, *matrix.shape)
    undetermined = int((seen.sum(axis=0) < rank).sum())
    if seen.all():
        return Completion(matrix, rank, 0.0, 0, Convergence(True, 0, 0.0))
    mean = np.nanmean(matrix, axis=1, keepdims=True)
    centred = np.where(seen, matrix - mean, 0.0)
    scale = float(np.sqrt((centred**2).sum() / seen.sum())) or 1.0
    search = _Search(centred / scale, seen, rank)
    convergence = iterate(search.step, tolerance=tolerance, max_iterations=max_iterations)
    fit = search.basis @ search.solution.coefficients * scale
    rms = float(np.sqrt((((fit - centred) * seen) ** 2).sum() / seen.sum()))
    return Completion(np.where(seen, matrix, fit + mean), rank, rms, undetermined, convergence)


class _Solution(NamedTuple):
    """Best coefficients (r, N) for a basis, the residual (D, N) they leave, and the objective."""

    coefficients: FloatArray
    residual: FloatArray
    inverse: FloatArray
    objective: float


class _Search:
    """State of the Levenberg-Marquardt search over subspaces."""

    def __init__(self, data: FloatArray, seen: BoolArray, rank: int) -> None:
        self.data, self.seen, self.rank = data, seen, rank
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
        gram = (self.patterns @ outer).reshape(-1, r, r) + _RIDGE * np.eye(r)
        inverse: FloatArray = np.asarray(np.linalg.pinv(gram, hermitian=True), dtype=np.float64)
        coefficients = np.einsum("jab,jb->aj", inverse[self.pattern_of], self.data.T @ basis)
        residual = np.where(self.seen, self.data - basis @ coefficients, 0.0)
        objective = float((residual**2).sum() + _RIDGE * (coefficients**2).sum())
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


@dataclass(frozen=True, eq=False)
class RobustPCA:
    """Data split into ``low_rank + sparse``, both (D, N) float64, and how the split converged."""

    low_rank: FloatArray
    sparse: FloatArray
    convergence: Convergence


def robust_pca(matrix: FloatArray, *, tolerance: float = 1e-7, max_iterations: int = 1000) -> RobustPCA:
    """Minimise ``|A|_* + weight |E|_1`` subject to ``A + E = X`` by the inexact augmented Lagrangian.

    The weight is ``1 / sqrt(max(D, N))`` for data X (D, N). Missing elements, NaN, are errors that cost
    nothing, so that the low-rank part alone decides them. It ends where ``|X - A - E|_F <= tolerance |X|_F``;
    an iteration is one singular value decomposition, or for symmetric data the four times cheaper eigenvalue
    decomposition.
    """
    # Lin, Chen, Ma, "The augmented Lagrange multiplier method for exact recovery of corrupted low-rank
    # matrices", 2010, algorithm 5 (penalty 1.25 / sigma_1, growth 1.5). Weight, missing elements: Candes, Li,
    # Ma, Wright, "Robust principal component analysis?", JACM 2011, section 1.6.
    seen = np.isfinite(matrix)
    matrix = np.where(seen, matrix, 0.0)
    weight = float(1 / np.sqrt(max(matrix.shape)))
    largest, size = float(np.linalg.norm(matrix, 2)), float(np.linalg.norm(matrix))
    if size == 0:
        return RobustPCA(matrix.copy(), np.zeros_like(matrix), Convergence(True, 0, 0.0))
    low_rank, sparse = np.zeros_like(matrix), np.zeros_like(matrix)
    multiplier = matrix / max(largest, np.abs(matrix).max() / weight)
    multiplier *= seen
    price = np.where(seen, weight, 0.0)
    penalty = 1.25 / largest
    cap = penalty * 1e7
    symmetric = matrix.shape[0] == matrix.shape[1] and bool((matrix == matrix.T).all())
    shrunk = _shrink_eigenvalues if symmetric else _shrink_singular_values

    def step() -> float:
        nonlocal low_rank, sparse, multiplier, penalty
        sparse = shrink(matrix - low_rank + multiplier / penalty, price / penalty)
        low_rank = shrunk(matrix - sparse + multiplier / penalty, 1 / penalty)
        gap = matrix - low_rank - sparse
        multiplier = multiplier + penalty * gap
        penalty = min(penalty * 1.5, cap)
        return float(np.linalg.norm(gap) / size)

    convergence = iterate(step, tolerance=tolerance, max_iterations=max_iterations)
    return RobustPCA(low_rank, sparse, convergence)


def shrink(values: FloatArray, threshold: float | FloatArray) -> FloatArray:
    """Soft threshold: the proximal map of ``threshold |.|_1``, element by element."""
    # x - clip(x) touches memory less often than sign(x) * max(|x| - t, 0).
    return np.asarray(values - np.clip(values, -threshold, threshold))


def _shrink_singular_values(matrix: FloatArray, threshold: float) -> FloatArray:
    """Soft threshold of the singular values: the proximal map of ``threshold |.|_*``."""
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    kept = int((values > threshold).sum())
    return np.asarray((left[:, :kept] * (values[:kept] - threshold)) @ right[:kept])


def _shrink_eigenvalues(matrix: FloatArray, threshold: float) -> FloatArray:
    """Do the same for a symmetric matrix: its singular values are ``|lambda|``."""
    values, vectors = np.linalg.eigh(matrix)
    kept = np.abs(values) > threshold
    vectors, values = vectors[:, kept], values[kept]
    return np.asarray((vectors * (values - np.sign(values) * threshold)) @ vectors.T)
