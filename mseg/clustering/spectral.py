"""Spectral clustering: embedding, unit rows, k-means."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.types import IntArray
from mseg.clustering.kmeans import kmeans
from mseg.clustering.laplacian import spectral_embedding, unit_rows


def spectral_clustering(
    affinity: npt.NDArray[Any],
    n_clusters: int,
    rng: np.random.Generator,
    *,
    n_restarts: int = 20,
    normalise_rows: bool = True,
) -> IntArray:
    """Partition the vertices of a weighted graph.

    Parameters
    ----------
    affinity : (N, N) float
        Symmetric weights >= 0.
    n_clusters : int
        Number of clusters K.
    rng : numpy.random.Generator
        Randomness of k-means.
    n_restarts : int
        Restarts of k-means.
    normalise_rows : bool
        Whether rows of the embedding are scaled to unit length before k-means.

    Returns
    -------
    (N,) int64
        Labels 1..K.

    Raises
    ------
    TooFewPointsError
        When there are fewer vertices than clusters.

    References
    ----------
    Ng, Jordan, Weiss, "On spectral clustering: analysis and an algorithm", NIPS 2001.
    """
    embedding = spectral_embedding(affinity, n_clusters)
    points = unit_rows(embedding) if normalise_rows else embedding
    return kmeans(points, n_clusters, rng, n_restarts=n_restarts).labels + 1
