"""Sparse self-expression in several views that agree on who expresses whom."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kt3dmoseg.types import FloatArray
from mseg.clustering.self_expressive import Representation, ShiftedInverse
from mseg.iteration import iterate


def collaborative_representation(
    views: Sequence[FloatArray],
    *,
    alpha: float = 8000.0,
    penalty: float = 50.0,
    tolerance: float = 2e-3,
    max_iterations: int = 200,
) -> Representation:
    """Express every point by few others, the same ones in all views, by ADMM.

        min sum_v alpha/2 |W_v - W_v C_v|_F^2 + sum_ij |(C_1(i, j), ..., C_V(i, j))|_2,  diag C_v = 0

    Parameters
    ----------
    views : sequence of (D, N) float64
        Points as columns, at unit length; a column of zeros is a point that the view does not see. It
        neither expresses nor is expressed there.
    alpha : float
        Weight of the fit.
    penalty : float
        Penalty of the splitting of C into a fitted and a sparse copy; changes the way, not the solution.
    tolerance : float
        Stop when the copies differ, and the sparse one has moved, by no more than this in any entry.
    max_iterations : int
        Cap; an iteration costs O(V N^2 D).

    Returns
    -------
    Representation
        Coefficients (N, N): over the views the sum of magnitudes.

    References
    ----------
    Li, Guo, Cheong, Zhou, "Perspective motion segmentation via collaborative clustering", ICCV 2013,
    section 3 (mixed norm); splitting as in Elhamifar and Vidal, TPAMI 2013, algorithm 2.
    """
    n = views[0].shape[1]
    systems = [ShiftedInverse(np.sqrt(alpha) * view) for view in views]
    grams = [alpha * (view.T @ view) for view in views]
    c, u, z = (np.zeros((len(views), n, n)) for _ in range(3))
    diagonal = np.arange(n)

    def step() -> float:
        nonlocal c, u
        for v, (system, gram) in enumerate(zip(systems, grams, strict=True)):
            z[v] = system.solve(gram + penalty * (c[v] - u[v]), penalty)
        u += z
        size = np.sqrt(np.einsum("vij,vij->ij", u, u))
        keep = np.maximum(1 - 1 / np.maximum(penalty * size, 1), 0)
        sparse = u * keep
        sparse[:, diagonal, diagonal] = 0
        moved = max(float(np.abs(z - sparse).max()), float(np.abs(sparse - c).max()))
        c = sparse
        u -= c
        return moved

    convergence = iterate(step, tolerance=tolerance, max_iterations=max_iterations)
    return Representation(np.abs(c).sum(axis=0), convergence)
