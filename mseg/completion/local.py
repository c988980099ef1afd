"""Completion of trajectories by near ones that move alike.

One subspace for a whole clip lets a gap in one motion be filled by another. Here every trajectory is an
affine combination of a few others that stay near it and keep their distance, so that, where these are of
its own motion, what is filled lies on the flat of that motion.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import BoolArray, FloatArray, IntArray
from mseg.completion.chen import Completion, complete
from mseg.iteration import iterate

# Standard deviation of a tracked position, pixels.
_NOISE = 0.5
# Trajectories that share fewer frames, unless one of them has no more, may move alike or not.
_SHARED = 3
# What a frame counts in which a position is filled, compared with one where both are seen.
_TRUST = 0.5
# Holds what no seen trajectory reaches to the first completion; its square is the weight.
_ANCHOR = 0.1


def complete_locally(
    matrix: FloatArray,
    rank: int = 5,
    *,
    n_neighbours: int = 20,
    tolerance: float = 0.05,
    max_iterations: int = 20,
) -> Completion:
    """Fill the gaps of a trajectory matrix by affine combinations of similar trajectories.

    Gaps are first filled by `complete`. For trajectories i and j let ``d2`` be the mean squared distance
    and ``v`` the variance of the difference of their positions, over the frames that see both.

    1. The neighbours of i are those of least ``d2 v``.
    2. Their weights, with sum 1, minimise ``mean_t |x_i(t) - sum_j c_ij x_j(t)|^2 + sum_j c_ij^2 v_ij``
       over the frames t that see i: who does not move like i gets little.
    3. Unseen positions solve ``x_i(t) = sum_j c_ij x_j(t) + b_i(t)``, in every frame all at once and in the
       least squares sense, with b the residual of the nearest frame that sees i, and the first completion
       as a prior of weight 0.01.

    Steps 2 and 3 are repeated; then all is once more, with d2 and v over all frames, those with a filled
    position at half weight.

    Parameters
    ----------
    matrix : (2F, N) float64
        Rows x1, y1, x2, y2, ... in pixels; NaN where missing.
    rank : int
        Of the first completion.
    n_neighbours : int
        Most neighbours of a trajectory.
    tolerance : float
        Repeat until the root mean square step of what is filled is at most this, pixels.
    max_iterations : int
        Cap on the repetitions. An iteration costs O(N F k^2) and one linear system per frame in what it
        does not see.

    Returns
    -------
    Completion
        `rms` is that of the combinations at the seen entries of incomplete columns, `undetermined` the number
        of columns without a neighbour: the first completion decides them. The convergence is the last
        stage's.

    Raises
    ------
    TooFewPointsError
        When a row has no seen entry.
    InvalidValueError
        When `rank` or `n_neighbours` is less than one.

    References
    ----------
    Weights: Roweis and Saul, "Nonlinear dimensionality reduction by locally linear embedding", Science 2000.
    Distance times difference of motion: Brox and Malik, "Object segmentation by long term analysis of point
    trajectories", ECCV 2010. Incomplete trajectories as combinations of others, sparse and of complete ones
    only: Rao, Tron, Vidal, Ma, TPAMI 2010. The combination of these is ours.
    """
    if n_neighbours < 1:
        raise InvalidValueError("n_neighbours", expected="at least 1", found=str(n_neighbours))
    first = complete(matrix, rank)
    if np.isfinite(matrix).all() or matrix.shape[1] < 2:
        return first
    centre = first.matrix.reshape(-1, 2, matrix.shape[1]).mean(axis=(0, 2))
    shift = np.tile(centre, len(matrix) // 2)[:, None]
    search = _Filling(matrix - shift, first.matrix - shift, n_neighbours)
    iterate(search.step, tolerance=tolerance, max_iterations=max_iterations)
    search.choose(_TRUST)
    convergence = iterate(search.step, tolerance=tolerance, max_iterations=max_iterations)
    filled = np.where(np.isfinite(matrix), matrix, search.filled + shift)
    return Completion(filled, first.rank, search.rms, int((~search.has_neighbour).sum()), convergence)


class _Filling:
    """State of the filling: positions (2F, N) near the origin, of which those of `matrix` are seen."""

    def __init__(self, matrix: FloatArray, first: FloatArray, n_neighbours: int) -> None:
        self.matrix, self.first, self.n_neighbours = matrix, first, n_neighbours
        self.seen = np.isfinite(matrix)
        self.filled = first.copy()
        self.gaps = np.flatnonzero(~self.seen.all(axis=0))
        self.rms = 0.0
        self.choose(0.0)

    def choose(self, trust: float) -> None:
        """Choose the neighbours of the incomplete columns, and the prices of their weights."""
        squares, variances = self._pairs(trust)
        self.neighbours = np.argsort(squares * variances, axis=1, kind="stable")[:, : self.n_neighbours]
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
