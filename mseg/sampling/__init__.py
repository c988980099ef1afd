"""Sampling of model hypotheses."""

from __future__ import annotations

from mseg.sampling.hypotheses import sample_hypotheses
from mseg.sampling.subsets import draw_subsets

__all__ = ["draw_subsets", "sample_hypotheses"]
