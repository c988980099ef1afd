"""Spectral clustering: graph Laplacians, their smallest eigenvectors, and partitions read from them."""

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh, eigvalsh
from scipy.linalg.lapack import dgeqrf, dorgqr
from scipy.sparse import csr_array, diags_array

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import FloatArray, IntArray
from mseg.clustering.kmeans import kmeans
from mseg.errors import SegmentationError, TooFewPointsError

# A symmetric (N, N) array, or anything with that shape that multiplies vectors (N, b) float64.
Symmetric: TypeAlias = Any
_Array = npt.NDArray[Any]
# Up to this size LAPACK is faster.
_DENSE = 250
# Vectors beyond the requested ones, and the width of a block: eight columns cost BLAS no more than six.
_GUARD = 3
_WIDTH = 8
_EXPANSIONS = 4
_MAX_RESTARTS = 150
_START_SEED = 20180618
# From this share of entries on, a full matrix multiplies faster than a sparse one, up to a size.
_FULL, _LARGEST_FULL = 0.15, 2000
# Keeps eigenvalues that are zero but for rounding from deciding.
EIGENVALUE_FLOOR = 0.01


def normalised_laplacian(affinity: _Array) -> _Array:
    """Compute I - D^-1/2 W D^-1/2, (N, N) of the dtype of the weights W >= 0, D the diagonal of row sums.

    A vertex without any weight gets the row of the identity, so it takes part in no smooth eigenvector.
    Eigenvalues are in 0..2. InvalidValueError when weights are not finite or negative, SegmentationError when
    none is positive.
    """
    # Ng, Jordan, Weiss, "On spectral clustering: analysis and an algorithm", NIPS 2001; von Luxburg, "A
    # tutorial on spectral clustering", 2007, section 3.2.
    _check_weights(affinity)
    degree = affinity.sum(axis=1)
    _check_ties(degree)
    scale = np.zeros_like(degree)
    np.divide(1.0, np.sqrt(degree), out=scale, where=degree > 0)
    laplacian: _Array = affinity * -scale[:, None]
    laplacian *= scale
    laplacian.flat[:: len(laplacian) + 1] += 1.0
    return laplacian


class GraphLaplacian:
    """The normalised Laplacian of a sparse graph, as something to multiply with; see `normalised_laplacian`.

    `uniform` is a weight spread evenly over all pairs of vertices, as a fraction of the mean degree. It keeps
    a few vertices that hang on no others from taking eigenvectors for themselves.
    """

    # Amini, Chen, Bickel, Levina, "Pseudo-likelihood methods for community detection in large sparse
    # networks", Annals of Statistics 2013; Zhang and Rohe, "Understanding regularized spectral clustering via
    # graph conductance", NeurIPS 2018.
    def __init__(self, affinity: _Array | csr_array, *, uniform: float = 0.0) -> None:
        weights = csr_array(affinity).astype(np.float64)
        _check_weights(weights.data)
        self.shape = weights.shape
        degree = np.asarray(weights.sum(axis=1))
        _check_ties(degree)
        weight = uniform * degree.mean() / len(degree) if len(degree) else 0.0
        self.root_degree = np.sqrt(np.where(degree > 0, degree + weight * len(degree), 0.0))
        """(N,) float64, square roots of the row sums and of the uniform part of N ties; 0 without weight."""
        scale = np.zeros(len(degree))
        np.divide(1.0, self.root_degree, out=scale, where=degree > 0)
        self._adjacency: Any = diags_array(scale) @ weights @ diags_array(scale)
        if len(degree) <= _LARGEST_FULL and weights.nnz > _FULL * len(degree) ** 2:
            self._adjacency = self._adjacency.toarray()
        self._uniform = (np.sqrt(weight) * scale)[:, None]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> FloatArray:  # noqa: ANN401
        sparse = not isinstance(self._adjacency, np.ndarray)
        out: FloatArray = -(self._adjacency.toarray() if sparse else self._adjacency)
        out -= self._uniform @ self._uniform.T
        out.flat[:: len(out) + 1] += 1.0
        return out

    def __matmul__(self, vectors: FloatArray) -> FloatArray:
        # By rows: a symmetric full matrix is read in one pass.
        out: FloatArray = vectors - (vectors.T @ self._adjacency).T
        out -= self._uniform @ (self._uniform.T @ vectors)
        return out


