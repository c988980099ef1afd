"""From the coefficients of a self-expressive model to an affinity, and from an affinity to a count."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigvalsh

from kt3dmoseg.types import FloatArray
from mseg.clustering.laplacian import normalised_laplacian, unit_rows

_RELATIVE_RANK = 1e-4
_EIGENVALUE_FLOOR = 0.01


def keep_largest(coefficients: FloatArray, share: float) -> FloatArray:
    """Keep of each column its largest magnitudes, as many as make up a share of their sum.

    Parameters
    ----------
    coefficients : (N, N) float64
        Coefficients.
    share : float
        Part of each column's l1 norm to reach, 0..1; 1 keeps everything.

    Returns
    -------
    (N, N) float64
        The same with the small ones set to zero; the entry that reaches the share is kept.

    References
    ----------
    Elhamifar and Vidal, TPAMI 2013, section 7.1 (the step called thrC in their code).
    """
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
    """Affinity of sparse coefficients: kept, columns scaled to a maximum of one, symmetrised.

    Parameters
    ----------
    coefficients : (N, N) float64
        Coefficients C.
    share : float
        See `keep_largest`.

    Returns
    -------
    (N, N) float64
        ``|C| + |C|^T``, symmetric, in [0, 2].
    """
    magnitude = np.abs(keep_largest(coefficients, share))
    scaled = magnitude / (magnitude.max(axis=0) + np.finfo(np.float64).eps)
    return np.asarray(scaled + scaled.T)


def low_rank_affinity(coefficients: FloatArray, power: int = 4) -> FloatArray:
    """Affinity of low-rank coefficients by the angles of their column space.

    With ``Z = U S V^T`` (singular values over 1e-4 of the first) and M the rows of ``U sqrt(S)`` at
    unit length, the affinity is ``|M M^T|_ij`` to a power.

    Parameters
    ----------
    coefficients : (N, N) float64
        Coefficients Z.
    power : int
        Exponent (even in the source).

    Returns
    -------
    (N, N) float64
        Symmetric, in [0, 1].

    References
    ----------
    Liu et al., TPAMI 2013, algorithm 2; the exponent is that of the authors' motion script.
    """
    left, values, _ = np.linalg.svd(coefficients)
    kept = values > _RELATIVE_RANK * values[0]
    rows = unit_rows(left[:, kept] * np.sqrt(values[kept]))
    return np.asarray(np.minimum(np.abs(rows @ rows.T), 1) ** power)


def count_by_eigengap(affinity: FloatArray, largest: int = 6) -> int:
    """Count clusters by the widest relative gap in the spectrum of the normalised Laplacian.

    Parameters
    ----------
    affinity : (N, N) float64
        Symmetric weights >= 0.
    largest : int
        Largest number considered.

    Returns
    -------
    int
        Number k in 2..`largest` of the widest of `relative_eigengaps`, the smallest of equals. At least
        two motions are assumed: with one there is nothing to segment.
    """
    gaps = relative_eigengaps(affinity, largest)
    return int(np.argmax(gaps[1:])) + 2 if len(gaps) > 1 else 1


def relative_eigengaps(affinity: FloatArray, largest: int) -> FloatArray:
    """Gaps ``(lambda_{k+1} - lambda_k) / (lambda_k + 0.01)`` for k = 1..`largest`.

    Eigenvalues of the normalised Laplacian, ascending (von Luxburg, "A tutorial on spectral clustering",
    2007, section 8.3). Dividing matters: on Hopkins155 the plain gap takes the bulk of the spectrum for a
    cluster boundary. The floor keeps values that are zero but for rounding from deciding.

    Parameters
    ----------
    affinity : (N, N) float64
        Symmetric weights >= 0.
    largest : int
        Number of gaps wanted; at most N - 1 exist.

    Returns
    -------
    (min(largest, N - 1),) float64
    """
    largest = min(largest, len(affinity) - 1)
    if largest < 1:
        return np.zeros(0)
    laplacian = normalised_laplacian(affinity)
    values = eigvalsh(laplacian, subset_by_index=(0, largest), check_finite=False)
    return np.asarray(np.diff(values) / (np.maximum(values[:-1], 0) + _EIGENVALUE_FLOOR))
