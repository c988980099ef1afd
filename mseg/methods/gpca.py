"""Generalised principal component analysis (GPCA) with spectral clustering of normals."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from kt3dmoseg.options import option
from kt3dmoseg.types import FloatArray, IntArray
from mseg.clustering import spectral_clustering, unit_rows
from mseg.errors import TooFewPointsError
from mseg.geometry.subspaces import leading_row_space
from mseg.methods.complete_data import CompleteData, CompleteDataMethod
from mseg.types import Grouping


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
        """Label the columns of the trajectory matrix."""
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
