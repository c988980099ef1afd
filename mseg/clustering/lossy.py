"""Agglomerative lossy compression: groups merge while that shortens the code for the data."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from kt3dmoseg.types import FloatArray, IntArray
from mseg.clustering.linkage import by_size

_LN2 = float(np.log(2))


def coding_lengths(points: FloatArray, labels: IntArray, distortions: FloatArray) -> FloatArray:
    """Bits to code points group by group, each as samples of a Gaussian up to a distortion.

    For a group of m points with scatter matrix S in n dimensions, M points in all:

        (m + n)/2 log2 det(I + n/(distortion^2 m) S) - m log2(m / M)

    Parameters
    ----------
    points : (n, M) float64
        Points as columns.
    labels : (M,) int64
        Their groups.
    distortions : (E,) float64
        Allowed errors epsilon, in the units of the points.

    Returns
    -------
    (E,) float64
        Bits at each distortion.

    References
    ----------
    Ma, Derksen, Hong, Wright, "Segmentation of multivariate mixed data via lossy data coding and
    compression", TPAMI 2007, equation 13 (no mean).
    """
    n, total = points.shape
    bits = np.zeros(len(distortions))
    for group in np.unique(labels):
        part = points[:, labels == group]
        m = part.shape[1]
        squares = np.linalg.svd(part, compute_uv=False) ** 2
        logarithm = np.log1p(n / (distortions[:, None] ** 2 * m) * squares).sum(axis=1)
        bits += (m + n) / 2 * logarithm / np.log(2) - m * np.log2(m / total)
    return bits


def compress(points: FloatArray, distortion: float) -> IntArray:
    """Merge from single points the two groups whose union saves most bits, while any union saves some.

    If coding everything as one group is shorter still, it is one group.

    Parameters
    ----------
    points : (n, N) float64
        Points as columns.
    distortion : float
        Allowed error epsilon.

    Returns
    -------
    (N,) int64
        Groups 1, 2, ..., the largest first.

    Notes
    -----
    Scatter matrices add up under merging. Unions with single points all have the same size, so their
    determinants follow from one inverse (matrix determinant lemma); those with larger groups take one
    batch of Cholesky factorisations. O(N^2 n^2) for the former, O(N G n^3) for G larger groups.

    References
    ----------
    Ma, Derksen, Hong, Wright, TPAMI 2007, algorithm 1.
    """
    state = _Groups(points, distortion)
    while state.merge():
        pass
    labels = by_size(state.owner)
    single = np.ones_like(labels)
    found, whole = (coding_lengths(points, x, np.array([distortion]))[0] for x in (labels, single))
    return single if whole < found else labels


@dataclass(eq=False)
class _Groups:
    """Groups under merging, with the bits that each union would add (negative: save)."""

    points: FloatArray
    distortion: float
    owner: IntArray = field(init=False)
    size: FloatArray = field(init=False)
    scatter: FloatArray = field(init=False)
    length: FloatArray = field(init=False)
    change: FloatArray = field(init=False)
    best: FloatArray = field(init=False)
    partner: IntArray = field(init=False)

    def __post_init__(self) -> None:
        n, total = self.points.shape
        self.owner, self.size = np.arange(total), np.ones(total)
        self.scatter = self.points.T[:, :, None] * self.points.T[:, None, :]
        gram = self.points.T @ self.points
        squares = np.diagonal(gram)
        self.length = self._bits(1.0, np.log1p(n / self.distortion**2 * squares))
        a = n / (2 * self.distortion**2)
        grown = 1 + a * squares
        # |w_i|^2 |w_j|^2 - (w_i . w_j)^2 first: it may be tiny beside either term.
        area = np.maximum(np.multiply.outer(squares, squares) - gram**2, 0)
        determinant = grown[:, None] + grown - 1 + a * a * area
        self.change = self._bits(2.0, np.log(determinant)) - self.length[:, None] - self.length
        np.fill_diagonal(self.change, np.inf)
        self.partner = self.change.argmin(axis=1)
        self.best = self.change[np.arange(total), self.partner]

    def merge(self) -> bool:
        """Merge the best two groups; False when no union saves bits."""
        i = int(self.best.argmin())
        j = int(self.partner[i])
        if not self.best[i] <= 0:
            return False
        self.owner[self.owner == j] = i
        self.size[i] += self.size[j]
        self.size[j] = 0
        self.scatter[i] += self.scatter[j]
        self.length[i] += self.length[j] + self.best[i]
        self._relate(i)
        self.change[j] = self.change[:, j] = np.inf
        self.best[j] = np.inf
        self._refresh(i, j)
        return True

    def _relate(self, i: int) -> None:
        """Compute the bits that unions of group i with all others add."""
        row = np.full(len(self.size), np.inf)
        single = np.flatnonzero(self.size == 1)
        if len(single):
            logarithm, squares = self._factor(i, self.size[i] + 1, self.points[:, single])
            row[single] = self._bits(self.size[i] + 1, logarithm + np.log1p(squares))
        groups = np.flatnonzero(self.size > 1)
        groups = groups[groups != i]
        if len(groups):
            sizes = self.size[i] + self.size[groups]
            unions = self.scatter[groups]
            unions += self.scatter[i]
            row[groups] = self._bits(sizes, _log_determinants(self._identity_plus(unions, sizes)))
        row -= self.length[i] + self.length
        self.change[i] = self.change[:, i] = row

    def _identity_plus(self, scatter: FloatArray, sizes: FloatArray) -> FloatArray:
        """Turn (B, n, n) scatters of groups of (B,) sizes into I + a S, in place."""
        n = scatter.shape[1]
        scatter *= (n / (self.distortion**2 * sizes))[:, None, None]
        scatter.reshape(len(scatter), n * n)[:, :: n + 1] += 1
        return scatter

    def _factor(self, i: int, size: float, points: FloatArray) -> tuple[float, FloatArray]:
        """Return log det B and ``a w^T B^-1 w`` of points w: B = I + a S_i, a = n / (epsilon^2 size)."""
        n = len(self.points)
        matrix = self._identity_plus(self.scatter[[i]], np.array([size]))[0]
        right = points * (np.sqrt(n / size) / self.distortion)
        factor, failed = dpotrf(matrix, lower=1)
        if not failed and np.diagonal(factor).min() >= 1:
            half, _ = dtrtrs(factor, right, lower=1)
            return 2 * float(np.log(np.diagonal(factor)).sum()), np.einsum("kj,kj->j", half, half)
        return _eliminate(matrix, right)

    def _refresh(self, i: int, j: int) -> None:
        """Bring the best partners up to date after row i changed and group j vanished."""
        row = self.change[i]
        better = row < self.best
        stale = np.flatnonzero(((self.partner == i) | (self.partner == j)) & ~better & (self.size > 0))
        self.best[better], self.partner[better] = row[better], i
        stale = np.append(stale, i)
        self.partner[stale] = self.change[stale].argmin(axis=1)
        self.best[stale] = self.change[stale, self.partner[stale]]

    def _bits(self, size: FloatArray | float, logarithm: FloatArray) -> FloatArray:
        n, total = self.points.shape
        return np.asarray((size + n) / (2 * _LN2) * logarithm - size * np.log2(size / total))


def _log_determinants(matrices: FloatArray) -> FloatArray:
    """Logarithms of the determinants of (B, n, n) matrices I + S, S positive semi-definite."""
    try:
        pivots = np.diagonal(np.linalg.cholesky(matrices), axis1=1, axis2=2)
        if (pivots >= 1).all():
            return np.asarray(2 * np.log(pivots).sum(axis=1))
    except np.linalg.LinAlgError:
        pass
    return _log_determinants_by_elimination(matrices.transpose(1, 2, 0).copy())


def _log_determinants_by_elimination(matrices: FloatArray) -> FloatArray:
    """Do the same for (n, n, B), where rounding makes S indefinite; destroys the matrices.

    Elimination leaves pivots of 1 plus something >= 0; less is rounding, in a direction without scatter.
    """
    total = np.zeros(matrices.shape[2])
    for k in range(len(matrices)):
        pivot = matrices[k, k]
        sound = pivot > 1
        total += np.log(pivot, out=np.zeros_like(pivot), where=sound)
        column = matrices[k + 1 :, k]
        factor = np.divide(column, pivot, out=np.zeros_like(column), where=sound)
        matrices[k + 1 :, k + 1 :] -= factor[:, None] * column[None]
    return total


def _eliminate(matrix: FloatArray, right: FloatArray) -> tuple[float, FloatArray]:
    """Do what Cholesky's factorisation does for a matrix I + S where rounding makes S indefinite."""
    logarithm, squares = 0.0, np.zeros(right.shape[1])
    for k in range(len(matrix)):
        pivot = max(float(matrix[k, k]), 1.0)
        logarithm += float(np.log(pivot))
        squares += right[k] ** 2 / pivot
        if matrix[k, k] > 1:
            factor = matrix[k + 1 :, k] / pivot
            right[k + 1 :] -= factor[:, None] * right[k]
            matrix[k + 1 :, k + 1 :] -= factor[:, None] * matrix[k, k + 1 :]
    return logarithm, squares
