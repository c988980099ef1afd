"""Two-view models of one motion: affine maps, homographies, fundamental matrices."""

from __future__ import annotations

from mseg.geometry import affine, fundamental, hartley, homography
from mseg.geometry.models import MODELS, Distance, Model, change_frame, residuals

__all__ = [
    "MODELS",
    "Distance",
    "Model",
    "affine",
    "change_frame",
    "fundamental",
    "hartley",
    "homography",
    "residuals",
]
