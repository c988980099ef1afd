"""One partition of the vertices of several graphs: its normalised cuts, and descent to smaller ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kt3dmoseg.types import FloatArray, IntArray
from mseg.clustering.laplacian import GraphLaplacian


@dataclass(frozen=True, eq=False)
class Cut:
    """A partition and what it cuts.

    Parameters
    ----------
    labels : (N,) int64
        Cluster of each vertex, 0..K-1.
    value : float
        Sum over graphs and clusters of the weight that leaves the cluster, divided by all its weight.
    """

    labels: IntArray
    value: float


def lower_cut(graphs: Sequence[GraphLaplacian], labels: IntArray, n_clusters: int) -> Cut:
    """Improve a partition until its normalised cuts, summed over the graphs, become no smaller.

    With S_v the indicators of the clusters, scaled by D_v^1/2 and to unit length, the cut of graph v
    is tr(S_v^T L_v S_v): what a spectral embedding minimises, but for a partition instead of any
    orthonormal columns. All vertices move at once, each to the cluster whose weighted kernel mean is
    nearest over all graphs; the last step that gained something is kept. No cluster is emptied.

    Parameters
    ----------
    graphs : sequence of GraphLaplacian
        Of the same N vertices.
    labels : (N,) int64
        Start, 0..K-1.
    n_clusters : int
        Number of clusters K. An empty one counts 1 per graph.

    Returns
    -------
    Cut
        Never larger than that of the start.

    References
    ----------
    Shi and Malik, "Normalized cuts and image segmentation", PAMI 2000; Dhillon, Guan, Kulis,
    "Weighted graph cuts without eigenvectors: a multilevel approach", PAMI 2007, for one graph.
    """
    value, nearness = _cut(graphs, labels, n_clusters)
    while True:
        moved = nearness.argmax(axis=1)
        if len(np.unique(moved)) < len(np.unique(labels)):
            return Cut(labels, value)
        lower, nearness = _cut(graphs, moved, n_clusters)
        if lower >= value:
            return Cut(labels, value)
        labels, value = moved, lower


def _cut(graphs: Sequence[GraphLaplacian], labels: IntArray, n_clusters: int) -> tuple[float, FloatArray]:
    """Value of a partition, and how near every vertex is to every cluster, (N, K)."""
    member = (labels[:, None] == np.arange(n_clusters)).astype(np.float64)
    nearness = np.zeros_like(member)
    value = 0.0
    for graph in graphs:
        root = graph.root_degree[:, None]
        scaled = root * member
        weight = np.einsum("nk,nk->k", scaled, scaled)
        weight[weight == 0] = np.inf
        smooth = scaled - graph @ scaled
        share = np.einsum("nk,nk->k", scaled, smooth) / weight
        value += float((1 - share).sum())
        nearness += root * (2 * smooth - root * share) / weight
    return value, nearness
