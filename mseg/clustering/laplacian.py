"""The normalised graph Laplacian and the spectral embedding of an affinity."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array, diags_array

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import FloatArray
from mseg.clustering.eigen import smallest_eigenvectors

_Array = npt.NDArray[Any]


def normalised_laplacian(affinity: _Array) -> _Array:
    """Compute the symmetric normalised Laplacian I - D^-1/2 W D^-1/2.

    Parameters
    ----------
    affinity : (N, N) float32 or float64
        Symmetric weights W >= 0; D is the diagonal of its row sums. A vertex without any weight
        gets the row of the identity, so it takes part in no smooth eigenvector.

    Returns
    -------
    (N, N) of the same dtype
        Symmetric, positive semi-definite, eigenvalues in 0..2.

    Raises
    ------
    InvalidValueError
        When the affinity is not square, not finite or negative.

    References
    ----------
    Ng, Jordan, Weiss, "On spectral clustering", NIPS 2001; von Luxburg, "A tutorial on spectral
    clustering", 2007, section 3.2.
    """
    _check_weights(affinity, affinity.shape)
    degree = affinity.sum(axis=1)
    scale = np.zeros_like(degree)
    np.divide(1.0, np.sqrt(degree), out=scale, where=degree > 0)
    laplacian: _Array = affinity * -scale[:, None]
    laplacian *= scale
    laplacian.flat[:: len(laplacian) + 1] += 1.0
    return laplacian


def spectral_embedding(affinity: _Array, n_clusters: int) -> FloatArray:
    """Embed the vertices of a graph by the smoothest functions on it.

    Parameters
    ----------
    affinity : (N, N) float
        Symmetric weights >= 0.
    n_clusters : int
        Number K of eigenvectors.

    Returns
    -------
    (N, K) float64
        Orthonormal eigenvectors of the K smallest eigenvalues of `normalised_laplacian`, the
        smallest first, each with its largest entry positive.

    Raises
    ------
    TooFewPointsError
        When there are fewer vertices than clusters.
    """
    return smallest_eigenvectors(normalised_laplacian(affinity), n_clusters)


class GraphLaplacian:
    """The normalised Laplacian of a sparse graph, as something to multiply with.

    Parameters
    ----------
    affinity : (N, N) float, array or sparse
        Symmetric weights W >= 0, mostly zero. Vertices without weight get rows of the identity.
    uniform : float
        Weight spread evenly over all pairs of vertices, as a fraction of the mean degree; 0 = none.
        It keeps a few vertices that hang on no others from taking eigenvectors for themselves.

    Raises
    ------
    InvalidValueError
        When the affinity is not square, not finite or negative.

    References
    ----------
    Amini, Chen, Bickel, Levina, "Pseudo-likelihood methods for community detection in large sparse
    networks", Annals of Statistics 2013; Zhang and Rohe, "Understanding regularized spectral
    clustering via graph conductance", NeurIPS 2018.
    """

    def __init__(self, affinity: _Array | csr_array, *, uniform: float = 0.0) -> None:
        weights = csr_array(affinity).astype(np.float64)
        _check_weights(weights.data, weights.shape)
        self.shape = weights.shape
        degree = np.asarray(weights.sum(axis=1))
        weight = uniform * degree.mean() / len(degree) if len(degree) else 0.0
        self.root_degree = np.sqrt(np.where(degree > 0, degree + weight * len(degree), 0.0))
        """(N,) float64, square roots of the row sums, the uniform part included; 0 without weight."""
        scale = np.zeros(len(degree))
        np.divide(1.0, self.root_degree, out=scale, where=degree > 0)
        self._adjacency = diags_array(scale) @ weights @ diags_array(scale)
        self._uniform = (np.sqrt(weight) * scale)[:, None]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> FloatArray:  # noqa: ANN401
        """Write the matrix out, (N, N) float64."""
        out: FloatArray = -self._adjacency.toarray()
        out -= self._uniform @ self._uniform.T
        out.flat[:: len(out) + 1] += 1.0
        return out

    def __matmul__(self, vectors: FloatArray) -> FloatArray:
        """Multiply with (N, b)."""
        out: FloatArray = vectors - self._adjacency @ vectors
        out -= self._uniform @ (self._uniform.T @ vectors)
        return out


def unit_rows(points: FloatArray) -> FloatArray:
    """Scale the rows to unit length; a row of zeros stays a row of zeros."""
    length = np.linalg.norm(points, axis=1, keepdims=True)
    scaled = np.zeros_like(points)
    np.divide(points, length, out=scaled, where=length > 0)
    return scaled


def _check_weights(weights: _Array, shape: tuple[int, ...]) -> None:
    if len(shape) != 2 or shape[0] != shape[1]:
        raise InvalidValueError("affinity", expected="shape (N, N)", found=f"{shape}")
    if weights.size and not (np.isfinite(weights).all() and weights.min() >= 0):
        raise InvalidValueError("affinity", expected="finite weights >= 0", found="NaN, inf or negative")
