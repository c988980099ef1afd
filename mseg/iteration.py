"""Iterate until a residual is small, and report whether it became so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Convergence:
    """How an iteration ended.

    Parameters
    ----------
    converged : bool
        Whether the residual fell to the tolerance before the cap on iterations.
    iterations : int
        Number of steps taken.
    residual : float
        Residual after the last step.
    """

    converged: bool
    iterations: int
    residual: float

    def report(self, prefix: str = "") -> dict[str, Any]:
        """Return the fields as items of ``Segmentation.report``, names prefixed by `prefix`."""
        return {f"{prefix}{name}": value for name, value in asdict(self).items()}


def iterate(step: Callable[[], float], *, tolerance: float, max_iterations: int) -> Convergence:
    """Call `step` until the residual that it returns is at most `tolerance`.

    Parameters
    ----------
    step : callable
        Advances its own state once and returns the residual after it.
    tolerance : float
        Largest residual that counts as converged. NaN never does.
    max_iterations : int
        Cap; at least one step is taken.
    """
    residual, iterations = float("inf"), 0
    while iterations < max(max_iterations, 1) and not residual <= tolerance:
        residual = float(step())
        iterations += 1
    return Convergence(residual <= tolerance, iterations, residual)
