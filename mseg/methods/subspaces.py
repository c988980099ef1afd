"""The subspace methods LSA, GPCA, RANSAC and RSIM: trajectories are points in the row space of their matrix.

The first three are those of the Hopkins155 benchmark (Tron and Vidal, "A benchmark for the comparison of 3-D
motion segmentation algorithms", CVPR 2007).
"""

from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import ClassVar

import numpy as np
from scipy.linalg import eigh, eigvalsh

from kt3dmoseg.options import option
from kt3dmoseg.types import FloatArray, IntArray
from mseg.clustering.spectral import relative_eigengaps, spectral_clustering, unit_rows
from mseg.errors import TooFewPointsError
from mseg.geometry.subspaces import leading_row_space
from mseg.iteration import Convergence, iterate
from mseg.methods.complete_data import CompleteData, CompleteDataMethod
from mseg.types import Grouping

_LARGEST_BASIS = 4
# Samples of RANSAC drawn together; relative size of a singular value that counts as zero.
_BATCH, _DEGENERATE = 100, 1e-10
# Of RSIM: affinities that count as zero, most motions, offset of the degrees; caps of the discretisation.
_NEGLIGIBLE, _LARGEST_COUNT, _OFFSET = 1e-6, 6, 0.5
_MAX_ROUNDS, _NO_GAIN = 50, 1e-15


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
        assert n_motions is not None
        if data.n_points <= self.n_neighbours:
            raise TooFewPointsError(
                "LSA", expected=f"more than {self.n_neighbours} trajectories", found=str(data.n_points)
            )
        points = unit_rows(leading_row_space(data.pixels, self.dimension or 4 * n_motions))
        n, r = points.shape
        size = max(1, min(_LARGEST_BASIS, r - 1))
        cosine = points @ points.T
        np.fill_diagonal(cosine, np.inf)  # the point itself always belongs to its neighbourhood
        nearest = np.argsort(-cosine, axis=1, kind="stable")[:, : self.n_neighbours + 1]
        left, _, _ = np.linalg.svd(points[nearest].transpose(0, 2, 1), full_matrices=False)
        basis = left[:, :, :size]
        projector = (basis @ basis.transpose(0, 2, 1)).reshape(n, r * r)
        affinity = np.exp(-np.maximum(size - projector @ projector.T, 0))
        labels = spectral_clustering(affinity, n_motions, rng, n_restarts=self.restarts)
        return labels, {"dimension": r}


@dataclass(frozen=True)
class GPCA(CompleteDataMethod):
    """Fit one polynomial that vanishes on all motions; its gradients distinguish them.

    1. Trajectories become unit points of R^5: rows of the 5 leading right singular vectors of the
       matrix in pixels. A motion fills at most a hyperplane there.
    2. The degree-K polynomial p that vanishes on K hyperplanes is the null vector of the points'
       degree-K monomials (Veronese map): the right singular vector of the smallest singular value.
    3. The gradient of p at a point is the normal of that point's hyperplane. Affinity: squared cosine of
       the normals.
    4. Spectral clustering.

    Source: Vidal, Ma, Sastry, "Generalized principal component analysis (GPCA)", TPAMI 2005, equations
    12-20; Vidal, Tron, Hartley, "Multiframe motion segmentation with missing data using PowerFactorization
    and GPCA", IJCV 2008; in the form of the Hopkins155 benchmark (Tron and Vidal, CVPR 2007).
    Input: complete trajectories (gaps are completed), at least C(K + 4, 4) of them (15, 35, 70, 126 for K =
    2, 3, 4, 5); the number of motions must be given. Outliers: not handled. Cost: O(N M^2 + N^3) with M
    monomials; O(N^2) memory. Known weakness: for three and more motions the polynomial is too sensitive.
    """

    dimension: int = option(5, "dimension of the projection", low=2)
    restarts: int = option(10, "restarts of k-means", low=1)

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        assert n_motions is not None
        points = unit_rows(leading_row_space(data.pixels, self.dimension))
        powers = exponents(n_motions, points.shape[1])
        if len(points) < len(powers):
            raise TooFewPointsError(
                f"GPCA with {n_motions} motions",
                expected=f"at least {len(powers)} trajectories",
                found=str(len(points)),
            )
        normals = unit_rows(gradients(points, powers, vanishing_polynomial(points, powers)))
        labels = spectral_clustering((normals @ normals.T) ** 2, n_motions, rng, n_restarts=self.restarts)
        return labels, {"monomials": len(powers)}


