"""Missing and corrupted entries of a trajectory matrix."""

from __future__ import annotations

from mseg.completion.chen import Completion, complete
from mseg.completion.local import complete_locally
from mseg.completion.robust_pca import RobustPCA, robust_pca, shrink, shrink_singular_values

__all__ = [
    "Completion",
    "RobustPCA",
    "complete",
    "complete_locally",
    "robust_pca",
    "shrink",
    "shrink_singular_values",
]
