"""Missing and corrupted positions in a trajectory matrix: one subspace, similar trajectories, robust PCA."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from kt3dmoseg.types import BoolArray, FloatArray, IntArray
from mseg.iteration import Convergence, iterate

# Of `complete`: price of coefficients, which keeps columns seen in few rows finite and moves determined ones
# by about that fraction; damping of its steps; size of what is multiplied at once.
_RIDGE, _DAMPING, _MOST_DAMPING, _CHUNK_BYTES = 1e-7, 1e-3, 1e12, 64 << 20
# Of `complete_locally`: deviation of a tracked position and step at convergence, pixels; most rounds; most
# neighbours of a trajectory.
_NOISE, _STEP, _ROUNDS, _NEIGHBOURS = 0.5, 0.05, 20, 20
# Trajectories that share fewer frames, unless one of them has no more, may move alike or not.
_SHARED = 3
# What a frame counts in which a position is filled, compared with one where both are seen.
_TRUST = 0.5
# Holds what no seen trajectory reaches to the first completion; its square is the weight.
_ANCHOR = 0.1


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


def complete_locally(matrix: FloatArray, rank: int = 5) -> Completion:
    """Fill the gaps (NaN) of a trajectory matrix (2F, N) by affine combinations of similar trajectories.

    One subspace for a whole clip lets a gap in one motion be filled by another. Here every trajectory is an
    affine combination of a few others that stay near it and keep their distance, so that, where these are of
    its own motion, what is filled lies on the flat of that motion. Gaps are first filled by `complete`. For
    trajectories i and j let ``d2`` be the mean squared distance and ``v`` the variance of the difference of
    their positions, over the frames that see both.

    1. The neighbours of i are the 20 of least ``d2 v``.
    2. Their weights, with sum 1, minimise ``mean_t |x_i(t) - sum_j c_ij x_j(t)|^2 + sum_j c_ij^2 v_ij``
       over the frames t that see i: who does not move like i gets little.
    3. Unseen positions solve ``x_i(t) = sum_j c_ij x_j(t) + b_i(t)``, in every frame all at once and in the
       least squares sense, with b the residual of the nearest frame that sees i, and the first completion
       as a prior of weight 0.01.

    Steps 2 and 3 are repeated until the root mean square step of what is filled is at most 0.05 pixels, at
    most 20 times; then all is once more, with d2 and v over all frames, those with a filled position at half
    weight. A round costs O(N F k^2) for k neighbours and one linear system per frame in what it does not see.

    Of the result, `rms` is that of the combinations at the seen entries of incomplete columns, `undetermined`
    the number of columns without a neighbour: the first completion decides them. The convergence is the last
    stage's.
    """
    # Weights: Roweis and Saul, "Nonlinear dimensionality reduction by locally linear embedding", Science
    # 2000. Distance times difference of motion: Brox and Malik, "Object segmentation by long term analysis of
    # point trajectories", ECCV 2010. Incomplete trajectories as combinations of others, sparse and of
    # complete ones only: Rao, Tron, Vidal, Ma, TPAMI 2010. The combination of these is ours.
    first = complete(matrix, rank)
    if np.isfinite(matrix).all() or matrix.shape[1] < 2:
        return first
    centre = first.matrix.reshape(-1, 2, matrix.shape[1]).mean(axis=(0, 2))
    shift = np.tile(centre, len(matrix) // 2)[:, None]
    search = _Filling(matrix - shift, first.matrix - shift)
    iterate(search.step, tolerance=_STEP, max_iterations=_ROUNDS)
    search.choose(_TRUST)
    convergence = iterate(search.step, tolerance=_STEP, max_iterations=_ROUNDS)
    filled = np.where(np.isfinite(matrix), matrix, search.filled + shift)
    return Completion(filled, first.rank, search.rms, int((~search.has_neighbour).sum()), convergence)


class _Filling:
    """State of the filling: positions (2F, N) near the origin, of which those of `matrix` are seen."""

    def __init__(self, matrix: FloatArray, first: FloatArray) -> None:
        self.matrix, self.first = matrix, first
        self.seen = np.isfinite(matrix)
        self.filled = first.copy()
        self.gaps = np.flatnonzero(~self.seen.all(axis=0))
        self.rms = 0.0
        self.choose(0.0)

    def choose(self, trust: float) -> None:
        """Choose the neighbours of the incomplete columns, and the prices of their weights."""
        squares, variances = self._pairs(trust)
        self.neighbours = np.argsort(squares * variances, axis=1, kind="stable")[:, :_NEIGHBOURS]
        self.prices = np.take_along_axis(variances, self.neighbours, axis=1)
        self.has_neighbour = np.asarray(np.isfinite(self.prices).any(axis=1))

    def _pairs(self, trust: float) -> tuple[FloatArray, FloatArray]:
        """Mean squared distances and variances (G, N) between incomplete columns and all; inf: unknown."""
        both = _moments(self.matrix, self.seen, self.gaps)
        every = _moments(self.filled, np.ones_like(self.seen), self.gaps)
        number, dx, dy, total = (1 - trust) * both + trust * every
        lengths = self.seen[::2].sum(axis=0)
        fewest = np.minimum(np.minimum(lengths, lengths[self.gaps, None]), _SHARED)
        known = both[0] >= np.maximum(fewest, 2)
        known[np.arange(len(self.gaps)), self.gaps] = False
        frames = np.where(known, number, 2.0)
        squares = total / frames
        scatter = np.maximum(total - (dx**2 + dy**2) / frames, 0)
        variances = (scatter + _NOISE**2) / (frames - 1)
        return np.where(known, squares, np.inf), np.where(known, variances, np.inf)

    def step(self) -> float:
        """Weights, then positions; return the root mean square step of what is filled."""
        weights, residual = self._weights()
        shares = np.zeros((len(self.gaps), self.matrix.shape[1]))
        np.put_along_axis(shares, self.neighbours, weights, axis=1)
        offset = np.take_along_axis(
            residual, _nearest_seen(self.seen[::2, self.gaps]).repeat(2, axis=0), axis=0
        )
        before = self.filled.copy()
        for row in range(0, len(self.matrix), 2):
            self._fill(slice(row, row + 2), shares, offset)
        self.rms = float(np.sqrt((residual[self.seen[:, self.gaps]] ** 2).mean()))
        return float(np.sqrt(((self.filled - before)[~self.seen] ** 2).mean()))

    def _weights(self) -> tuple[FloatArray, FloatArray]:
        """Weights (G, k) of the neighbours, and what they leave (2F, G), zero where nothing is seen."""
        seen = self.seen[:, self.gaps].T
        apart = self.filled.T[self.neighbours] - self.filled.T[self.gaps][:, None]
        apart *= seen[:, None]
        gram = apart @ apart.transpose(0, 2, 1) * (2 / seen.sum(axis=1))[:, None, None]
        free = np.isfinite(self.prices)
        gram *= free[:, :, None] & free[:, None]
        k = gram.shape[1]
        gram.reshape(len(gram), k * k)[:, :: k + 1] += np.where(free, self.prices, 1.0)
        weights = np.linalg.solve(gram, free[:, :, None].astype(np.float64))[:, :, 0]
        weights /= np.maximum(weights.sum(axis=1), np.finfo(np.float64).tiny)[:, None]
        return weights, -np.einsum("gk,gkf->fg", weights, apart)

    def _fill(self, rows: slice, shares: FloatArray, offset: FloatArray) -> None:
        """Solve for the unseen positions of one frame."""
        blind = ~self.seen[rows.start, self.gaps]
        unseen = self.gaps[blind]
        if not len(unseen):
            return
        shares = shares[blind]
        system = np.diag(self.has_neighbour[blind].astype(np.float64)) - shares[:, unseen]
        known = np.where(self.seen[rows], self.filled[rows], 0.0)
        right = shares @ known.T + offset[rows][:, blind].T
        # Least squares: combinations that depend on each other in a ring would else diverge.
        gram = system.T @ system
        gram[np.diag_indices_from(gram)] += _ANCHOR**2
        right = system.T @ right + _ANCHOR**2 * self.first[rows, unseen].T
        self.filled[rows, unseen] = cho_solve(cho_factor(gram, overwrite_a=True), right).T


def _moments(matrix: FloatArray, seen: BoolArray, columns: IntArray) -> FloatArray:
    """Moments (4, G, N) of the differences of some columns (G of N) and all, over the frames that see both.

    Number of frames, sums of the differences in x and y, and sum of squared distances.
    """
    weight = seen[::2].astype(np.float64)
    frames = weight[:, columns].T @ weight
    sums, squares = np.empty((2, *frames.shape)), np.zeros_like(frames)
    for axis in range(2):
        x = np.where(seen[axis::2], matrix[axis::2], 0.0)
        own, of_own = x[:, columns].T, weight[:, columns].T
        sums[axis] = own @ weight - of_own @ x
        squares += own**2 @ weight + of_own @ x**2 - 2 * own @ x
    return np.stack([frames, *sums, np.maximum(squares, 0)])


def _nearest_seen(seen: BoolArray) -> IntArray:
    """Of every frame and column (F, G) the nearest frame that sees it, of two the earlier."""
    frames = np.arange(len(seen))
    before = np.maximum.accumulate(np.where(seen, frames[:, None], -len(seen)), axis=0)
    after = np.minimum.accumulate(np.where(seen, frames[:, None], 3 * len(seen))[::-1], axis=0)[::-1]
    return np.asarray(np.where(frames[:, None] - before <= after - frames[:, None], before, after))


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
