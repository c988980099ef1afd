"""Robust preference analysis (RPA)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import FloatArray, IntArray
from mseg.clustering.kmeans import kmeans
from mseg.completion import robust_pca
from mseg.geometry.subspaces import best_flat_distances
from mseg.iteration import Convergence, iterate
from mseg.methods.complete_data import CompleteData, CompleteDataMethod
from mseg.methods.tlinkage import FLAT_DIMENSION, flat_residuals, tanimoto_distance
from mseg.types import Grouping

# Start of the other memberships: multiplicative updates cannot leave zero.
_OTHER_CLUSTERS = 0.2
_INLIER = 5.0


@dataclass(frozen=True)
class RPA(CompleteDataMethod):
    """Clean the similarities of preferences by robust principal components, then factor it into memberships.

    1. Points of R^5 and 6 N flats through four neighbours each, as in T-Linkage. (The authors guide half of
       their samples by the preferences for the other half; here neighbourhood guides all of them.)
    2. Preferences ``1 / (1 + (r / (5 sigma))^2)``, Tanimoto distances D between them, kernel ``exp(-D^2)``.
    3. Robust principal components, weight ``1 / sqrt(N)``: the low-rank part is the clean kernel.
    4. Symmetric non-negative factorisation into N x K memberships, from the indicator of k-means on the
       kernel's leading eigenvectors (instead of 600 random replicates); the largest membership decides.
    5. A flat is fitted to each group, trimmed to residuals under 5 sigma and fitted again; trajectories join
       the nearest flat. If wanted, those beyond 5 sigma of all flats are outliers.

    Source: Magri and Fusiello, "Robust multiple model fitting with preference analysis and low-rank
    approximation", BMVC 2015. Its motion experiments use fundamental matrices of two frames; flats of whole
    trajectories and sigma in pixels are ours, so its figures are not to be expected.
    Input: complete trajectories (gaps are completed). Number of motions: given. Outliers: labelled 0 on
    request. Cost: O(N^2 M) for M = 6 N flats, about 30 iterations of O(N^3); O(N M) memory.
    """

    sigma: float = option(0.5, "noise scale, rms pixels per frame of 640 x 480", low=1e-9)
    dimension: int = option(5, "dimension of the projection", low=1)
    samples: int = option(6, "flats per trajectory", low=1)
    restarts: int = option(20, "restarts of k-means", low=1)
    reject_outliers: bool = option(False, "label trajectories beyond 5 sigma of all motions as outliers")

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        """Label the columns of the trajectory matrix."""
        assert n_motions is not None
        points, residuals = flat_residuals(data.pixels / data.unit, self.dimension, self.samples, rng)
        preferences = 1 / (1 + (residuals / (_INLIER * self.sigma)) ** 2)
        clean = robust_pca(np.exp(-(tanimoto_distance(preferences) ** 2)), tolerance=1e-6)
        kernel = np.maximum((clean.low_rank + clean.low_rank.T) / 2, 0)
        _, vectors = np.linalg.eigh(kernel)
        first = kmeans(vectors[:, -n_motions:], n_motions, rng, n_restarts=self.restarts).labels
        soft, convergence = _factors(kernel, (first[:, None] == np.arange(n_motions)) + _OTHER_CLUSTERS)
        groups = soft.argmax(axis=1)
        distance = np.array([self._distances(points, np.flatnonzero(groups == k)) for k in np.unique(groups)])
        labels = distance.argmin(axis=0) + 1
        if self.reject_outliers:
            labels[distance.min(axis=0) > _INLIER * self.sigma] = 0
        return labels, {**clean.convergence.report("kernel_"), **convergence.report()}

    def _distances(self, points: FloatArray, group: IntArray) -> FloatArray:
        """Distances (N,) to a group's flat, fitted twice: the second time without what is far off."""
        distance = best_flat_distances(points, group, FLAT_DIMENSION)
        near = group[distance[group] < _INLIER * self.sigma]
        return best_flat_distances(points, near, FLAT_DIMENSION) if len(near) > FLAT_DIMENSION else distance


def _factors(affinity: FloatArray, start: FloatArray) -> tuple[FloatArray, Convergence]:
    """Minimise ``|A - U U^T|_F^2`` over memberships U (N, K) >= 0 by damped multiplicative updates."""
    # U <- U o (1/2 + 1/2 A U / (U U^T U)) never raises the objective: Ding, Li, Jordan, "Nonnegative matrix
    # factorization for combinatorial optimization", ICDM 2008.
    u = start.copy()

    def step() -> float:
        nonlocal u
        denominator = u @ (u.T @ u)
        gain = np.divide(affinity @ u, denominator, out=np.zeros_like(u), where=denominator > 0)
        updated = u * (0.5 + 0.5 * gain)
        moved = float(np.linalg.norm(updated - u))
        u = updated
        return moved / (float(np.linalg.norm(u)) or 1.0)

    convergence = iterate(step, tolerance=1e-5, max_iterations=1000)
    return u, convergence