def smallest_eigenvectors(matrix: Symmetric, count: int, *, tolerance: float = 1e-8) -> FloatArray:
    """Orthonormal eigenvectors (N, K) of the smallest eigenvalues of a symmetric matrix, in their order.

    Small matrices are written out and given to LAPACK. Larger ones go through a block Krylov
    method with thick restarts, whose block is wider than `count` so that it finds eigenvalues of
    that multiplicity, as graphs of several components have them; `tolerance` is the largest norm of a
    residual |M u - theta u|. No random state is used: the same matrix gives the same vectors, the largest
    entry of each positive. TooFewPointsError when `count` is not in 1..N.
    """
    # Stewart, "A Krylov-Schur algorithm for large eigenproblems", SIAM J. Matrix Anal. Appl. 2001; Zhou and
    # Saad, "Block Krylov-Schur method for large symmetric eigenvalue problems", 2008.
    return fixed_sign(smallest_subspace(matrix, count, tolerance=tolerance)[1][:, :count])


def smallest_subspace(
    matrix: Symmetric, count: int, *, start: FloatArray | None = None, tolerance: float = 1e-8
) -> tuple[FloatArray, FloatArray]:
    """Find what `smallest_eigenvectors` finds, without fixed signs, and some approximate ones more.

    Returns eigenvalues (b,) and vectors (N, b). `start` is the vectors that this function gave for a matrix
    nearby; it saves most of the work.
    """
    size = matrix.shape[0]
    if not 1 <= count <= size:
        raise TooFewPointsError("number of clusters", expected=f"1..{size} (points)", found=str(count))
    block = -(-(count + _GUARD) // _WIDTH) * _WIDTH
    if size <= max(_DENSE if start is None else 0, (_EXPANSIONS + 3) * block):
        return _dense(matrix, min(block, size))
    if start is None:
        start = _orthonormal(np.random.default_rng(_START_SEED).standard_normal((size, block)))
    return _krylov(matrix, start, count, block, tolerance)


def fixed_sign(vectors: FloatArray) -> FloatArray:
    """Flip columns so that the entry of largest magnitude is positive: an eigenvector has no sign."""
    largest = np.abs(vectors).argmax(axis=0)
    sign = np.sign(vectors[largest, np.arange(vectors.shape[1])])
    return vectors * np.where(sign == 0, 1.0, sign)


def unit_rows(points: FloatArray) -> FloatArray:
    """Scale the rows to unit length; a row of zeros stays a row of zeros."""
    length = np.linalg.norm(points, axis=1, keepdims=True)
    scaled = np.zeros_like(points)
    np.divide(points, length, out=scaled, where=length > 0)
    return scaled


def spectral_embedding(affinity: _Array, n_clusters: int) -> FloatArray:
    """Embed the N vertices of a graph by the smoothest functions on it, (N, K)."""
    return smallest_eigenvectors(normalised_laplacian(affinity), n_clusters)


def spectral_clustering(
    affinity: _Array, n_clusters: int, rng: np.random.Generator, *, n_restarts: int = 20
) -> IntArray:
    """Partition the vertices of a weighted graph (N, N) by k-means on the unit rows of its embedding.

    Returns labels 1..K (N,); TooFewPointsError when there are fewer vertices than clusters.
    """
    # Ng, Jordan, Weiss, NIPS 2001.
    points = unit_rows(spectral_embedding(affinity, n_clusters))
    return kmeans(points, n_clusters, rng, n_restarts=n_restarts).labels + 1


def relative_eigengaps(affinity: FloatArray, largest: int) -> FloatArray:
    """Gaps ``(lambda_{k+1} - lambda_k) / (lambda_k + 0.01)`` of the normalised Laplacian, k = 1..`largest`.

    Dividing matters: on Hopkins155 the plain gap (von Luxburg, "A tutorial on spectral clustering", 2007,
    section 8.3) takes the bulk of the spectrum for a cluster boundary. At most N - 1 gaps exist.
    """
    largest = min(largest, len(affinity) - 1)
    if largest < 1:
        return np.zeros(0)
    laplacian = normalised_laplacian(affinity)
    values = eigvalsh(laplacian, subset_by_index=(0, largest), check_finite=False)
    return np.asarray(np.diff(values) / (np.maximum(values[:-1], 0) + EIGENVALUE_FLOOR))


def count_by_eigengap(affinity: FloatArray) -> int:
    """Count clusters by the widest of `relative_eigengaps`, the smallest k in 2..6 of equals.

    At least two motions are assumed: with one there is nothing to segment. A single point counts 1.
    """
    gaps = relative_eigengaps(affinity, 6)
    return int(np.argmax(gaps[1:])) + 2 if len(gaps) > 1 else 1


def _check_weights(weights: _Array) -> None:
    if weights.size and not (np.isfinite(weights).all() and weights.min() >= 0):
        raise InvalidValueError("affinity", expected="finite weights >= 0", found="NaN, inf or negative")


def _check_ties(degree: _Array) -> None:
    if degree.size and not degree.any():  # any partition would do
        raise SegmentationError("affinity", expected="ties between points", found="none")


def _dense(matrix: Symmetric, count: int) -> tuple[FloatArray, FloatArray]:
    values, vectors = eigh(
        np.asarray(matrix), subset_by_index=(0, count - 1), driver="evr", check_finite=False
    )
    return values, np.ascontiguousarray(vectors)


def _krylov(
    matrix: Symmetric, first: FloatArray, count: int, block: int, tolerance: float
) -> tuple[FloatArray, FloatArray]:
    """Solve the problem projected on a basis, expand the basis by residuals, repeat.

    LAPACK takes over where eigenvalues lie so close that this does not get there.
    """
    kept = first.shape[1]
    basis = np.empty((len(first), max(kept, 2 * block) + _EXPANSIONS * block), order="F")
    image = np.empty_like(basis, order="F")
    basis[:, :kept], image[:, :kept] = first, matrix @ np.ascontiguousarray(first)
    filled = kept
    for _ in range(_MAX_RESTARTS):
        projected = basis[:, :filled].T @ image[:, :filled]
        values, rotation = np.linalg.eigh((projected + projected.T) / 2)
        kept = min(filled, 2 * block)
        best = np.asfortranarray(rotation[:, :kept])
        basis[:, :kept], image[:, :kept] = basis[:, :filled] @ best, image[:, :filled] @ best
        direction = image[:, :block] - basis[:, :block] * values[:block]
        if np.linalg.norm(direction[:, :count], axis=0).max() < tolerance:
            return values[:kept], np.ascontiguousarray(basis[:, :kept])
        filled = kept
        for _ in range(_EXPANSIONS):
            for _ in range(2):
                found = basis[:, :filled]
                direction = _orthonormal(direction - found @ (found.T @ direction))
            basis[:, filled : filled + block] = direction
            direction = matrix @ np.ascontiguousarray(direction)
            image[:, filled : filled + block] = direction
            filled += block
    return _dense(matrix, block)


def _orthonormal(vectors: FloatArray) -> FloatArray:
    # Straight to LAPACK: the blocks are thin, and wrappers would take most of the time.
    reflectors, tau, *_ = dgeqrf(vectors)
    return np.asarray(dorgqr(reflectors, tau)[0], dtype=np.float64)
