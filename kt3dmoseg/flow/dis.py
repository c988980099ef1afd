"""Dense inverse search as OpenCV has it: quick, and the reference that costs are measured against."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from kt3dmoseg.flow.base import check_pair
from kt3dmoseg.options import option
from kt3dmoseg.types import ByteArray, Float32Array

_PRESETS = {
    "ultrafast": cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST,
    "fast": cv2.DISOPTICAL_FLOW_PRESET_FAST,
    "medium": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM,
}


@dataclass(frozen=True)
class DisMedium:
    """OpenCV's DIS flow (Kroeger, Timofte, Dai, Van Gool, ECCV 2016), preset by name."""

    preset: Literal["ultrafast", "fast", "medium"] = option(
        "medium", "OpenCV's preset: search step, patch overlap and refinement"
    )

    def __call__(self, a: ByteArray, b: ByteArray) -> Float32Array:
        """Displacement of every pixel of `a`; see `kt3dmoseg.flow.base.Flow`."""
        check_pair(a, b)
        solver = cv2.DISOpticalFlow.create(_PRESETS[self.preset])
        return np.asarray(solver.calc(a, b, None), np.float32)  # type: ignore[call-overload]  # its stub forgets None
