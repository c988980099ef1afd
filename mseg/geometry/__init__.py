"""Two-view models of one motion: affine maps, homographies, fundamental matrices."""

from __future__ import annotations

from mseg.geometry import affine, fundamental, hartley, homography
from mseg.geometry.models import MODELS, Distance, Model, change_frame, residuals
from mseg.geometry.pairs import FramePair, frame_pair

__all__ = [
    "MODELS",
    "Distance",
    "FramePair",
    "Model",
    "affine",
    "change_frame",
    "frame_pair",
    "fundamental",
    "hartley",
    "homography",
    "residuals",
]
