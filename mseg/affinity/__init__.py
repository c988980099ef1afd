"""Affinities between trajectories."""

from __future__ import annotations

from mseg.affinity.ordered_residuals import ordered_residual_kernel, preferences
from mseg.affinity.sparsify import neighbourhood_mask, sparsify
from mseg.affinity.view import GUARD, covisible_frames, view_kernel

__all__ = [
    "GUARD",
    "covisible_frames",
    "neighbourhood_mask",
    "ordered_residual_kernel",
    "preferences",
    "sparsify",
    "view_kernel",
]
