"""Symmetric non-negative factorisation: an affinity as soft memberships times their transpose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kt3dmoseg.types import FloatArray
from mseg.iteration import Convergence, iterate


@dataclass(frozen=True, eq=False)
class SoftMembership:
    """Memberships (N, K) float64 >= 0, and how the factorisation ended."""

    memberships: FloatArray
    convergence: Convergence


def symmetric_factors(
    affinity: FloatArray, start: FloatArray, *, tolerance: float = 1e-5, max_iterations: int = 1000
) -> SoftMembership:
    """Minimise ``|A - U U^T|_F^2`` over U >= 0 by damped multiplicative updates.

    Parameters
    ----------
    affinity : (N, N) float64
        Symmetric A >= 0.
    start : (N, K) float64
        Memberships to start from; zeros stay zero.
    tolerance : float
        Stop when an update moves U by at most this fraction of its norm.
    max_iterations : int
        Cap on updates, each O(N^2 K).

    References
    ----------
    Update ``U <- U o (1/2 + 1/2 A U / (U U^T U))``: Ding, Li, Jordan, "Nonnegative matrix factorization for
    combinatorial optimization", ICDM 2008; it never raises the objective.
    """
    u = start.copy()

    def step() -> float:
        nonlocal u
        denominator = u @ (u.T @ u)
        gain = np.divide(affinity @ u, denominator, out=np.zeros_like(u), where=denominator > 0)
        updated = u * (0.5 + 0.5 * gain)
        moved = float(np.linalg.norm(updated - u))
        u = updated
        return moved / (float(np.linalg.norm(u)) or 1.0)

    convergence = iterate(step, tolerance=tolerance, max_iterations=max_iterations)
    return SoftMembership(u, convergence)
