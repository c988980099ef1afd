"""Missing and corrupted entries of a trajectory matrix."""

from __future__ import annotations

from mseg.completion.chen import Completion, complete
from mseg.completion.robust_pca import RobustPCA, robust_pca, shrink, shrink_singular_values

__all__ = ["Completion", "RobustPCA", "complete", "robust_pca", "shrink", "shrink_singular_values"]
