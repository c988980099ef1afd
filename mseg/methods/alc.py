"""Agglomerative lossy compression (ALC): groups merge while that shortens the code for the data."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from kt3dmoseg.options import option
from kt3dmoseg.types import FloatArray, IntArray
from mseg.geometry.subspaces import project
from mseg.methods.complete_data import CompleteData, CompleteDataMethod, by_size
from mseg.types import Grouping

_LARGEST_OUTLIER_GROUP = 4
_LN2 = float(np.log(2))


@dataclass(frozen=True)
class ALC(CompleteDataMethod):
    """Group trajectories so that coding them group by group takes fewest bits.

    1. The trajectory matrix in pixels is projected on its d leading left singular vectors: d = 5, or the
       least d >= 8 log2(2F / d) that preserves sparsity ("ALC_sp").
    2. For each distortion epsilon of a grid, groups merge greedily from single points while that shortens
       the code: for m of M points with scatter matrix S in n dimensions, samples of a Gaussian up to epsilon,
       ``(m + n)/2 log2 det(I + n/(epsilon^2 m) S) - m log2(m / M)`` bits.
    3. A group of more than 4 points is a motion; the others together are outliers. Candidates are the
       distinct segmentations with exactly K motions. At every epsilon that did not end in one group, the
       candidate with the shortest code there gets a vote; most votes win, the first of equals.

    Where no segmentation has K motions, those with the nearest number are taken, the larger of two; surplus
    motions, the smallest, become outliers. This is ours (the authors' code returns about N groups then) and
    is reported as ``exact_count: False``.

    Source: Rao, Tron, Vidal, Ma, "Motion segmentation in the presence of outlying, incomplete, or corrupted
    trajectories", TPAMI 2010; Ma, Derksen, Hong, Wright, TPAMI 2007. The grid, 101 distortions from 1e-5 to
    1e3, is that of the authors' code.
    Input: complete trajectories (gaps are completed; ``completion="rpca"`` also repairs gross errors).
    Number of motions: given; the authors' penalised length for an unknown number keeps tiny groups and is
    left out. Outliers: labelled 0. Cost: a grid of O(N^2 d^2 + N G d^3), G groups; O(N^2) memory.
    """

    deterministic: ClassVar[bool] = True

    dimension: int = option(0, "dimension d of the projection; 0 = sparsity-preserving", low=0)
    distortions: int = option(101, "number of distortions, evenly in their logarithm", low=1)
    smallest_distortion: float = option(1e-5, "least distortion, pixels of a 640 x 480 image", low=1e-12)
    largest_distortion: float = option(1e3, "greatest distortion, pixels of a 640 x 480 image", low=1e-12)

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        assert n_motions is not None
        points = project(data.pixels, self.dimension or _sparsity_preserving_dimension(len(data.pixels)))
        points /= data.unit
        grid = np.geomspace(self.smallest_distortion, self.largest_distortion, self.distortions)
        found = [_compress(points, float(distortion)) for distortion in grid]
        labels, report = _elect(points, grid, found, n_motions)
        return labels, {"dimension": len(points), **report}


def _sparsity_preserving_dimension(rows: int) -> int:
    return next(d for d in range(1, rows + 1) if d >= 8 * np.log2(rows / d))


def _elect(
    points: FloatArray, grid: FloatArray, found: Sequence[IntArray], n_motions: int
) -> tuple[IntArray, dict[str, Any]]:
    """Choose among the groups found at all distortions by votes (step 3); 0 = outlier."""
    large = np.array([_without_small_groups(groups) for groups in found])
    counts = large.max(axis=1)
    nearest = min(set(counts.tolist()), key=lambda count: (abs(count - n_motions), -count))
    candidates = np.unique(large[counts == nearest], axis=0)
    voters = grid[[groups.max() > 1 for groups in found]]
    lengths = np.array([_coding_lengths(points, candidate, voters) for candidate in candidates])
    votes = np.bincount(lengths.argmin(axis=0), minlength=len(candidates))
    winner = candidates[votes.argmax()]
    return np.where(winner <= n_motions, winner, 0), {
        "candidates": len(candidates),
        "votes": int(votes.max()),
        "exact_count": bool(nearest == n_motions),
    }


def _without_small_groups(groups: IntArray) -> IntArray:
    large = int((np.bincount(groups)[1:] > _LARGEST_OUTLIER_GROUP).sum())
    return np.where(groups <= large, groups, 0)


def _coding_lengths(points: FloatArray, labels: IntArray, distortions: FloatArray) -> FloatArray:
    """Bits (E,) to code points (n, M) group by group at each distortion."""
    # Ma, Derksen, Hong, Wright, "Segmentation of multivariate mixed data via lossy data coding and
    # compression", TPAMI 2007, equation 13 (no mean).
    n, total = points.shape
    bits = np.zeros(len(distortions))
    for group in np.unique(labels):
        part = points[:, labels == group]
        m = part.shape[1]
        squares = np.linalg.svd(part, compute_uv=False) ** 2
        logarithm = np.log1p(n / (distortions[:, None] ** 2 * m) * squares).sum(axis=1)
        bits += (m + n) / 2 * logarithm / np.log(2) - m * np.log2(m / total)
    return bits


def _compress(points: FloatArray, distortion: float) -> IntArray:
    """Merge, while any union saves bits, the two groups whose union saves most; the largest is group 1.

    If coding everything as one group is shorter still, it is one group.
    """
    # Ma, Derksen, Hong, Wright, TPAMI 2007, algorithm 1.
    state = _Groups(points, distortion)
    while state.merge():
        pass
    labels = by_size(state.owner)
    single = np.ones_like(labels)
    separate, together = (_coding_lengths(points, x, np.array([distortion]))[0] for x in (labels, single))
    return single if together < separate else labels


class _Groups:
    """Groups under merging, with the bits that each union would add (negative: save).

    Scatter matrices add up under merging. Unions with single points all have the same size, so their
    determinants follow from one inverse (matrix determinant lemma); those with larger groups take one
    batch of Cholesky factorisations.
    """

    def __init__(self, points: FloatArray, distortion: float) -> None:
        self.points, self.distortion = points, distortion
        n, total = points.shape
        self.owner, self.size = np.arange(total), np.ones(total)
        self.scatter = points.T[:, :, None] * points.T[:, None, :]
        gram = points.T @ points
        squares = np.diagonal(gram)
        self.length = self._bits(1.0, np.log1p(n / distortion**2 * squares))
        a = n / (2 * distortion**2)
        grown = 1 + a * squares
        # |w_i|^2 |w_j|^2 - (w_i . w_j)^2 first: it may be tiny compared with either term.
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
        self.change[i] = self.change[:, i] = self._unions(i)
        self.change[j] = self.change[:, j] = np.inf
        self.best[j] = np.inf
        # Whose best partner was one of the two looks for another, unless the union is better still.
        better = self.change[i] < self.best
        stale = np.flatnonzero(((self.partner == i) | (self.partner == j)) & ~better & (self.size > 0))
        self.best[better], self.partner[better] = self.change[i][better], i
        stale = np.append(stale, i)
        self.partner[stale] = self.change[stale].argmin(axis=1)
        self.best[stale] = self.change[stale, self.partner[stale]]
        return True

    def _unions(self, i: int) -> FloatArray:
        """Bits that unions of group i with all others add."""
        bits = np.full(len(self.size), np.inf)
        single = np.flatnonzero(self.size == 1)
        if len(single):
            logarithm, squares = self._factor(i, self.size[i] + 1, self.points[:, single])
            bits[single] = self._bits(self.size[i] + 1, logarithm + np.log1p(squares))
        groups = np.flatnonzero(self.size > 1)
        groups = groups[groups != i]
        if len(groups):
            sizes = self.size[i] + self.size[groups]
            unions = self.scatter[groups]
            unions += self.scatter[i]
            bits[groups] = self._bits(sizes, _log_determinants(self._identity_plus(unions, sizes)))
        return np.asarray(bits - (self.length[i] + self.length))

    def _identity_plus(self, scatter: FloatArray, sizes: FloatArray) -> FloatArray:
        """Turn (B, n, n) scatters S of groups into I + a S, a = n / (epsilon^2 size), in place."""
        n = scatter.shape[1]
        scatter *= (n / (self.distortion**2 * sizes))[:, None, None]
        scatter.reshape(len(scatter), n * n)[:, :: n + 1] += 1
        return scatter

    def _factor(self, i: int, size: float, points: FloatArray) -> tuple[float, FloatArray]:
        """Return log det B and ``a w^T B^-1 w`` of points w: B = I + a S_i."""
        matrix = self._identity_plus(self.scatter[[i]], np.array([size]))[0]
        right = points * (np.sqrt(len(self.points) / size) / self.distortion)
        factor, failed = dpotrf(matrix, lower=1)
        if not failed and np.diagonal(factor).min() >= 1:
            half, _ = dtrtrs(factor, right, lower=1)
            return 2 * float(np.log(np.diagonal(factor)).sum()), np.einsum("kj,kj->j", half, half)
        logarithm, squares = _eliminate(matrix[None], right[None])
        return float(logarithm[0]), squares[0]

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
    return _eliminate(matrices, np.zeros((len(matrices), matrices.shape[1], 0)))[0]


def _eliminate(matrices: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return log det B (b,) and ``w^T B^-1 w`` (b, m) of B = I + S (b, n, n) that rounding made indefinite.

    Elimination leaves pivots of 1 plus something >= 0; less is rounding, in a direction without scatter.
    """
    matrices, right = matrices.transpose(1, 2, 0).copy(), right.transpose(1, 2, 0).copy()
    logarithm, squares = np.zeros(matrices.shape[2]), np.zeros(right.shape[1:])
    for k in range(len(matrices)):
        pivot = np.maximum(matrices[k, k], 1)
        logarithm += np.log(pivot)
        squares += right[k] ** 2 / pivot
        factor = np.where(matrices[k, k] > 1, matrices[k + 1 :, k] / pivot, 0)
        right[k + 1 :] -= factor[:, None] * right[k]
        matrices[k + 1 :, k + 1 :] -= factor[:, None] * matrices[k, k + 1 :]
    return logarithm, squares.T
