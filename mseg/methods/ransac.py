"""Sequential RANSAC of subspaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import FloatArray, IntArray
from mseg.geometry.subspaces import leading_row_space
from mseg.methods.complete_data import CompleteData, CompleteDataMethod
from mseg.types import Grouping

_BATCH = 100
_DEGENERATE = 1e-10


@dataclass(frozen=True)
class Ransac(CompleteDataMethod):
    """Find one motion after the other by random sampling, then let every trajectory choose.

    1. Trajectories become points of R^5: rows of the 5 leading right singular vectors of the matrix in
       pixels, not scaled.
    2. K times: the 4-dimensional subspace through 4 random points with most inliers (squared distance under
       the threshold) among the points not yet taken; samples until one free of outliers was drawn with the
       wanted confidence. Its inliers are taken.
    3. Each group's best subspace is refitted, and every point joins the nearest one.

    Source: Fischler and Bolles, CACM 1981; for motion Tron and Vidal, "A benchmark for the comparison of
    3-D motion segmentation algorithms", CVPR 2007, section 3.4. Where fewer points are left than a sample
    needs, samples are drawn from all points.
    Input: complete trajectories (gaps are completed), at least 4. The number of motions must be given.
    Outliers: found on the way, but labelled in the end. Cost: O(K T N) for T <= 3000 trials; O(N) memory
    per trial.
    """

    dimension: int = option(5, "dimension of the projection", low=2)
    subspace: int = option(4, "dimension of a motion", low=1)
    threshold: float = option(2e-5, "squared distance of an inlier", low=0)
    confidence: float = option(0.99, "probability of one sample without outliers", low=0, high=0.999999)
    max_trials: int = option(3000, "cap on samples per motion", low=1)

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        """Label the columns of the trajectory matrix."""
        assert n_motions is not None
        points = leading_row_space(data.pixels, self.dimension)
        size = min(self.subspace, points.shape[1] - 1, len(points))
        free, trials, confident = np.arange(len(points)), [], True
        groups: list[IntArray] = []
        for _ in range(n_motions):
            pool = free if len(free) >= size else np.arange(len(points))
            inliers, count = self._one(points[pool], size, rng)
            groups.append(pool[inliers])
            free = np.setdiff1d(free, groups[-1])
            trials.append(count)
            confident &= count >= _trials(len(inliers) / len(pool), size, self.confidence)
        bases = [_leading_basis(points[g], size) for g in groups if len(g)]
        distance = np.stack([_squared_distance(points, basis) for basis in bases])
        return distance.argmin(axis=0) + 1, {
            "trials": trials,
            "left": len(free),
            "converged": bool(confident),
        }

    def _one(self, points: FloatArray, size: int, rng: np.random.Generator) -> tuple[IntArray, int]:
        """Inliers of the best subspace, and how many samples were drawn."""
        best, needed, trials = np.arange(0), float(self.max_trials), 0
        while trials < needed:
            sample = points[rng.integers(len(points), size=(_BATCH, size))]
            bases, values, _ = np.linalg.svd(sample.transpose(0, 2, 1), full_matrices=False)
            proper = values[:, -1] > _DEGENERATE * np.maximum(values[:, 0], _DEGENERATE)
            inside = _squared_distance(points, bases) < self.threshold
            counts = np.where(proper, inside.sum(axis=1), -1)
            top = int(counts.argmax())
            if counts[top] > len(best):
                best = np.flatnonzero(inside[top])
            trials += _BATCH
            needed = min(float(self.max_trials), _trials(len(best) / len(points), size, self.confidence))
        return best, trials


def _squared_distance(points: FloatArray, basis: FloatArray) -> FloatArray:
    """Squared distances (..., N) of points (N, D) to the spans of orthonormal bases (..., D, d)."""
    inside = ((points @ basis) ** 2).sum(axis=-1)
    return np.asarray((points**2).sum(axis=1) - inside)


def _leading_basis(points: FloatArray, size: int) -> FloatArray:
    _, _, right = np.linalg.svd(points, full_matrices=False)
    return np.asarray(right[:size].T)


def _trials(share: float, size: int, confidence: float) -> float:
    clean = share**size
    if clean >= 1:
        return 0.0
    return float("inf") if clean <= 0 else float(np.log(1 - confidence) / np.log1p(-clean))