def exponents(degree: int, dimension: int) -> IntArray:
    """Exponents (M, dimension) of all monomials of a degree, in lexicographic order."""
    factors = list(combinations_with_replacement(range(dimension), degree))
    rows = np.repeat(np.arange(len(factors)), degree)
    table = np.zeros((len(factors), dimension), dtype=np.int64)
    np.add.at(table, (rows, np.ravel(factors)), 1)
    return table


def vanishing_polynomial(points: FloatArray, powers: IntArray) -> FloatArray:
    """Coefficients (M,) of the unit polynomial of least squared values at the points (N, D)."""
    _, _, right = np.linalg.svd(_monomials(points, powers), full_matrices=True)
    return np.asarray(right[len(powers) - 1])


def gradients(points: FloatArray, powers: IntArray, coefficients: FloatArray) -> FloatArray:
    """Gradients (N, D) of a polynomial at the points (N, D)."""
    out = np.empty_like(points)
    for axis in range(points.shape[1]):
        lowered = powers.copy()
        lowered[:, axis] = np.maximum(lowered[:, axis] - 1, 0)
        out[:, axis] = _monomials(points, lowered) @ (coefficients * powers[:, axis])
    return out


def _monomials(points: FloatArray, powers: IntArray) -> FloatArray:
    return np.asarray(np.prod(points[:, None, :] ** powers, axis=2))


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
        bases = [np.linalg.svd(points[g], full_matrices=False)[2][:size].T for g in groups if len(g)]
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


def _trials(share: float, size: int, confidence: float) -> float:
    clean = share**size
    if clean >= 1:
        return 0.0
    return float("inf") if clean <= 0 else float(np.log(1 - confidence) / np.log1p(-clean))


