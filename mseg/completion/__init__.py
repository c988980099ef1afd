"""Missing and corrupted positions in a trajectory matrix."""

from __future__ import annotations

from mseg.completion.chen import Completion, complete
from mseg.completion.local import complete_locally
from mseg.completion.robust_pca import RobustPCA, robust_pca, shrink

__all__ = [
    "Completion",
    "RobustPCA",
    "complete",
    "complete_locally",
    "robust_pca",
    "shrink",
]
