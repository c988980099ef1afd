"""Self-expressive methods: every trajectory written as a combination of the others (SSC, S3C, LRR, LRSSC).

Data on a union of independent subspaces have combinations that use only columns of the own subspace.
They are sought by convex programmes, solved by alternating directions; the linear systems are solved
through a thin singular value decomposition of the data, so that an iteration costs ``O(N^2 D)`` for
D x N data rather than ``O(N^3)``.
"""

from collections.abc import Callable
from dataclasses import astuple, dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from kt3dmoseg.options import option
from kt3dmoseg.parallel import algorithm_version
from kt3dmoseg.types import FloatArray
from mseg.clustering.kmeans import kmeans
from mseg.clustering.spectral import count_by_eigengap, spectral_clustering, spectral_embedding, unit_rows
from mseg.completion import shrink
from mseg.errors import SegmentationError
from mseg.geometry.subspaces import leading_row_space
from mseg.iteration import Convergence, iterate
from mseg.kernels import shared
from mseg.methods.complete_data import CompleteData, CompleteDataMethod
from mseg.types import Grouping

# Factor by which a penalty grows from one iteration to the next.
_GROWTH = 1.1
_EPSILON = float(np.finfo(np.float64).eps)
# Smaller singular values of LRR's coefficients are noise.
_RELATIVE_RANK = 1e-4


class Representation(NamedTuple):
    """Coefficients (N, N) float64, column j expressing point j, and how the solver ended."""

    coefficients: FloatArray
    convergence: Convergence


