"""From the light along rays to the grey values of pixels."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import ByteArray, FloatArray


def subpixels(size: int, samples: int) -> FloatArray:
    """Positions along one side of the image, `samples` per pixel, with half a pixel more at both ends."""
    margin = samples // 2
    return (np.arange(-margin, size * samples + margin) + 0.5) / samples - 0.5


def expose(light: FloatArray, samples: int, noise: float, rng: np.random.Generator) -> ByteArray:
    """Turn the light at `subpixels` into an image.

    A pixel gathers light with a tent as wide as two pixels, about the blur of a good lens on a sensor, which
    keeps moving edges free of steps; then comes Gaussian noise.

    Parameters
    ----------
    light : (H n + 2 [n/2], W n + 2 [n/2]) float64
        Grey values of the rays.
    samples : int
        Rays per pixel and direction, n.
    noise : float
        Standard deviation in grey levels.
    rng : numpy.random.Generator
        Source of the noise.

    Returns
    -------
    (H, W) uint8
    """
    image = _gather(_gather(light, samples).T, samples).T
    image = image + noise * rng.standard_normal(image.shape)
    grey: ByteArray = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return grey


def _gather(light: FloatArray, samples: int) -> FloatArray:
    reach = samples + 2 * (samples // 2)
    weight = 1 - np.abs((np.arange(reach) + 0.5 - reach / 2) / samples)
    size = (len(light) - 2 * (samples // 2)) // samples
    parts = [light[k : k + size * samples : samples] * w for k, w in enumerate(weight / weight.sum())]
    return np.asarray(sum(parts), dtype=np.float64)
