"""How many clusters an embedding shows: published criteria, to compare with and to replace in one place."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Literal, TypeAlias

import numpy as np

from kt3dmoseg.types import FloatArray, IntArray
from mseg.clustering.kmeans import kmeans
from mseg.clustering.spectral import EIGENVALUE_FLOOR, Symmetric, smallest_eigenvectors, unit_rows

Criterion: TypeAlias = Literal["eigengap", "self_tuning", "vote"]
MOST_CLUSTERS = 8
# Angles tried for one plane of rotation, most sweeps over the planes, a lower cost that counts as lower.
_ANGLES = np.linspace(-np.pi / 4, np.pi / 4, 33)
_SWEEPS, _PROGRESS = 20, 1e-4
# Costs of alignment that count as equal: the largest number of them is taken.
_EQUAL_COST = 1e-3
# Silhouettes compare all pairs of at most so many points.
_SILHOUETTE_POINTS = 1500
_RESTARTS = 10


@dataclass(frozen=True)
class Count:
    """A number of clusters."""

    number: int  # the number found
    scores: Mapping[int, float]  # of every number that was compared, the higher the better

    @property
    def runners_up(self) -> list[int]:
        """The other numbers, the best first."""
        others = (k for k in self.scores if k != self.number)
        return sorted(others, key=lambda k: -self.scores[k])


def count_clusters(laplacian: Symmetric, criterion: Criterion, rng: np.random.Generator) -> Count:
    """Count the clusters of a graph by its normalised Laplacian (N, N), at least two and at most eight.

    The criterion is the widest relative gap ``(lambda_{k+1} - lambda_k) / (lambda_k + 0.01)`` of the
    eigenvalues ("eigengap"); the rotation of k eigenvectors that comes nearest to one entry per row
    ("self_tuning"); or the majority of eigengap, silhouette, Davies-Bouldin and Calinski-Harabasz on k-means
    of k eigenvectors, the eigengap deciding a tie ("vote"). A graph of fewer than three vertices counts 1.
    """
    # von Luxburg, "A tutorial on spectral clustering", 2007, section 8.3; Zelnik-Manor and Perona,
    # "Self-tuning spectral clustering", NIPS 2004; Rousseeuw, J. Comput. Appl. Math. 1987; Davies and
    # Bouldin, PAMI 1979; Calinski and Harabasz, Communications in Statistics 1974.
    most = min(MOST_CLUSTERS, laplacian.shape[0] - 1)
    if most < 2:
        return Count(1, {1: 0.0})
    vectors = smallest_eigenvectors(laplacian, most + 1)
    values = np.maximum(np.einsum("nk,nk->k", vectors, laplacian @ vectors), 0)
    gaps = np.diff(values) / (values[:-1] + EIGENVALUE_FLOOR)
    numbers = range(2, most + 1)
    if criterion == "eigengap":
        return _best({k: float(gaps[k - 1]) for k in numbers})
    if criterion == "self_tuning":
        cost: dict[int, float] = {}
        rotated = vectors[:, :1]
        for k in numbers:  # each from the rotation found for the one before, as in the paper
            rotated, cost[k] = _align(np.column_stack([rotated, vectors[:, k - 1]]))
        least = min(cost.values())
        return Count(max(k for k in cost if cost[k] <= least + _EQUAL_COST), {k: -cost[k] for k in cost})
    return _vote(vectors, {k: float(gaps[k - 1]) for k in numbers}, rng)


def _vote(vectors: FloatArray, gaps: Mapping[int, float], rng: np.random.Generator) -> Count:
    from sklearn.metrics import calinski_harabasz_score, davies_bouldin_score, silhouette_score  # slow

    embeddings = {k: unit_rows(vectors[:, :k]) for k in gaps}
    labels = {k: kmeans(points, k, rng, n_restarts=_RESTARTS).labels for k, points in embeddings.items()}
    some = rng.permutation(len(vectors))[:_SILHOUETTE_POINTS]

    def index(score: Callable[[FloatArray, IntArray], float], k: int, rows: IntArray | slice) -> float:
        points, own = embeddings[k][rows], labels[k][rows]
        return float(score(points, own)) if 1 < len(np.unique(own)) < len(points) else -np.inf

    every = slice(None)
    ballots = [
        gaps,
        {k: index(silhouette_score, k, some) for k in gaps},
        {k: index(lambda points, own: -davies_bouldin_score(points, own), k, every) for k in gaps},
        {k: index(calinski_harabasz_score, k, every) for k in gaps},
    ]
    votes = [_best(ballot).number for ballot in ballots]
    # Half a vote for the eigengap decides ties.
    return _best({k: votes.count(k) + 0.5 * (k == votes[0]) for k in gaps})


def _best(scores: Mapping[int, float]) -> Count:
    return Count(max(scores, key=lambda k: scores[k]), dict(scores))


def _align(points: FloatArray) -> tuple[FloatArray, float]:
    """Rotate points (N, k) so that ``mean_i sum_j z_ij^2 / max_j z_ij^2``, at least 1, is low; and that cost.

    Angles are found plane by plane among fixed ones instead of by gradient descent.
    """
    squares = np.maximum((points**2).sum(axis=1), np.finfo(np.float64).tiny)
    cosine, sine = np.cos(_ANGLES)[:, None], np.sin(_ANGLES)[:, None]
    cost = np.inf
    for _ in range(_SWEEPS):
        before = cost
        for i, j in combinations(range(points.shape[1]), 2):
            others = np.delete(points, (i, j), axis=1)
            largest = (others**2).max(axis=1, initial=0.0)
            first = cosine * points[:, i] - sine * points[:, j]
            second = sine * points[:, i] + cosine * points[:, j]
            tops = np.maximum(np.maximum(first**2, second**2), largest)
            values = (squares / np.maximum(tops, np.finfo(np.float64).tiny)).mean(axis=1)
            best = int(values.argmin())
            if values[best] < cost:
                cost = float(values[best])
                points = points.copy()
                points[:, i], points[:, j] = first[best], second[best]
        if before - cost < _PROGRESS:
            break
    return points, cost
