"""From trajectories to affinities: hypotheses are sampled, residuals ranked, kernels sparsified."""

from __future__ import annotations

from mseg.kernels.hypotheses import sample_hypotheses
from mseg.kernels.ordered_residuals import ordered_residual_kernel, preferences
from mseg.kernels.sparsify import neighbourhood_mask, sparsify
from mseg.kernels.subsets import draw_subsets
from mseg.kernels.view import GUARD, covisible_frames, view_kernel

ALGORITHM_VERSION: int = 1
"""Part of the identity of kept kernels; raised by hand whenever the values of a kernel change."""

__all__ = [
    "ALGORITHM_VERSION",
    "GUARD",
    "covisible_frames",
    "draw_subsets",
    "neighbourhood_mask",
    "ordered_residual_kernel",
    "preferences",
    "sample_hypotheses",
    "sparsify",
    "view_kernel",
]
