"""From the light along rays to the grey values of pixels."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import ByteArray, FloatArray

_GAIN, _GAMMA, _WHITE = 1.25, 1.4, 255.0


def ray_offsets(samples: int) -> FloatArray:
    """Where in a pixel its rays pass, relative to its centre.

    A square grid of n x n rays turned by atan(1/n): all n^2 rays lie in different columns and in
    different rows, so that an upright edge moves over the pixel in steps of 1/n^2 instead of 1/n.

    Parameters
    ----------
    samples : int
        n.

    Returns
    -------
    (n^2, 2) float64
        x, y in (-0.5, 0.5).
    """
    count = samples * samples
    column = np.arange(1, count + 1)
    row = samples * column % (count + 1)
    return (np.stack([column, row], axis=1) - 0.5) / count - 0.5


def gather(light: FloatArray, offset: FloatArray) -> FloatArray:
    """Give every pixel the light of its own ray and of its neighbours', weighed by a tent two pixels wide.

    That is about the blur of a good lens on a sensor. The weights of one ray per pixel add to 1, and a
    linear ramp stays what it is, wherever in the pixel the rays pass.

    Parameters
    ----------
    light : (H + 2, W + 2) float64
        Grey values along one ray per pixel, with one pixel more on each side.
    offset : (2,) float64
        Where the rays pass, x and y relative to the pixels' centres, within half a pixel.

    Returns
    -------
    (H, W) float64
    """
    return _gather(_gather(light, offset[1]).T, offset[0]).T


def _gather(light: FloatArray, offset: float) -> FloatArray:
    before, here, after = (max(0.0, 1 - abs(offset + step)) for step in (-1, 0, 1))
    return before * light[:-2] + here * light[1:-1] + after * light[2:]


def expose(image: FloatArray, noise: float, rng: np.random.Generator) -> ByteArray:
    """Turn light into grey values: the camera's response, then Gaussian noise.

    Parameters
    ----------
    image : (H, W) float64
        Light that each pixel gathered, about 0 to 255.
    noise : float
        Standard deviation in grey levels.
    rng : numpy.random.Generator
        Source of the noise.

    Returns
    -------
    (H, W) uint8
    """
    seen = respond(image) + noise * rng.standard_normal(image.shape)
    grey: ByteArray = np.clip(np.rint(seen), 0, 255).astype(np.uint8)
    return grey


def respond(light: FloatArray) -> FloatArray:
    """Grey value of light: 255 (1.25 light / 255)^1.4, saturated at 255.

    The two constants bring contrast, gradients and the share of saturated pixels to those of KITTI's gray
    cameras on the 22 clips (docs/synthetic.md).
    """
    grey: FloatArray = _WHITE * np.clip(_GAIN * light / _WHITE, 0, 1) ** _GAMMA
    return grey
