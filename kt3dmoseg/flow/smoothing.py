"""Deriche's approximation of Gaussian smoothing, with which the release's tracker smoothed."""

from __future__ import annotations

from functools import cache
from typing import cast

import cv2
import numpy as np

from kt3dmoseg.types import Float32Array

_NEGLIGIBLE = 12.0


def smooth(image: Float32Array, sigma: float) -> Float32Array:
    """Smooth an image; sigma 0 leaves it as it is.

    The kernel is (1 + a |x|) exp(-a |x|) with a = 2.5 / (sqrt(pi) sigma), normalised (Deriche, "Fast
    algorithms for low-level vision", PAMI 1990). Its tails are longer than a Gaussian's: its standard
    deviation is 2 / a = 1.42 sigma. It is usually run as a recursive filter; at these widths a
    finite kernel cut where it has fallen to about 1e-4 is quicker.

    Parameters
    ----------
    image : (H, W) float32
        Image; beyond its border it is mirrored.
    sigma : float
        Width in pixels, as above.

    Returns
    -------
    (H, W) float32
    """
    if sigma <= 0:
        return image
    kernel = _kernel(sigma)
    return cast(
        Float32Array, cv2.sepFilter2D(image, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT)
    )


@cache
def _kernel(sigma: float) -> Float32Array:
    decay = 2.5 / (np.sqrt(np.pi) * sigma)
    radius = int(np.ceil(_NEGLIGIBLE / decay))
    x = decay * np.abs(np.arange(-radius, radius + 1))
    kernel = (1 + x) * np.exp(-x)
    return cast(Float32Array, (kernel / kernel.sum()).astype(np.float32))
