"""Local subspace affinity (LSA)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import FloatArray
from mseg.clustering import spectral_clustering, unit_rows
from mseg.errors import TooFewPointsError
from mseg.geometry.subspaces import leading_row_space
from mseg.methods.complete_data import CompleteData, CompleteDataMethod
from mseg.types import Grouping

_LARGEST_BASIS = 4


@dataclass(frozen=True)
class LSA(CompleteDataMethod):
    """Group trajectories whose neighbours span similar subspaces.

    1. Trajectories become points of R^r: rows of the r leading right singular vectors of the matrix
       in pixels, at unit length.
    2. Each point and its k nearest by angle span a local subspace of dimension d = min(4, r - 1).
    3. Affinity ``exp(-sum_m sin^2 theta_m)`` over the d principal angles between local subspaces;
       with projectors P, ``sum sin^2 = d - <P_i, P_j>``, so all pairs are one matrix product.
    4. Spectral clustering.

    Source: Yan and Pollefeys, "A general framework for motion segmentation", ECCV 2006, in the form of
    the Hopkins155 benchmark (Tron and Vidal, CVPR 2007), whose "LSA 4n" is r = 4 K and k = 6.
    Input: complete trajectories (gaps are completed), at least k + 1 of them; the number of motions
    must be given. Outliers: not handled. Cost: O(N^2 r^2 + N^3) time, O(N^2 + N r^2) memory.
    """

    dimension: int = option(0, "dimension r of the projection; 0 = four times the number of motions", low=0)
    n_neighbours: int = option(6, "neighbours k that span a local subspace", low=1)
    restarts: int = option(10, "restarts of k-means", low=1)

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        """Label the columns of the trajectory matrix."""
        assert n_motions is not None
        if data.n_points <= self.n_neighbours:
            raise TooFewPointsError(
                "LSA", expected=f"more than {self.n_neighbours} trajectories", found=str(data.n_points)
            )
        points = unit_rows(leading_row_space(data.pixels, self.dimension or 4 * n_motions))
        affinity = _local_subspace_affinity(points, self.n_neighbours)
        labels = spectral_clustering(affinity, n_motions, rng, n_restarts=self.restarts)
        return labels, {"dimension": points.shape[1]}


def _local_subspace_affinity(points: FloatArray, n_neighbours: int) -> FloatArray:
    """Affinity (N, N) of unit points (N, r) by the principal angles of their local subspaces."""
    n, r = points.shape
    basis_size = max(1, min(_LARGEST_BASIS, r - 1))
    cosine = points @ points.T
    np.fill_diagonal(cosine, np.inf)  # the point itself always belongs to its neighbourhood
    nearest = np.argsort(-cosine, axis=1, kind="stable")[:, : n_neighbours + 1]
    left, _, _ = np.linalg.svd(points[nearest].transpose(0, 2, 1), full_matrices=False)
    basis = left[:, :, :basis_size]
    projector = (basis @ basis.transpose(0, 2, 1)).reshape(n, r * r)
    sines = np.maximum(basis_size - projector @ projector.T, 0)
    return np.asarray(np.exp(-sines))
