"""Agglomerative lossy compression (ALC): groups merge while that shortens the code for the data."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from kt3dmoseg.compiled import compiled
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
    n, total = points.shape
    squares = np.einsum("nm,nm->m", points, points)
    length = _bits(1.0, np.log1p(n / distortion**2 * squares), n, total)
    # |w_i|^2 |w_j|^2 - (w_i . w_j)^2 first: it may be tiny compared with either term.
    area = np.maximum(np.multiply.outer(squares, squares) - (points.T @ points) ** 2, 0)
    a = n / (2 * distortion**2)
    determinant = 1 + a * np.add.outer(squares, squares) + a * a * area
    change = _bits(2.0, np.log(determinant), n, total) - length[:, None] - length
    np.fill_diagonal(change, np.inf)
    labels = by_size(_merged(np.ascontiguousarray(points.T), distortion, length, change))
    single = np.ones_like(labels)
    separate, together = (_coding_lengths(points, x, np.array([distortion]))[0] for x in (labels, single))
    return single if together < separate else labels


@compiled
def _bits(size: float, logarithm: FloatArray, n: int, total: int) -> FloatArray:
    """Bits of a group of `size` whose ``det(I + n/(epsilon^2 size) S)`` has this logarithm."""
    bits: FloatArray = (size + n) / (2 * _LN2) * logarithm - size * np.log2(size / total)
    return bits


@compiled
def _merged(points: FloatArray, distortion: float, length: FloatArray, change: FloatArray) -> IntArray:
    """Merge points (M, n) given their bits and those that each union adds (negative: saves): owners (M,).

    Scatter matrices add up under merging.
    """
    total, n = points.shape
    owner, size = np.arange(total), np.ones(total)
    scatter = np.empty((total, n, n))
    partner, best = np.empty(total, np.int64), np.empty(total)
    for k in range(total):
        scatter[k] = np.outer(points[k], points[k])
        partner[k] = change[k].argmin()
        best[k] = change[k, partner[k]]
    while True:
        i = int(best.argmin())
        if not best[i] <= 0:
            return owner
        j = int(partner[i])
        if j < 0:
            partner[i] = change[i].argmin()
            best[i] = change[i, partner[i]]
            continue
        owner[owner == j] = i
        length[i] += length[j] + best[i]
        size[i] += size[j]
        scatter[i] += scatter[j]
        size[j], best[j] = 0, np.inf
        added = _union_bits(i, points, scatter, size, distortion) - length[i] - length
        added[i] = np.inf
        for k in range(total):
            change[i, k] = change[k, i] = added[k]
            change[j, k] = change[k, j] = np.inf
            # Whose best partner was one of the two needs another; what it saved bounds what it can save.
            if size[k] > 0 and added[k] < best[k]:
                best[k], partner[k] = added[k], i
            elif partner[k] == i or partner[k] == j:
                partner[k] = -1
        partner[i] = change[i].argmin()
        best[i] = change[i, partner[i]]


@compiled
def _union_bits(
    i: int, points: FloatArray, scatter: FloatArray, size: FloatArray, distortion: float
) -> FloatArray:
    """Bits (M,) of the unions of group i with each other group; those of none are infinite.

    Unions with single points all have the same size, so their determinants follow from one elimination
    (matrix determinant lemma).
    """
    total, n = points.shape
    bits = np.full(total, np.inf)
    a = n / (distortion**2 * (size[i] + 1))
    single = a * scatter[i]
    logarithm = _eliminate(single)
    right = np.empty(n)
    for k in range(total):
        if k == i or size[k] == 0:
            continue
        if size[k] == 1:
            square = 0.0
            for row in range(n):
                value = points[k, row]
                for column in range(row):
                    value -= single[row, column] * right[column]
                right[row] = value
                square += value * value / single[row, row]
            found = logarithm + np.log1p(a * square)
        else:
            union = (scatter[i] + scatter[k]) * (n / (distortion**2 * (size[i] + size[k])))
            found = _eliminate(union)
        bits[k] = _bits(size[i] + size[k], found, n, total)
    return bits


@compiled
def _eliminate(matrix: FloatArray) -> float:
    """Return log det (I + S); S (n, n) becomes the factors of its elimination, the pivots on its diagonal.

    Elimination leaves pivots of 1 plus something >= 0; less is rounding, in a direction without scatter.
    """
    n = len(matrix)
    logarithm = 0.0
    for k in range(n):
        pivot = matrix[k, k] + 1
        for row in range(k + 1, n):
            factor = matrix[row, k] / pivot if pivot > 1 else 0.0
            for column in range(k + 1, row + 1):
                matrix[row, column] -= factor * matrix[column, k]
        for row in range(k + 1, n):
            matrix[row, k] = matrix[row, k] / pivot if pivot > 1 else 0.0
        matrix[k, k] = max(pivot, 1.0)
        logarithm += np.log(matrix[k, k])
    return logarithm
