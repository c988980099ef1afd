"""T-Linkage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import FloatArray, IntArray
from mseg.clustering.flat_code import code_length, reassign_by_code
from mseg.clustering.linkage import tanimoto_linkage
from mseg.clustering.preference import preference_matrix
from mseg.geometry.subspaces import flat_distances, project
from mseg.iteration import Convergence
from mseg.kernels import draw_near_subsets
from mseg.methods.complete_data import CompleteData, CompleteDataMethod

FLAT_DIMENSION = 3
_SAMPLE = FLAT_DIMENSION + 1
_REDUCTION, _MOST_REDUCTIONS = 0.75, 20
_SCALES = tuple(2 ** (k / 2) for k in range(-6, 3))
_SWEEPS = 3


@dataclass(frozen=True)
class TLinkage(CompleteDataMethod):
    """Random flats through trajectories; those who prefer the same flats are linked.

    1. Trajectories become points of R^5: centred, the leading principal components, divided by sqrt(F), so
       that distances are root mean square pixels per frame.
    2. 6 N flats of dimension three through four neighbours each.
    3. Preferences ``exp(-5 r / epsilon)`` of residuals r < epsilon, else 0.
    4. The two clusters of least Tanimoto distance merge, preferences by minimum, until all are orthogonal.
    5. With a given number K of motions: the K largest clusters stay, and every trajectory joins the one that
       describes it best, up to three times (`mseg.clustering.flat_code`, ours). While step 4 gives fewer than
       K clusters, epsilon is lowered by a quarter (ours). Without K: the clusters as they are.
    6. If wanted, small clusters are outliers: sizes are sorted, with the size of a sample among them, and
       those after the largest drop are labelled 0, unless that leaves a single cluster; then those after
       the next largest drop.

    With `choose_epsilon` and K given, steps 3 to 5 are done for nine epsilons from an eighth of the given one
    to twice it, and the segmentation with the shortest code stays: no labels are needed (ours).

    Source: Magri and Fusiello, "T-Linkage: a continuous relaxation of J-Linkage for multi-model fitting",
    CVPR 2014. Projection, numbers of samples and epsilon are not in that paper's account of its motion
    experiments, nor is step 5. An epsilon chosen for every sequence with the help of its labels is a
    protocol of its own (`tools/best_threshold.py`).
    Input: complete trajectories (gaps are completed). Number of motions: given or found. Outliers: labelled
    0 on request. Cost: O(N^2 M) per epsilon for M = 6 N flats; O(N M) memory.
    """

    finds_n_motions: ClassVar[bool] = True

    epsilon: float = option(2.0, "inlier threshold, root mean square pixels per frame", low=1e-9)
    dimension: int = option(5, "dimension of the projection", low=1)
    samples: int = option(6, "flats per trajectory", low=1)
    choose_epsilon: bool = option(True, "choose epsilon by code length, where the number of motions is known")
    reject_outliers: bool = option(False, "label clusters that are small by step 6 as outliers")

    def group(
        self, data: CompleteData, n_motions: int | None, rng: np.random.Generator
    ) -> tuple[IntArray, dict[str, Any]]:
        """Label the columns of the trajectory matrix."""
        points = rms_coordinates(data.pixels, self.dimension)
        subsets = draw_near_subsets(points, self.samples * len(points), min(_SAMPLE, len(points)), rng)
        residuals = flat_distances(points, subsets)
        several = self.choose_epsilon and n_motions is not None
        found = [
            self._segmented(points, residuals, self.epsilon * scale, n_motions)
            for scale in (_SCALES if several else (1.0,))
        ]
        # Points without a group cost no code: the fewest of them first.
        labels, clusters, epsilon, reassigned = min(
            found, key=lambda one: ((one[0] == 0).sum(), code_length(points, one[0], FLAT_DIMENSION))
        )
        sizes = np.bincount(clusters)[1:]
        if self.reject_outliers:
            labels = np.where(clusters > count_large(sizes), 0, labels)
        report = {"clusters": len(sizes), "sizes": sizes[:10].tolist(), "epsilon": epsilon}
        return labels, {**report, **reassigned.report("reassignment_")}

    def _segmented(
        self, points: FloatArray, residuals: FloatArray, epsilon: float, n_motions: int | None
    ) -> tuple[IntArray, IntArray, float, Convergence]:
        """Labels, the clusters behind them, the epsilon that gave these, and how reassignment ended."""
        for _ in range(_MOST_REDUCTIONS):
            clusters = tanimoto_linkage(preference_matrix(residuals, epsilon))
            if clusters.max() >= (n_motions or 1):
                break
            epsilon *= _REDUCTION
        if n_motions is None:
            return clusters, clusters, epsilon, Convergence(True, 0, 0.0)
        kept = np.where(clusters <= n_motions, clusters, 0)
        labels, reassigned = reassign_by_code(points, kept, FLAT_DIMENSION, _SWEEPS)
        return labels, clusters, epsilon, reassigned


def rms_coordinates(pixels: FloatArray, dimension: int) -> FloatArray:
    """Centred principal components (N, dimension) of (2F, N), in root mean square pixels per frame."""
    centred = pixels - pixels.mean(axis=1, keepdims=True)
    return np.asarray(project(centred, dimension).T / np.sqrt(len(pixels) / 2))


def count_large(sizes: IntArray) -> int:
    """Count the clusters before the largest drop of sizes (descending), that of a sample included."""
    ordered = np.sort(np.append(sizes, _SAMPLE))[::-1]
    drops = ordered[:-1] - ordered[1:]
    largest = np.argsort(-drops, kind="stable") + 1
    return int(largest[1] if largest[0] == 1 and len(largest) > 1 else largest[0])
