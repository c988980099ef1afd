"""The normalised graph Laplacian and the spectral embedding of an affinity."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import FloatArray
from mseg.errors import TooFewPointsError

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
    _check_affinity(affinity)
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


def smallest_eigenvectors(matrix: _Array, count: int) -> FloatArray:
    """Orthonormal eigenvectors of the `count` smallest eigenvalues of a symmetric matrix, (N, count)."""
    if not 1 <= count <= len(matrix):
        raise TooFewPointsError("number of clusters", expected=f"1..{len(matrix)} (points)", found=str(count))
    _, vectors = eigh(matrix, subset_by_index=(0, count - 1), driver="evr", check_finite=False)
    return fixed_sign(np.asarray(vectors, dtype=np.float64))


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


def _check_affinity(affinity: _Array) -> None:
    if affinity.ndim != 2 or affinity.shape[0] != affinity.shape[1]:
        raise InvalidValueError("affinity", expected="shape (N, N)", found=f"{affinity.shape}")
    if affinity.size and not (np.isfinite(affinity).all() and affinity.min() >= 0):
        raise InvalidValueError("affinity", expected="finite weights >= 0", found="NaN, inf or negative")
