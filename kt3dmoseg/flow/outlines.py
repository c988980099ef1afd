"""Motion that has spread over an outline is taken back: pixels try the motions of their neighbours."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from kt3dmoseg.types import ByteArray, Float32Array

_RADIUS = 2
_CAP = 20
_DIRECTIONS = ((1, 0), (-1, 0), (0, 1), (0, -1))


def sharpen(
    a: ByteArray, b: ByteArray, field: Float32Array, *, reach: Sequence[int], share: float, floor: float
) -> Float32Array:
    """Replace motions by those of neighbours where these fit the frames clearly better.

    A smooth field carries the motion of an object some pixels beyond its outline. The right motion is
    then found a few pixels away, on the pixel's own side. A field fits as well as a patch about
    each pixel agrees with the patch that it leads to: the mean over 5 x 5 pixels of the absolute difference
    of gray values, none counted with more than 20, so that the other side of the outline, which moves
    differently, has little weight. Trying the neighbours' motions is the propagation of PatchMatch
    (Barnes, Shechtman, Finkelstein, Goldman, SIGGRAPH 2009); the cost with its cap is common in stereo
    (Hosni, Rhemann, Bleyer, Rother, Gelautz, PAMI 2013).

    Parameters
    ----------
    a, b : (H, W) uint8
        Frames.
    field : (H, W, 2) float32
        Motion from `a` to `b`.
    reach : sequence of int
        Distances in pixels of the neighbours: left, right, above and below at each.
    share, floor : float
        The first change must bring the mean difference under ``share * difference - floor``, so that
        noise moves nothing; further ones need only be better.

    Returns
    -------
    (H, W, 2) float32
    """
    difference = _Difference(a, b)
    limit = np.asarray(difference(field) * np.float32(share) - np.float32(floor), np.float32)
    result = field.copy()
    height, width = a.shape
    for far in reach:
        around = cv2.copyMakeBorder(result, far, far, far, far, cv2.BORDER_REPLICATE)
        for x, y in _DIRECTIONS:
            left, top = far * (1 + x), far * (1 + y)
            candidate = np.asarray(around[top : top + height, left : left + width], np.float32)
            now = difference(candidate)
            better = cv2.compare(now, limit, cv2.CMP_LT)
            cv2.copyTo(candidate, better, result)
            cv2.copyTo(now, better, limit)
    return result


class _Difference:
    """Mean capped difference of gray values between patches of two frames; outside, the second is black."""

    def __init__(self, a: ByteArray, b: ByteArray) -> None:
        self.a, self.b = a, b
        columns, rows = (np.arange(side, dtype=np.float32) for side in reversed(a.shape))
        self.pixels = np.stack(np.meshgrid(columns, rows), axis=2)
        self.target = np.empty_like(self.pixels)

    def __call__(self, field: Float32Array) -> Float32Array:
        np.add(self.pixels, field, out=self.target)
        seen = cv2.remap(self.b, self.target, None, cv2.INTER_LINEAR)  # type: ignore[call-overload]  # its stub forgets None
        apart = cv2.min(cv2.absdiff(seen, self.a), _CAP)  # type: ignore[call-overload]  # nor numbers
        side = 2 * _RADIUS + 1
        return np.asarray(cv2.boxFilter(apart, cv2.CV_32F, (side, side)), np.float32)
