"""k-means with many restarts, all of them advanced together as arrays."""

from dataclasses import dataclass

import numpy as np

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import Float32Array, FloatArray, IntArray
from mseg.errors import TooFewPointsError


@dataclass(frozen=True, eq=False)
class KMeans:
    """The best of the restarts."""

    labels: IntArray  # (N,): cluster of each point, 0..K-1
    centres: FloatArray  # (K, d): means of the clusters
    inertia: float  # sum of squared distances of the points to their centres


def kmeans(
    points: FloatArray | Float32Array, n_clusters: int, rng: np.random.Generator, *, n_restarts: int = 20
) -> KMeans:
    """Cluster points (N, d) by Lloyd's algorithm from several k-means++ starts.

    The start of least inertia wins, the first of equals. Where there are fewer distinct points than clusters,
    surplus clusters stay empty; fewer points than clusters are a TooFewPointsError. In single
    precision it takes half of the time.
    """
    # Lloyd, "Least squares quantization in PCM", 1982; Arthur and Vassilvitskii, "k-means++: the advantages
    # of careful seeding", SODA 2007.
    if not np.isfinite(points).all():  # NaN would make a partition like any other
        raise InvalidValueError("points", expected="a finite matrix (N, d)", found=f"shape {points.shape}")
    if not 1 <= n_clusters <= len(points):
        raise TooFewPointsError(
            "number of clusters", expected=f"1..{len(points)} (points)", found=str(n_clusters)
        )
    # Distances do not change with the origin; near the mean they lose fewest digits.
    mean = points.mean(axis=0)
    centred = np.ascontiguousarray(points - mean)
    squares = np.einsum("nd,nd->n", centred, centred)
    centres = _plus_plus(centred, squares, n_clusters, rng, n_restarts)
    labels, centres = _lloyd(centred, squares, centres)
    nearest = np.take_along_axis(centres, labels[:, :, None], axis=1)
    inertia = ((centred - nearest) ** 2).sum(axis=(1, 2))
    best = int(inertia.argmin())
    return KMeans(labels[best], centres[best] + mean, float(inertia[best]))


def _plus_plus(
    points: FloatArray, squares: FloatArray, n_clusters: int, rng: np.random.Generator, n_restarts: int
) -> FloatArray:
    """Draw (R, K, d) starting centres among the points, far ones preferred."""
    n = len(points)
    draws = rng.random((n_clusters, n_restarts))
    chosen = np.minimum((draws[0] * n).astype(np.int64), n - 1)
    centres = np.empty((n_restarts, n_clusters, points.shape[1]), points.dtype)
    centres[:, 0] = points[chosen]
    nearest = np.full((n_restarts, n), np.inf, points.dtype)
    for k in range(1, n_clusters):
        np.minimum(nearest, _distances(points, squares, centres[:, k - 1]), out=nearest)
        cumulative = nearest.cumsum(axis=1)
        target = draws[k] * cumulative[:, -1]
        # With no distance left (fewer distinct points than clusters) the last point is repeated.
        chosen = np.minimum((cumulative <= target[:, None]).sum(axis=1), n - 1)
        centres[:, k] = points[chosen]
    return centres


def _lloyd(points: FloatArray, squares: FloatArray, centres: FloatArray) -> tuple[IntArray, FloatArray]:
    """Alternate assignment and means for all restarts until none changes any more.

    Without a cap: a restart goes on only while what its centres explain has grown, and there are finitely
    many partitions (Selim and Ismail, "K-means-type algorithms", TPAMI 1984).
    """
    n_restarts, n_clusters, dimension = centres.shape
    labels = np.full((n_restarts, len(points)), -1, dtype=np.int64)
    explained = np.full(n_restarts, -np.inf)
    active = np.arange(n_restarts)
    while len(active):
        flat = centres[active].reshape(-1, dimension)
        distance = _distances(points, squares, flat).reshape(len(active), n_clusters, len(points))
        assigned = distance.argmin(axis=1)
        moved = (assigned != labels[active]).any(axis=1)
        labels[active] = assigned
        active, assigned = active[moved], assigned[moved]
        if not len(active):
            break
        centres[active], now = _means(points, assigned, centres[active])
        grown = now > explained[active]
        explained[active] = now
        active = active[grown]
    return labels, centres


def _means(points: FloatArray, labels: IntArray, centres: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means of the clusters of each restart, and ``sum_k n_k |mean_k|^2`` of each.

    A cluster that lost all its points keeps its centre.
    """
    n_restarts, n_clusters, dimension = centres.shape
    inside = (labels[:, None, :] == np.arange(n_clusters)[:, None]).astype(points.dtype)
    inside = inside.reshape(n_restarts * n_clusters, -1)
    count = inside.sum(axis=1, keepdims=True)
    total = inside @ points
    mean = np.divide(total, count, out=centres.reshape(-1, dimension).copy(), where=count > 0)
    explained = count[:, 0] * np.einsum("cd,cd->c", mean, mean)
    return mean.reshape(centres.shape), explained.reshape(n_restarts, n_clusters).sum(axis=1)


def _distances(points: FloatArray, squares: FloatArray, centres: FloatArray) -> FloatArray:
    """Squared distances (C, N) of all points to all centres (C, d)."""
    distance: FloatArray = -2.0 * (centres @ points.T)
    distance += squares
    distance += np.einsum("cd,cd->c", centres, centres)[:, None]
    np.maximum(distance, 0.0, out=distance)
    return distance
