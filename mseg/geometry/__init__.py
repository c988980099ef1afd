"""Two-view models of one motion: affine maps, homographies, fundamental matrices; and linear subspaces."""

from __future__ import annotations

from mseg.geometry import fundamental, hartley, subspaces
from mseg.geometry.hartley import FramePair, change_frame, frame_pair
from mseg.geometry.models import MODELS, Distance, Model

__all__ = [
    "MODELS",
    "Distance",
    "FramePair",
    "Model",
    "change_frame",
    "frame_pair",
    "fundamental",
    "hartley",
    "subspaces",
]
