"""Normalised cuts: embedding by the graph's random walk and rotation to the nearest partition."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from kt3dmoseg.types import FloatArray, IntArray
from mseg.clustering.laplacian import unit_rows
from mseg.iteration import Convergence, iterate

_MAX_ROUNDS = 50
_NO_GAIN = 1e-15


@dataclass(frozen=True, eq=False)
class Partition:
    """Clusters nearest to an embedding.

    Parameters
    ----------
    labels : (N,) int64
        Clusters 0..K-1.
    alignment : float
        Sum of the singular values of the indicator's product with the embedding: how near it is.
    convergence : Convergence
        Relative gain of `alignment` in the last round.
    """

    labels: IntArray
    alignment: float
    convergence: Convergence


def offset_ncut_embedding(affinity: FloatArray, n_clusters: int, offset: float = 0.5) -> FloatArray:
    """Leading generalised eigenvectors of an affinity with a regularising offset.

    Half the offset's double is added to the diagonal, the whole double to the degrees: ``W + o I`` and
    ``D + 2 o I``. Points without neighbours then stay finite.

    Parameters
    ----------
    affinity : (N, N) float64
        Symmetric weights >= 0.
    n_clusters : int
        Number K of eigenvectors.
    offset : float
        The offset o.

    Returns
    -------
    (N, K) float64
        Eigenvectors of the random walk, each of norm ``sqrt(N)``, the smoothest first.

    References
    ----------
    Yu and Shi, "Understanding popout through repulsion", CVPR 2001 (the offset), and "Multiclass spectral
    clustering", ICCV 2003.
    """
    n = len(affinity)
    scale = 1 / np.sqrt(affinity.sum(axis=1) + 2 * offset + np.finfo(np.float64).eps)
    weights = affinity * scale[:, None] * scale
    weights.flat[:: n + 1] += offset * scale**2
    _, vectors = eigh(weights, subset_by_index=(n - n_clusters, n - 1), check_finite=False)
    walk = vectors[:, ::-1] * scale[:, None]
    return np.asarray(walk / np.linalg.norm(walk, axis=0) * np.sqrt(n))


def discretise(embedding: FloatArray, rng: np.random.Generator, *, n_starts: int = 10) -> Partition:
    """Rotate an embedding to the nearest indicator of a partition.

    Assignment (the largest coordinate) and rotation (orthogonal Procrustes) alternate. The first axis of
    a start is a random row, each further axis the row least aligned with those before. Of several starts
    the one that ends nearest to an indicator wins; the published algorithm has one, and its result
    then depends on the draw.

    Parameters
    ----------
    embedding : (N, K) float64
        Eigenvectors as columns.
    rng : numpy.random.Generator
        Draws the first rows.
    n_starts : int
        Number of starts.

    Returns
    -------
    Partition
        The nearest one.

    References
    ----------
    Yu and Shi, "Multiclass spectral clustering", ICCV 2003.
    """
    rows = unit_rows(embedding)
    starts = rng.integers(len(rows), size=n_starts).tolist()
    best = _rotate(rows, _start(rows, starts[0]))
    for first in starts[1:]:
        found = _rotate(rows, _start(rows, first))
        if found.alignment > best.alignment * (1 + 1e-12):
            best = found
    return best


def _start(rows: FloatArray, first: int) -> FloatArray:
    axes = [rows[first]]
    aligned = np.zeros(len(rows))
    for _ in range(rows.shape[1] - 1):
        aligned += np.abs(rows @ axes[-1])
        axes.append(rows[aligned.argmin()])
    return np.stack(axes, axis=1)


def _rotate(rows: FloatArray, rotation: FloatArray) -> Partition:
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
    return Partition(labels, alignment, convergence)