@dataclass(frozen=True)
class RSIM(CompleteDataMethod):
    """Shape interaction matrix, row-normalised, raised to a power, at the rank that cuts best.

    For every rank r = K..4K: rows of the r leading right singular vectors of X (normalised coordinates with
    ones) at unit length, ``Z = V V^T``, affinity ``W = max(Z, 0)^power``, normalised cuts into K groups. The
    rank wins whose segmentation has the least

        score_r = sum_k cut(group k, rest) / (lambda_K - lambda_{K+1}),

    lambda the eigenvalues of ``D^-1 W``, largest first.

    Source: Ji, Salzmann, Li, "Shape interaction matrix revisited and robustified", ICCV 2015, algorithm 1
    and equation 12; power 3.5 and the ranks are those of the authors' code. Normalised cuts: Yu and Shi,
    "Multiclass spectral clustering", ICCV 2003, with the offset of "Understanding popout through repulsion",
    CVPR 2001. Deviation: the authors' discretisation starts from one random row, so that single sequences
    flip with the seed; here the best of several starts counts.
    Input: complete trajectories (gaps are completed; the authors use GROUSE there). Number of motions:
    given, or by relative eigengaps averaged over the ranks (ours). Outliers:
    not handled. Cost: O(K N^3); O(N^2) memory.
    """

    finds_n_motions: ClassVar[bool] = True

    power: float = option(3.5, "exponent of the affinity", low=1)
    starts: int = option(10, "starts of the discretisation", low=1)

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        # The row space of all homogeneous positions: a row of ones for each frame, as one.
        ones = np.full(data.n_points, np.sqrt(data.normalised.shape[0] // 2))
        matrix = np.vstack([data.normalised, ones])
        k = n_motions or self._count(matrix)
        space = leading_row_space(matrix, 4 * k)
        ranks = range(min(k, space.shape[1]), space.shape[1] + 1)
        found, scores = [], []
        for rank in ranks:
            affinity = self._affinity(space[:, :rank])
            found.append(_discretise(_ncut_embedding(affinity, k), rng, self.starts))
            scores.append(_cut_over_gap(affinity, found[-1][0], k))
        best = int(np.argmin(scores))
        labels, _, convergence = found[best]
        report = {"rank": ranks[best], "score": scores[best], "n_motions": k}
        return labels + 1, report | convergence.report()

    def _affinity(self, space: FloatArray) -> FloatArray:
        """Affinity (N, N) of the rows of an orthonormal basis (N, r)."""
        rows = unit_rows(space)
        affinity = np.maximum(rows @ rows.T, 0) ** self.power
        return np.where(affinity < _NEGLIGIBLE, 0.0, affinity)

    def _count(self, matrix: FloatArray) -> int:
        """Find the k whose relative eigengap, averaged over the ranks k..4k, is widest."""
        space = leading_row_space(matrix, 4 * _LARGEST_COUNT)
        ranks = range(1, space.shape[1] + 1)
        gaps = [relative_eigengaps(self._affinity(space[:, :r]), _LARGEST_COUNT) for r in ranks]
        counts = range(2, len(gaps[0]) + 1)
        widest = [np.mean([g[k - 1] for g in gaps[k - 1 : 4 * k]] or 0) for k in counts]
        return int(np.argmax(widest)) + 2 if widest else 1


def _cut_over_gap(affinity: FloatArray, labels: IntArray, n_clusters: int) -> float:
    n, degree = len(labels), affinity.sum(axis=1)
    cut = float(affinity[labels[:, None] != labels].sum())
    if n_clusters >= n:
        return cut
    scale = 1 / np.sqrt(np.where(degree > 0, degree, 1))
    walk = affinity * scale[:, None] * scale
    values = eigvalsh(walk, subset_by_index=(n - n_clusters - 1, n - 1), check_finite=False)
    gap = float(values[1] - values[0])
    return cut / gap if gap > 0 else np.inf


def _ncut_embedding(affinity: FloatArray, n_clusters: int) -> FloatArray:
    """Leading eigenvectors (N, K) of ``W + o I`` with degrees ``D + 2 o I``, each of norm ``sqrt(N)``.

    The offset o keeps points without neighbours finite.
    """
    n = len(affinity)
    scale = 1 / np.sqrt(affinity.sum(axis=1) + 2 * _OFFSET + np.finfo(np.float64).eps)
    weights = affinity * scale[:, None] * scale
    weights.flat[:: n + 1] += _OFFSET * scale**2
    _, vectors = eigh(weights, subset_by_index=(n - n_clusters, n - 1), check_finite=False)
    walk = vectors[:, ::-1] * scale[:, None]
    return np.asarray(walk / np.linalg.norm(walk, axis=0) * np.sqrt(n))


def _discretise(
    embedding: FloatArray, rng: np.random.Generator, n_starts: int = 10
) -> tuple[IntArray, float, Convergence]:
    """Rotate an embedding (N, K) to the nearest indicator of a partition; of several starts the nearest wins.

    The first axis of a start is a random row, each further axis the row least aligned with those before.
    Returns clusters 0..K-1, how near they are, and the convergence of that.
    """
    rows = unit_rows(embedding)
    best = None
    for first in rng.integers(len(rows), size=n_starts).tolist():
        axes, aligned = [rows[first]], np.zeros(len(rows))
        for _ in range(rows.shape[1] - 1):
            aligned += np.abs(rows @ axes[-1])
            axes.append(rows[aligned.argmin()])
        found = _rotate(rows, np.stack(axes, axis=1))
        if best is None or found[1] > best[1] * (1 + 1e-12):
            best = found
    assert best is not None
    return best


def _rotate(rows: FloatArray, rotation: FloatArray) -> tuple[IntArray, float, Convergence]:
    """Alternate assignment to the largest coordinate and rotation (orthogonal Procrustes)."""
    k, alignment = rows.shape[1], -np.inf
    labels = np.zeros(len(rows), dtype=np.int64)

    def turn() -> float:
        nonlocal labels, alignment, rotation
        labels = (rows @ rotation).argmax(axis=1)
        totals = np.stack([np.bincount(labels, weights=column, minlength=k) for column in rows.T], axis=1)
        left, values, right = np.linalg.svd(totals)
        reached = float(values.sum())
        gain = (reached - alignment) / reached if reached > 0 else 0.0
        if gain > _NO_GAIN:
            alignment, rotation = reached, right.T @ left.T
        return max(gain, 0.0)

    convergence = iterate(turn, tolerance=_NO_GAIN, max_iterations=_MAX_ROUNDS)
    return labels, alignment, convergence
