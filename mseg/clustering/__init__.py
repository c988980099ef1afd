"""Clustering of affinities: Laplacian, embedding, k-means and their multi-view relatives."""

from __future__ import annotations

from mseg.clustering.kmeans import KMeans, kmeans
from mseg.clustering.laplacian import (
    normalised_laplacian,
    smallest_eigenvectors,
    spectral_embedding,
    unit_rows,
)
from mseg.clustering.spectral import spectral_clustering

__all__ = [
    "KMeans",
    "kmeans",
    "normalised_laplacian",
    "smallest_eigenvectors",
    "spectral_clustering",
    "spectral_embedding",
    "unit_rows",
]
