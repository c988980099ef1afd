"""Cuts of a video: where no motion explains the next frame by the one before."""

from collections.abc import Iterable

import cv2
import numpy as np
import numpy.typing as npt

from kt3dmoseg.flow import create
from kt3dmoseg.types import ByteArray

_SIDE, _LEAST = 160, 32  # frames are compared at this size: large motions become small
_DETAIL = 4.0  # sigma of what is taken out before comparing, pixels: brightness may change
_NOISE = 1.0  # gray levels; flat pictures are alike
# Least correlation of a frame, carried back by the flow, with the one before. Of KITTI's clips 99 % of the
# pairs three frames apart reach 0.26, and 99 % of the pairs of two drives stay below 0.2.
_ALIKE = 0.25


def find_cuts(frames: Iterable[ByteArray]) -> tuple[list[int], int]:
    """Find where shots begin in gray frames (H, W): indices, the first of them 0, and the number of frames.

    Frames of another size begin a shot, too. Gradual changes are not found.
    """
    starts, count = [0], 0
    shape, before = None, np.zeros((0, 0), dtype=np.uint8)
    for count, frame in enumerate(frames, start=1):
        size = [max(_LEAST, round(side * _SIDE / max(frame.shape))) for side in frame.shape[::-1]]
        small = np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        if count > 1 and (frame.shape != shape or _likeness(before, small) < _ALIKE):
            starts.append(count - 1)
        shape, before = frame.shape, small
    return starts, count


def _likeness(before: ByteArray, here: ByteArray) -> float:
    """Correlate the details of two frames, the second carried back by the flow between them."""
    y, x = np.indices(before.shape, dtype=np.float32)
    flow = create("dis_medium", preset="fast")(before, here)
    a, b = _detail(before), _detail(cv2.remap(here, x + flow[..., 0], y + flow[..., 1], cv2.INTER_LINEAR))
    floor = _NOISE**2 * a.size
    return float((a * b).sum() + floor) / float(np.sqrt((a * a).sum() * (b * b).sum()) + floor)


def _detail(frame: npt.ArrayLike) -> npt.NDArray[np.float32]:
    values = np.asarray(frame, dtype=np.float32)
    return np.asarray(values - cv2.GaussianBlur(values, (0, 0), _DETAIL))
