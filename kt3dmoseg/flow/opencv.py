"""OpenCV's own flows: DIS, quick and the reference that costs are measured against, and Farneback's."""

from dataclasses import astuple, dataclass
from typing import Literal

import cv2
import numpy as np

from kt3dmoseg.flow import check_pair
from kt3dmoseg.options import option
from kt3dmoseg.types import ByteArray, Float32Array


@dataclass(frozen=True)
class DisMedium:
    """OpenCV's DIS flow (Kroeger, Timofte, Dai, Van Gool, ECCV 2016), preset by name."""

    preset: Literal["ultrafast", "fast", "medium"] = option(
        "medium", "OpenCV's preset: search step, patch overlap and refinement"
    )

    def __call__(self, a: ByteArray, b: ByteArray) -> Float32Array:
        """Displacement of every pixel of `a`; see `kt3dmoseg.flow.Flow`."""
        check_pair(a, b)
        solver = cv2.DISOpticalFlow.create(getattr(cv2, f"DISOPTICAL_FLOW_PRESET_{self.preset.upper()}"))
        return np.asarray(solver.calc(a, b, None), np.float32)  # type: ignore[call-overload]  # its stub forgets None


@dataclass(frozen=True)
class Farneback:
    """OpenCV's Farneback flow (Farneback, SCIA 2003); its parameters are in OpenCV's order."""

    pyramid_scale: float = option(0.5, "size of a pyramid level to the one below", low=0.1, high=0.95)
    levels: int = option(5, "pyramid levels", low=1, high=20)
    window: int = option(15, "averaging window in pixels", low=3, high=99)
    iterations: int = option(5, "iterations at each level", low=1, high=100)
    neighbourhood: int = option(7, "pixels that each polynomial is fitted to", low=3, high=21)
    sigma: float = option(1.5, "standard deviation of the fit's weights in pixels", low=0.1, high=10)

    def __call__(self, a: ByteArray, b: ByteArray) -> Float32Array:
        """Displacement of every pixel of `a`; see `kt3dmoseg.flow.Flow`."""
        check_pair(a, b)
        field = cv2.calcOpticalFlowFarneback(a, b, None, *astuple(self), 0)  # type: ignore[call-overload]  # as above
        return np.asarray(field, np.float32)
