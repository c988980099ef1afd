"""Clustering of affinities: Laplacian, embedding, k-means and their multi-view relatives."""

from __future__ import annotations

from mseg.clustering.cuts import Cut, lower_cut
from mseg.clustering.eigen import smallest_eigenvectors
from mseg.clustering.fusion import Fusion, constrain_subsets, coregularise
from mseg.clustering.kmeans import KMeans, kmeans
from mseg.clustering.laplacian import (
    GraphLaplacian,
    normalised_laplacian,
    spectral_embedding,
    unit_rows,
)
from mseg.clustering.spectral import spectral_clustering
from mseg.clustering.symmetric import Symmetric, WeightedSum

__all__ = [
    "Cut",
    "Fusion",
    "GraphLaplacian",
    "KMeans",
    "Symmetric",
    "WeightedSum",
    "constrain_subsets",
    "coregularise",
    "kmeans",
    "lower_cut",
    "normalised_laplacian",
    "smallest_eigenvectors",
    "spectral_clustering",
    "spectral_embedding",
    "unit_rows",
]
