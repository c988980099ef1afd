"""Bilinear look-up in a field at many points, in plain numpy.

``cv2.remap`` is not used: up to OpenCV 4 it rounds coordinates to 1/32 pixel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def sample(field: npt.NDArray[Any], xy: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Interpolate a field bilinearly; outside, its edge goes on.

    Parameters
    ----------
    field : (H, W) or (H, W, C)
        Values at the pixel centres.
    xy : (N, 2)
        Points in pixels, x right, y down.

    Returns
    -------
    (N,) or (N, C) float64
        The field at the points; NaN at a point that is NaN or next to one where the field is.
    """
    points = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
    height, width = field.shape[:2]
    x = np.clip(points[:, 0], 0, width - 1)
    y = np.clip(points[:, 1], 0, height - 1)
    left = np.minimum(np.nan_to_num(x).astype(np.intp), width - 2)
    top = np.minimum(np.nan_to_num(y).astype(np.intp), height - 2)
    shape = (-1,) + (1,) * (field.ndim - 2)
    fx, fy = (x - left).reshape(shape), (y - top).reshape(shape)
    upper = field[top, left] * (1 - fx) + field[top, left + 1] * fx
    lower = field[top + 1, left] * (1 - fx) + field[top + 1, left + 1] * fx
    result: npt.NDArray[np.float64] = upper * (1 - fy) + lower * fy
    return result
