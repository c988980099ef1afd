"""Iterate until a residual is small, and report whether it became so."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Convergence:
    """How an iteration ended."""

    converged: bool  # whether the residual fell to the tolerance before the cap on iterations
    iterations: int  # steps taken
    residual: float  # after the last step

    def report(self, prefix: str = "") -> dict[str, Any]:
        """Return the fields as items of ``Segmentation.report``, names prefixed by `prefix`."""
        return {f"{prefix}{name}": value for name, value in asdict(self).items()}


def iterate(step: Callable[[], float], *, tolerance: float, max_iterations: int) -> Convergence:
    """Call `step`, at least once, until the residual that it returns is at most `tolerance`; NaN never is."""
    residual, iterations = float("inf"), 0
    while iterations < max(max_iterations, 1) and not residual <= tolerance:
        residual = float(step())
        iterations += 1
    return Convergence(residual <= tolerance, iterations, residual)
