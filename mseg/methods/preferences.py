"""Preference analysis: random flats through trajectories, and who prefers the same (T-Linkage, RPA)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kt3dmoseg.compiled import compiled
from kt3dmoseg.options import option
from kt3dmoseg.types import BoolArray, FloatArray, IntArray
from mseg.clustering.kmeans import kmeans
from mseg.completion import robust_pca
from mseg.geometry.subspaces import best_flat_distances, flat_distances, project
from mseg.iteration import Convergence, iterate
from mseg.kernels import draw_near_subsets
from mseg.methods.complete_data import CompleteData, CompleteDataMethod, by_size
from mseg.types import Grouping

_FLAT = 3
_SAMPLE = _FLAT + 1
_REDUCTION, _MOST_REDUCTIONS = 0.75, 20
_SCALES = tuple(2 ** (k / 2) for k in range(-6, 3))
_SWEEPS = 3
_ORTHOGONAL = 1 - 1e-9
# Pixels: a smaller spread counts as none.
_PRECISION = 0.1
# Of RPA: start of the other memberships, since multiplicative updates cannot leave zero; sigmas of an inlier.
_OTHER_CLUSTERS, _INLIER = 0.2, 5.0


@dataclass(frozen=True)
class TLinkage(CompleteDataMethod):
    """Random flats through trajectories; those who prefer the same flats are linked.

    1. Trajectories become points of R^5: centred, the leading principal components, divided by sqrt(F), so
       that distances are root mean square pixels per frame, scaled to an image of 640 x 480 pixels.
    2. 6 N flats of dimension three through four neighbours each.
    3. Preferences ``exp(-5 r / epsilon)`` of residuals r < epsilon, else 0.
    4. The two clusters of least Tanimoto distance merge, preferences by minimum, until all are orthogonal.
    5. With a given number K of motions: the K largest clusters stay, and every trajectory joins the one that
       describes it best, up to three times (ours). A group of n of the N points with principal variances
       ``s_1 >= s_2 >= ...``, to which 0.01 square pixels are added, takes
       ``n (1/2 sum_{i <= 3} log s_i + 1/2 log sum_{i > 3} s_i - log(n / N))`` nats: coordinates along its
       flat, distance from it, name of the group. While step 4 gives fewer than K clusters, epsilon is
       lowered by a quarter (ours). Without K: the clusters as they are.
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

    epsilon: float = option(2.0, "inlier threshold, rms pixels per frame of 640 x 480", low=1e-9)
    dimension: int = option(5, "dimension of the projection", low=_SAMPLE)
    samples: int = option(6, "flats per trajectory", low=1)
    choose_epsilon: bool = option(True, "choose epsilon by code length, where the number of motions is known")
    reject_outliers: bool = option(False, "label clusters that are small by step 6 as outliers")

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        points, residuals = _flat_residuals(data.pixels / data.unit, self.dimension, self.samples, rng)
        several = self.choose_epsilon and n_motions is not None
        found = [
            self._segmented(points, residuals, self.epsilon * scale, n_motions)
            for scale in (_SCALES if several else (1.0,))
        ]
        # Points without a group cost no code: the fewest of them first.
        labels, clusters, epsilon, reassigned = min(
            found, key=lambda one: ((one[0] == 0).sum(), _code_length(points, one[0], _FLAT))
        )
        # Groups too small to receive anyone leave the others without a label.
        labels = np.where(labels == 0, np.bincount(labels)[1:].argmax() + 1, labels)
        sizes = np.bincount(clusters)[1:]
        if self.reject_outliers:
            labels = np.where(clusters > _count_large(sizes), 0, labels)
        report = {"clusters": len(sizes), "sizes": sizes[:10].tolist(), "epsilon": epsilon}
        return labels, {**report, **reassigned.report("reassignment_")}

    def _segmented(
        self, points: FloatArray, residuals: FloatArray, epsilon: float, n_motions: int | None
    ) -> tuple[IntArray, IntArray, float, Convergence]:
        """Labels, the clusters behind them, the epsilon that gave these, and how reassignment ended."""
        for _ in range(_MOST_REDUCTIONS):
            clusters = _linkage(np.where(residuals < epsilon, np.exp(-5.0 * residuals / epsilon), 0.0))
            if clusters.max() >= (n_motions or 1):
                break
            epsilon *= _REDUCTION
        if n_motions is None:
            return clusters, clusters, epsilon, Convergence(True, 0, 0.0)
        kept = np.where(clusters <= n_motions, clusters, 0)
        labels, reassigned = _reassign(points, kept, _FLAT, _SWEEPS)
        return labels, clusters, epsilon, reassigned