@dataclass(frozen=True)
class SparseMethod(CompleteDataMethod):
    """What SSC, S3C and LRSSC share: options, and labels from sparse coefficients."""

    finds_n_motions: ClassVar[bool] = True

    alpha: float = option(800.0, "weight of the fit, over the smallest coherence", low=0)
    rho: float = option(0.7, "share of a column's l1 norm that is kept", low=0, high=1)
    max_iterations: int = option(400, "cap on ADMM iterations", low=1)
    restarts: int = option(20, "restarts of k-means", low=1)

    def read_out(self, solved: Representation, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        """Largest coefficients, affinity, spectral clustering."""
        affinity = sparse_affinity(solved.coefficients, self.rho)
        count = n_motions or count_by_eigengap(affinity)
        labels = spectral_clustering(affinity, count, rng, n_restarts=self.restarts)
        return labels, {**solved.convergence.report(), "n_motions": count}


@dataclass(frozen=True)
class SSC(SparseMethod):
    """Express every trajectory by few others; those it uses move with it.

    1. ``min |C|_1 + mu/2 |X - X C|_F^2`` with zero diagonal and columns that sum to one, X in normalised
       coordinates, ``mu = alpha / min_j max_{i != j} |x_i . x_j|``, by ADMM.
    2. Of each column the largest coefficients that make up a share rho of its l1 norm are kept, the
       column is scaled to a maximum of one, and ``W = |C| + |C|^T``.
    3. Spectral clustering.

    Source: Elhamifar and Vidal, "Sparse subspace clustering: algorithm, theory and applications", TPAMI
    2013, equation 13, algorithm 2 and section 7.1; alpha = 800, affine, rho = 0.7, no projection are the
    published choices for motion ("2F-dimensional data").
    Input: complete trajectories (gaps are completed). Number of motions: given, or the relative eigengap of
    W's normalised Laplacian. Outliers: not handled. Cost: O(N^2 F) per iteration, 100-200 iterations, O(N^3)
    for the spectral step; O(N^2) memory.
    """

    tolerance: float = option(2e-4, "largest residual of the constraints at convergence", low=0)

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        caps: dict[str, Any] = {"tolerance": self.tolerance, "max_iterations": self.max_iterations}
        solved = shared_representation(sparse_representation, data.normalised, alpha=self.alpha, **caps)
        return self.read_out(solved, n_motions, rng)


@dataclass(frozen=True)
class S3C(SparseMethod):
    """Alternate sparse representation and segmentation, each guiding the other.

    The first pass is SSC. Pass t then weighs the absolute coefficients by

        w_ij = 1 / nu_t + nu_t gamma (1 - Theta_ij),   nu_t = growth^(t - 1),

    Theta_ij = 1 where the last segmentation puts i and j together (all ones at first), starts ADMM from the
    last coefficients, and segments again; until the segmentation repeats itself.

    Source: Li and Vidal, "Structured sparse subspace clustering: a unified optimization framework", CVPR
    2015, equations 6-11 and algorithm 2 (hard version); gamma = 0.1, nu = 1, growth 1.2 and at most 10 passes
    are those of the authors' code. Their motion settings of the SSC part are not published; those of SSC are
    used.
    Input: complete trajectories (gaps are completed). Number of motions: given, or the relative eigengap
    after the first pass. Outliers: not handled. Cost: that of SSC times the number of passes, usually 2.
    """

    gamma: float = option(0.1, "weight of coefficients across groups", low=0)
    growth: float = option(1.2, "factor by which structure gains weight each pass", low=1)
    max_passes: int = option(10, "cap on passes", low=1)
    tolerance: float = option(2e-4, "largest residual of the constraints at convergence of a pass", low=0)

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        caps: dict[str, Any] = {"tolerance": self.tolerance, "max_iterations": self.max_iterations}
        solved = shared_representation(sparse_representation, data.normalised, alpha=self.alpha, **caps)
        labels, report = self.read_out(solved, n_motions, rng)
        passes, stable, nu = 1, False, 1.0
        while passes < self.max_passes and not stable:
            nu *= self.growth
            solved = sparse_representation(
                data.normalised,
                alpha=self.alpha,
                weights=1 / nu + nu * self.gamma * (labels[:, None] != labels).astype(np.float64),
                start=solved.coefficients,
                **caps,
            )
            before = labels
            labels, report = self.read_out(solved, report["n_motions"], rng)
            stable = np.array_equal(labels[:, None] == labels, before[:, None] == before)
            passes += 1
        return labels, report | {"passes": passes, "converged": stable and report["converged"]}


@dataclass(frozen=True)
class LRR(CompleteDataMethod):
    """Express all trajectories by each other with coefficients of lowest rank.

    1. ``min |Z|_* + lambda |E|_{2,1}`` subject to ``X = X Z + E``, X in normalised coordinates with a row of
       ones, by the inexact augmented Lagrangian in the row space of X.
    2. ``Z = U S V^T``; affinity of the rows of ``U sqrt(S)`` at unit length: inner product to the 4th power.
    3. Spectral embedding by the generalised problem ``(D - W) v = t D v`` (Shi and Malik), k-means on its
       rows as they are.

    Source: Liu, Lin, Yan, Sun, Yu, Ma, "Robust recovery of subspace structures by low-rank representation",
    TPAMI 2013, equation 7, algorithms 1 and 2; lambda = 4, the row of ones and the exponent are those of the
    authors' motion script.
    Input: complete trajectories (gaps are completed). Number of motions: given, or the relative eigengap of
    the affinity's normalised Laplacian. Outliers: bad trajectories are absorbed by E, but labelled.
    Cost: some 400 iterations of O(N F^2), then O(N^3); O(N^2) memory.
    """

    finds_n_motions: ClassVar[bool] = True

    weight: float = option(4.0, "weight lambda of the errors", low=0)
    power: int = option(4, "exponent of the affinity", low=1)
    tolerance: float = option(1e-8, "largest residual of the constraints at convergence", low=0)
    max_iterations: int = option(1000, "cap on iterations", low=1)
    restarts: int = option(20, "restarts of k-means", low=1)

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        solved = shared_representation(
            low_rank_representation,
            data.homogeneous,
            weight=self.weight,
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
        )
        affinity = low_rank_affinity(solved.coefficients, data.homogeneous, self.power)
        count = n_motions or count_by_eigengap(affinity)
        # Eigenvectors of the random walk: von Luxburg, "A tutorial on spectral clustering", proposition 3.
        degree = affinity.sum(axis=1, keepdims=True)
        embedding = spectral_embedding(affinity, count) / np.sqrt(np.where(degree > 0, degree, 1))
        labels = kmeans(embedding, count, rng, n_restarts=self.restarts).labels
        return labels + 1, {**solved.convergence.report(), "n_motions": count}


@dataclass(frozen=True)
class LRSSC(SparseMethod):
    """Express trajectories by each other with coefficients that are low-rank and sparse.

    Variant "joint" (Wang, Xu, Leng): ``min |C|_* + lambda |C|_1 + mu/2 |X - X C|_F^2`` with zero diagonal,
    X in normalised coordinates with a row of ones. Variant "cascade", another method that goes by the same
    name in comparisons: the coefficients Z of LRR (without the row of ones) become the data of SSC.
    Both end as SSC does: largest coefficients, affinity, spectral clustering.

    Source: Wang, Xu, Leng, "Provable subspace clustering: when LRR meets SSC", NIPS 2013, equation 2. They
    publish no setting for trajectories; lambda was set on the public sequences, mu is that of SSC.
    Input: complete trajectories (gaps are completed). Number of motions: given, or the relative eigengap of
    the affinity's normalised Laplacian. Outliers: not handled. Cost: about 100 iterations of O(N^3); O(N^2)
    memory.
    """

    variant: Literal["joint", "cascade"] = option("joint", "one programme, or LRR followed by SSC")
    sparsity: float = option(0.1, "weight lambda of the l1 norm (joint)", low=0)
    weight: float = option(4.0, "weight of LRR's errors (cascade)", low=0)

    def group(self, data: CompleteData, n_motions: int | None, rng: np.random.Generator) -> Grouping:
        low_rank_report: dict[str, Any] = {}
        cap = self.max_iterations
        if self.variant == "joint":
            given = {"sparsity": self.sparsity, "alpha": self.alpha, "max_iterations": cap}
            solved = shared_representation(low_rank_sparse_representation, data.homogeneous, **given)
        else:
            low_rank = low_rank_representation(data.normalised, weight=self.weight)
            low_rank_report = low_rank.convergence.report("low_rank_")
            solved = sparse_representation(low_rank.coefficients, alpha=self.alpha, max_iterations=cap)
        labels, report = self.read_out(solved, n_motions, rng)
        return labels, low_rank_report | report


def shared_representation(
    solve: Callable[..., Representation],
    data: FloatArray,
    **options: Any,  # noqa: ANN401  # of `solve`
) -> Representation:
    """Solve a programme that draws nothing, once in a `kernel_cache` for all seeds and numbers of motions."""

    def make() -> dict[str, npt.NDArray[Any]]:
        solved = solve(data, **options)
        return {
            "coefficients": solved.coefficients,
            "convergence": np.array(astuple(solved.convergence), dtype=np.float64),
        }

    version = algorithm_version(Representation)
    depends_on = {"programme": solve.__name__, "version": version, "data": data, "options": options}
    found = shared(depends_on, make)
    converged, iterations, residual = found["convergence"].tolist()
    return Representation(found["coefficients"], Convergence(bool(converged), int(iterations), residual))


def sparse_representation(
    data: FloatArray,
    *,
    alpha: float = 800.0,
    weights: FloatArray | float = 1.0,
    start: FloatArray | None = None,
    tolerance: float = 2e-4,
    max_iterations: int = 200,
) -> Representation:
    """Minimise ``sum_ij w_ij |C_ij| + mu/2 |X - X C|_F^2``, diag C = 0, of data X (D, N) by ADMM.

    Columns of C sum to one. ``mu = alpha / min_j max_{i != j} |x_i . x_j|``; alpha is also the
    penalty of the splitting. A point orthogonal to all others is a `SegmentationError`.
    """
    # Elhamifar and Vidal, TPAMI 2013, equation 13 and algorithm 2.
    n = data.shape[1]
    fit = alpha / _smallest_coherence(data)
    system = _ShiftedInverse(np.vstack([np.sqrt(fit) * data, np.full((1, n), np.sqrt(alpha))]))
    target = fit * (data.T @ data)
    threshold = np.asarray(weights) / alpha
    c = np.zeros((n, n)) if start is None else start.copy()
    # Scaled multipliers: of the splitting Z = C, and of the columns' sums.
    u, v = np.zeros((n, n)), np.zeros(n)

    def step() -> float:
        nonlocal c, u, v
        z = system.solve(target + alpha * (c - u) + alpha * (1 - v), alpha)
        # The published code clears the diagonal here as well as in C; its results depend on it.
        np.fill_diagonal(z, 0)
        c = shrink(z + u, threshold)
        np.fill_diagonal(c, 0)
        gap = z - c
        u += gap
        excess = z.sum(axis=0) - 1
        v += excess
        return max(float(np.abs(gap).max()), float(np.abs(excess).max()))

    convergence = iterate(step, tolerance=tolerance, max_iterations=max_iterations)
    return Representation(c, convergence)


def low_rank_representation(
    data: FloatArray, *, weight: float = 4.0, tolerance: float = 1e-8, max_iterations: int = 1000
) -> Representation:
    """Minimise ``|Z|_* + weight |E|_{2,1}`` subject to ``X = X Z + E``, by the inexact augmented Lagrangian.

    Z lies in the row space of the data X (D, N), ``Z = Q W`` with orthonormal Q: W (rank X, N) is sought.
    """
    # Liu, Lin, Yan, Sun, Yu, Ma, TPAMI 2013, equation 7, algorithm 1 and section 4.2 (row space).
    _, values, right = np.linalg.svd(data, full_matrices=False)
    rank = int((values > max(data.shape) * _EPSILON * values[0]).sum())
    basis = np.ascontiguousarray(right[:rank].T)
    dictionary = data @ basis
    inverse = np.linalg.inv(dictionary.T @ dictionary + np.eye(rank))
    w, error = np.zeros((rank, data.shape[1])), np.zeros_like(data)
    y_fit, y_split = np.zeros_like(data), np.zeros_like(w)
    penalty = 1e-6

    def step() -> float:
        nonlocal w, error, y_fit, y_split, penalty
        low = _shrink_leading(w + y_split / penalty, 1 / penalty)
        w = inverse @ (dictionary.T @ (data - error + y_fit / penalty) + low - y_split / penalty)
        left = data - dictionary @ w
        error = left + y_fit / penalty  # its columns are shortened: the proximal map of the l2,1 norm
        length = np.linalg.norm(error, axis=0)
        error *= np.maximum(length - weight / penalty, 0) / np.where(length > 0, length, 1)
        fit_gap, split_gap = left - error, w - low
        y_fit += penalty * fit_gap
        y_split += penalty * split_gap
        penalty = min(penalty * _GROWTH, 1e10)
        return max(float(np.abs(fit_gap).max()), float(np.abs(split_gap).max()))

    convergence = iterate(step, tolerance=tolerance, max_iterations=max_iterations)
    return Representation(basis @ w, convergence)


def low_rank_sparse_representation(
    data: FloatArray, *, sparsity: float = 0.1, alpha: float = 800.0, max_iterations: int = 400
) -> Representation:
    """Minimise ``|C|_* + sparsity |C|_1 + mu/2 |X - X C|_F^2``, diag C = 0, of data X (D, N) by ADMM.

    C is split into three copies (of the fit, of the nuclear norm, of the l1 norm with zero diagonal); the
    last is returned. mu and errors are those of `sparse_representation`.
    """
    # Wang, Xu, Leng, NIPS 2013, equation 2 (relaxed for noise as in their section 6).
    n = data.shape[1]
    fit = alpha / _smallest_coherence(data)
    system = _ShiftedInverse(np.sqrt(fit) * data)
    target = fit * (data.T @ data)
    low, sparse = np.zeros((n, n)), np.zeros((n, n))
    y_low, y_sparse = np.zeros((n, n)), np.zeros((n, n))
    penalty = 1.0

    def step() -> float:
        nonlocal low, sparse, y_low, y_sparse, penalty
        c = system.solve(target + penalty * (low + sparse) - y_low - y_sparse, 2 * penalty)
        low = _shrink_leading(c + y_low / penalty, 1 / penalty)
        sparse = shrink(c + y_sparse / penalty, sparsity / penalty)
        np.fill_diagonal(sparse, 0)
        y_low += penalty * (c - low)
        y_sparse += penalty * (c - sparse)
        penalty *= _GROWTH
        return max(float(np.abs(c - low).max()), float(np.abs(c - sparse).max()))

    convergence = iterate(step, tolerance=2e-4, max_iterations=max_iterations)
    return Representation(sparse, convergence)


def keep_largest(coefficients: FloatArray, share: float) -> FloatArray:
    """Keep of each column (N, N) its largest magnitudes, as many as reach a share of their sum."""
    # Elhamifar and Vidal, TPAMI 2013, section 7.1 (the step called thrC in their code).
    if share >= 1:
        return coefficients
    magnitude = np.abs(coefficients)
    order = np.argsort(-magnitude, axis=0, kind="stable")
    ordered = np.take_along_axis(magnitude, order, axis=0)
    before = ordered.cumsum(axis=0) - ordered
    kept = np.zeros(coefficients.shape, dtype=bool)
    np.put_along_axis(kept, order, before < share * magnitude.sum(axis=0), axis=0)
    return np.where(kept, coefficients, 0.0)


def sparse_affinity(coefficients: FloatArray, share: float = 0.7) -> FloatArray:
    """Affinity (N, N) in [0, 2]: `keep_largest`, columns scaled to a maximum of one, ``|C| + |C|^T``."""
    magnitude = np.abs(keep_largest(coefficients, share))
    scaled = magnitude / (magnitude.max(axis=0) + _EPSILON)
    return np.asarray(scaled + scaled.T)


def low_rank_affinity(coefficients: FloatArray, data: FloatArray, power: int = 4) -> FloatArray:
    """Step 2 of `LRR`; the columns of the coefficients lie in the row space of the data (D, N)."""
    basis = leading_row_space(data, len(data))
    left, values, _ = np.linalg.svd(basis.T @ coefficients, full_matrices=False)
    kept = values > _RELATIVE_RANK * values[0]
    rows = unit_rows(basis @ left[:, kept] * np.sqrt(values[kept]))
    return np.asarray(np.minimum(np.abs(rows @ rows.T), 1) ** power)


def _smallest_coherence(data: FloatArray) -> float:
    """``min_j max_{i != j} |x_i . x_j|``: the smallest l1 weight for which no column of C vanishes."""
    gram = np.abs(data.T @ data)
    np.fill_diagonal(gram, 0)
    smallest = float(gram.max(axis=0).min())
    if smallest <= np.finfo(np.float64).tiny:
        raise SegmentationError(
            "trajectories", expected="each one correlated with another", found="one orthogonal to all others"
        )
    return smallest


def _shrink_leading(matrix: FloatArray, threshold: float) -> FloatArray:
    """Soft threshold of the singular values of a matrix (D, N), D <= N, through ``M M^T``.

    Squaring costs half of the digits of values near zero, but those fall below the threshold of an iteration
    that has not converged.
    """
    # All eigenvectors: LAPACK's solver for some of them takes three times as long.
    squares, left = np.linalg.eigh(matrix @ matrix.T)
    kept = squares > threshold**2
    left = left[:, kept]
    gain = 1 - threshold / np.sqrt(squares[kept])
    return np.asarray((left * gain) @ (left.T @ matrix))


class _ShiftedInverse:
    """Solve systems with ``B^T B + shift I`` through the row space of B (Woodbury)."""

    def __init__(self, rows: FloatArray) -> None:
        _, values, right = np.linalg.svd(rows, full_matrices=False)
        kept = values > values[0] * _EPSILON * max(rows.shape)
        self.basis = np.ascontiguousarray(right[kept].T)
        self.squares = values[kept, None] ** 2

    def solve(self, right: FloatArray, shift: float) -> FloatArray:
        gain = self.squares / (self.squares + shift)
        return np.asarray((right - self.basis @ (gain * (self.basis.T @ right))) / shift)
