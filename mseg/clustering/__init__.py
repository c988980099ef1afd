"""Clustering of affinities: Laplacian, embedding, k-means and their multi-view relatives."""

from __future__ import annotations

from mseg.clustering.counting import Count, Criterion, count_clusters
from mseg.clustering.fusion import Cut, Fusion, WeightedSum, constrain_subsets, coregularise, lower_cut
from mseg.clustering.kmeans import KMeans, kmeans
from mseg.clustering.spectral import (
    GraphLaplacian,
    count_by_eigengap,
    normalised_laplacian,
    relative_eigengaps,
    smallest_eigenvectors,
    spectral_clustering,
    spectral_embedding,
    unit_rows,
)

__all__ = [
    "Count",
    "Criterion",
    "Cut",
    "Fusion",
    "GraphLaplacian",
    "KMeans",
    "WeightedSum",
    "constrain_subsets",
    "coregularise",
    "count_by_eigengap",
    "count_clusters",
    "kmeans",
    "lower_cut",
    "normalised_laplacian",
    "relative_eigengaps",
    "smallest_eigenvectors",
    "spectral_clustering",
    "spectral_embedding",
    "unit_rows",
]