def _flat_residuals(
    pixels: FloatArray, dimension: int, samples: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Points (N, D) of trajectories (2F, N), and distances (N, M) to flats: steps 1 and 2."""
    centred = pixels - pixels.mean(axis=1, keepdims=True)
    points = np.asarray(project(centred, dimension).T / np.sqrt(len(pixels) / 2))
    subsets = draw_near_subsets(points, samples * len(points), min(_SAMPLE, len(points)), rng)
    return points, flat_distances(points, subsets)


def tanimoto_distance(preferences: FloatArray) -> FloatArray:
    """Tanimoto distances (N, N) of preference vectors (N, M) in [0, 1].

    ``1 - <p, q> / (|p|^2 + |q|^2 - <p, q>)``; 0 for equal vectors, 1 for orthogonal ones and for any pair
    of which one is zero (Magri and Fusiello, CVPR 2014, equation 4).
    """
    inner = preferences @ preferences.T
    squares = np.diagonal(inner).copy()
    union = squares[:, None] + squares - inner
    alike = np.divide(inner, union, out=np.zeros_like(inner), where=union > 0)
    distance = np.clip(1 - alike, 0, 1)
    np.fill_diagonal(distance, 0)
    return np.asarray(distance)


def _linkage(preferences: FloatArray) -> IntArray:
    """Clusters 1, 2, ... of step 4, the largest first, of preferences (N, M)."""
    n = len(preferences)
    cluster, owner = np.arange(n), np.arange(n)
    squares = np.einsum("nm,nm->n", preferences, preferences)
    distance = tanimoto_distance(preferences)
    np.fill_diagonal(distance, np.inf)
    by_flat = np.ascontiguousarray(preferences.T)
    while n > 1:
        i, j = divmod(int(distance.argmin()), len(distance))
        if not distance[i, j] < _ORTHOGONAL:
            break
        cluster[cluster == owner[j]] = owner[i]
        inner = _merged_products(by_flat, i, j)
        squares[i] = inner[i]
        union = squares + squares[i] - inner
        distance[i] = distance[:, i] = 1 - np.divide(inner, union, out=np.zeros_like(inner), where=union > 0)
        distance[i, i] = distance[j] = distance[:, j] = np.inf
        owner[j] = -1
        alive = owner >= 0
        if 2 * alive.sum() < len(alive):
            by_flat, owner, squares = np.ascontiguousarray(by_flat[:, alive]), owner[alive], squares[alive]
            distance = np.ascontiguousarray(distance[np.ix_(alive, alive)])
    return by_size(cluster)


@compiled
def _merged_products(by_flat: FloatArray, i: int, j: int) -> FloatArray:
    """Merge column j of preferences (M, N) into column i by minimum; products (N,) of it with all columns."""
    flats, n = by_flat.shape
    inner = np.zeros(n)
    for flat in range(flats):
        row = by_flat[flat]
        least = min(row[i], row[j])
        row[i], row[j] = least, 0.0
        if least > 0:
            for k in range(n):
                inner[k] += least * row[k]
    return inner


def _count_large(sizes: IntArray) -> int:
    """Count the clusters before the largest drop of sizes (descending), that of a sample included."""
    ordered = np.sort(np.append(sizes, _SAMPLE))[::-1]
    drops = ordered[:-1] - ordered[1:]
    largest = np.argsort(-drops, kind="stable") + 1
    kept = largest[1] if largest[0] == 1 and len(largest) > 1 else largest[0]
    return max(1, int((sizes >= ordered[kept - 1]).sum()))


def _code_length(points: FloatArray, labels: IntArray, flat: int) -> float:
    """Nats of step 5 of all groups; one too small to leave its flat (n < flat + 2) takes nothing."""
    nats = 0.0
    for k in range(1, int(labels.max(initial=0)) + 1):
        group = points[labels == k]
        n = len(group)
        if n >= flat + 2:
            along, across, _ = _spreads(group, flat)
            nats += n * float((np.log(along).sum() + np.log(across)) / 2 - np.log(n / len(points)))
    return nats


def _reassign(points: FloatArray, labels: IntArray, flat: int, sweeps: int) -> tuple[IntArray, Convergence]:
    """Give every point to the group whose code for it is shortest, again and again until nothing changes.

    Groups of fewer than ``flat + 2`` points receive none; where all are, labels stay as given. The
    convergence is that of the share of points that moved.
    """
    groups = int(labels.max(initial=0))

    def step() -> float:
        nonlocal labels
        length = np.array([_nats(points, labels == k, flat) for k in range(1, groups + 1)])
        if not np.isfinite(length).any():
            return 0.0
        before, labels = labels, length.argmin(axis=0) + 1
        return float((before != labels).mean())

    convergence = iterate(step, tolerance=0.0, max_iterations=sweeps)
    return labels, convergence


def _nats(points: FloatArray, inside: BoolArray, flat: int) -> FloatArray:
    """Nats (N,) of every point in a group."""
    group = points[inside]
    if len(group) < flat + 2:
        return np.full(len(points), np.inf)
    along, across, axes = _spreads(group, flat)
    squares = ((points - group.mean(axis=0)) @ axes) ** 2
    nats = (squares[:, :flat] / along + np.log(along)).sum(axis=1)
    nats += squares[:, flat:].sum(axis=1) / across + np.log(across)
    return np.asarray(nats / 2 - np.log(len(group) / len(points)))


def _spreads(group: FloatArray, flat: int) -> tuple[FloatArray, float, FloatArray]:
    """Variances (flat,) along and across a group's flat, and its axes (D, D) as columns, the widest first."""
    variances, axes = np.linalg.eigh(np.atleast_2d(np.cov(group.T, bias=True)))
    variances = np.maximum(variances[::-1], 0)
    precision = _PRECISION**2
    return variances[:flat] + precision, float(variances[flat:].sum()) + precision, axes[:, ::-1]


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
    dimension: int = option(5, "dimension of the projection", low=_SAMPLE)
    samples: int = option(6, "flats per trajectory", low=1)
    restarts: int = option(20, "restarts of k-means", low=1)
    reject_outliers: bool = option(False, "label trajectories beyond 5 sigma of all motions as outliers")

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        assert n_motions is not None
        points, residuals = _flat_residuals(data.pixels / data.unit, self.dimension, self.samples, rng)
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
        distance = best_flat_distances(points, group, _FLAT)
        near = group[distance[group] < _INLIER * self.sigma]
        return best_flat_distances(points, near, _FLAT) if len(near) > _FLAT else distance


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
