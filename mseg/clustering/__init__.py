"""Clustering of affinities: Laplacian, embedding, k-means and their multi-view relatives."""
