"""Robust shape interaction matrix (RSIM)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.linalg import eigh, eigvalsh

from kt3dmoseg.options import option
from kt3dmoseg.types import FloatArray, IntArray
from mseg.clustering.spectral import relative_eigengaps, unit_rows
from mseg.geometry.subspaces import leading_row_space
from mseg.iteration import Convergence, iterate
from mseg.methods.complete_data import CompleteData, CompleteDataMethod
from mseg.types import Grouping

_NEGLIGIBLE = 1e-6
_LARGEST_COUNT = 6
_OFFSET = 0.5
_MAX_ROUNDS = 50
_NO_GAIN = 1e-15


@dataclass(frozen=True)
class RSIM(CompleteDataMethod):
    """Shape interaction matrix, row-normalised, raised to a power, at the rank that cuts best.

    For every rank r = K..4K: rows of the r leading right singular vectors of X (normalised coordinates with
    ones) at unit length, ``Z = V V^T``, affinity ``W = max(Z, 0)^power``, normalised cuts into K groups. The
    rank wins whose segmentation has the least

        score_r = sum_k cut(group k, rest) / (lambda_K - lambda_{K+1}),

    lambda the eigenvalues of ``D^-1 W``, largest first.

    Source: Ji, Salzmann, Li, "Shape interaction matrix revisited and robustified", ICCV 2015, algorithm 1
    and equation 12; power 3.5 and the ranks are those of the authors' code. Normalised cuts: Yu and Shi,
    "Multiclass spectral clustering", ICCV 2003, with the offset of "Understanding popout through repulsion",
    CVPR 2001. Deviation: the authors' discretisation starts from one random row, so that single sequences
    flip with the seed; here the best of several starts counts.
    Input: complete trajectories (gaps are completed; the authors use GROUSE there). Number of motions:
    given, or by relative eigengaps averaged over the ranks (ours). Outliers:
    not handled. Cost: O(K N^3); O(N^2) memory.
    """

    finds_n_motions: ClassVar[bool] = True

    power: float = option(3.5, "exponent of the affinity", low=1)
    starts: int = option(10, "starts of the discretisation", low=1)

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        # The row space of all homogeneous positions: a row of ones for each frame, as one.
        ones = np.full(data.n_points, np.sqrt(data.normalised.shape[0] // 2))
        matrix = np.vstack([data.normalised, ones])
        k = n_motions or self._count(matrix)
        space = leading_row_space(matrix, 4 * k)
        ranks = range(min(k, space.shape[1]), space.shape[1] + 1)
        found, scores = [], []
        for rank in ranks:
            affinity = self._affinity(space[:, :rank])
            found.append(_discretise(_ncut_embedding(affinity, k), rng, self.starts))
            scores.append(_cut_over_gap(affinity, found[-1][0], k))
        best = int(np.argmin(scores))
        labels, _, convergence = found[best]
        report = {"rank": ranks[best], "score": scores[best], "n_motions": k}
        return labels + 1, report | convergence.report()

    def _affinity(self, space: FloatArray) -> FloatArray:
        """Affinity (N, N) of the rows of an orthonormal basis (N, r)."""
        rows = unit_rows(space)
        affinity = np.maximum(rows @ rows.T, 0) ** self.power
        return np.where(affinity < _NEGLIGIBLE, 0.0, affinity)

    def _count(self, matrix: FloatArray) -> int:
        """Find the k whose relative eigengap, averaged over the ranks k..4k, is widest."""
        space = leading_row_space(matrix, 4 * _LARGEST_COUNT)
        ranks = range(1, space.shape[1] + 1)
        gaps = [relative_eigengaps(self._affinity(space[:, :r]), _LARGEST_COUNT) for r in ranks]
        counts = range(2, len(gaps[0]) + 1)
        widest = [np.mean([g[k - 1] for g in gaps[k - 1 : 4 * k]] or 0) for k in counts]
        return int(np.argmax(widest)) + 2 if widest else 1


def _cut_over_gap(affinity: FloatArray, labels: IntArray, n_clusters: int) -> float:
    n, degree = len(labels), affinity.sum(axis=1)
    cut = float(affinity[labels[:, None] != labels].sum())
    if n_clusters >= n:
        return cut
    scale = 1 / np.sqrt(np.where(degree > 0, degree, 1))
    walk = affinity * scale[:, None] * scale
    values = eigvalsh(walk, subset_by_index=(n - n_clusters - 1, n - 1), check_finite=False)
    gap = float(values[1] - values[0])
    return cut / gap if gap > 0 else np.inf


def _ncut_embedding(affinity: FloatArray, n_clusters: int) -> FloatArray:
    """Leading eigenvectors (N, K) of ``W + o I`` with degrees ``D + 2 o I``, each of norm ``sqrt(N)``.

    The offset o keeps points without neighbours finite.
    """
    n = len(affinity)
    scale = 1 / np.sqrt(affinity.sum(axis=1) + 2 * _OFFSET + np.finfo(np.float64).eps)
    weights = affinity * scale[:, None] * scale
    weights.flat[:: n + 1] += _OFFSET * scale**2
    _, vectors = eigh(weights, subset_by_index=(n - n_clusters, n - 1), check_finite=False)
    walk = vectors[:, ::-1] * scale[:, None]
    return np.asarray(walk / np.linalg.norm(walk, axis=0) * np.sqrt(n))


def _discretise(
    embedding: FloatArray, rng: np.random.Generator, n_starts: int = 10
) -> tuple[IntArray, float, Convergence]:
    """Rotate an embedding (N, K) to the nearest indicator of a partition; of several starts the nearest wins.

    The first axis of a start is a random row, each further axis the row least aligned with those before.
    Returns clusters 0..K-1, how near they are, and the convergence of that.
    """
    rows = unit_rows(embedding)
    best = None
    for first in rng.integers(len(rows), size=n_starts).tolist():
        axes, aligned = [rows[first]], np.zeros(len(rows))
        for _ in range(rows.shape[1] - 1):
            aligned += np.abs(rows @ axes[-1])
            axes.append(rows[aligned.argmin()])
        found = _rotate(rows, np.stack(axes, axis=1))
        if best is None or found[1] > best[1] * (1 + 1e-12):
            best = found
    assert best is not None
    return best


def _rotate(rows: FloatArray, rotation: FloatArray) -> tuple[IntArray, float, Convergence]:
    """Alternate assignment to the largest coordinate and rotation (orthogonal Procrustes)."""
    k, alignment = rows.shape[1], -np.inf
    labels = np.zeros(len(rows), dtype=np.int64)

    def turn() -> float:
        nonlocal labels, alignment, rotation
        labels = (rows @ rotation).argmax(axis=1)
        totals = np.stack([np.bincount(labels, weights=column, minlength=k) for column in rows.T], axis=1)
        left, values, right = np.linalg.svd(totals)
        reached = float(values.sum())
        gain = (reached - alignment) / reached if reached > 0 else 0.0
        if gain > _NO_GAIN:
            alignment, rotation = reached, right.T @ left.T
        return max(gain, 0.0)

    convergence = iterate(turn, tolerance=_NO_GAIN, max_iterations=_MAX_ROUNDS)
    return labels, alignment, convergence
