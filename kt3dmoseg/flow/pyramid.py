"""The default flow: DIS for large motions, a variational pyramid for precision, sharp outlines."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from threading import get_ident
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.flow import check_pair, smooth
from kt3dmoseg.flow.variational import expand, minimise
from kt3dmoseg.options import option
from kt3dmoseg.types import ByteArray, Float32Array

_SIDE = 5
_CAP = 20
_REPLICATE = cv2.BORDER_REPLICATE
_ZETA = 0.1
_DIRECTIONS = ((1, 0), (-1, 0), (0, 1), (0, -1))


@dataclass(frozen=True)
class VariationalPyramid:
    """DIS at half size, refined level by level up to full size.

    DIS (Kroeger, Timofte, Dai, Van Gool, ECCV 2016) finds motions of any size. At each level the
    energy of Brox, Bruhn, Papenberg and Weickert (ECCV 2004) - robust constancy of gray values and
    of gradients, robust smoothness - is minimised around the flow so far (`minimise`), each
    constancy term divided by the squared gradient plus 0.1^2. `contrast` moves that 0.1: at the
    default, edges steeper than 0.1 / 0.02 = 5 gray values per pixel count alike and fainter ones
    less, so that noise in flat regions has little weight. As soon as the flow has full size, motion that has
    spread over outlines is taken back (`sharpen`). The linear equations are relaxed far
    beyond the usual 1.6: near 2, successive overrelaxation converges fastest on a grid this large (Young,
    "Iterative Solution of Large Linear Systems", 1971, chapter 6). Measured in docs/tracking.md.
    """

    smoothing: float = option(0.8, "smoothing of the frames before the refinement, sigma", low=0, high=5)
    scales: tuple[float, ...] = option(
        (0.5, 0.7, 1.0, 1.0), "size of each level to the frame; the flow is warped once at each"
    )
    contrast: float = option(
        0.02, "gray values are multiplied by this before the refinement", low=1e-4, high=10
    )
    alpha: float = option(18.0, "weight of smoothness", low=0)
    delta: float = option(2.0, "weight of gray value constancy", low=0)
    gamma: float = option(6.0, "weight of gradient constancy", low=0)
    epsilon: float = option(0.01, "the robust penalty is sqrt(x^2 + epsilon^2)", low=1e-6, high=10)
    iterations: int = option(3, "fixed-point iterations at each level", low=1, high=100)
    relaxations: int = option(5, "SOR sweeps in each fixed-point iteration", low=1, high=100)
    overrelaxation: float = option(1.95, "step of a sweep to the one that solves a row", low=0.1, high=1.99)
    reach: tuple[int, ...] = option(
        (7,), "distances in pixels at which other motions are tried once the flow has full size"
    )
    share: float = option(
        0.95,
        "another motion must bring the patch's difference under share * difference - floor",
        low=0,
        high=1,
    )
    floor: float = option(0.3, "that floor, in gray values", low=0, high=255)

    def __post_init__(self) -> None:
        if not self.scales or not all(0.1 <= scale <= 1 for scale in self.scales) or self.scales[-1] != 1:
            raise InvalidValueError(
                "scales", expected="sizes from 0.1 to 1, the last 1", found=f"{self.scales}"
            )
        if not all(distance >= 1 for distance in self.reach):
            raise InvalidValueError("reach", expected="distances of at least 1 pixel", found=f"{self.reach}")

    def __call__(self, a: ByteArray, b: ByteArray) -> Float32Array:
        """Displacement of every pixel of `a`; see `kt3dmoseg.flow.Flow`."""
        check_pair(a, b)
        field = _seed(a, b)
        frames = [smooth(frame * np.float32(self.contrast), self.smoothing) for frame in (a, b)]
        for level, scale in enumerate(self.scales):
            size = round(a.shape[0] * scale), round(a.shape[1] * scale)
            # Smoothed as they are, the frames need no averaging at half size and above.
            first, second, field = (_resized(picture, size) for picture in (*frames, field))
            if level == self.scales.index(1):
                field = sharpen(a, b, field, reach=self.reach, share=self.share, floor=self.floor)
            field = self._refined(first, second, field)
        return field

    def _refined(self, first: Float32Array, second: Float32Array, field: Float32Array) -> Float32Array:
        """Warp the second frame by a flow, minimise the energy around it, and change it in place."""
        height, width = first.shape
        planes = np.empty((7, height, width + 2), np.float32)
        warped = cv2.remap(second, _pixels(first) + field, None, cv2.INTER_LINEAR, borderMode=_REPLICATE)  # type: ignore[call-overload]  # its stub forgets None
        expand(first, warped, field, planes)
        halved = self.alpha / 2, self.delta / 2, self.gamma / 2
        weights = np.array([*halved, self.epsilon, _ZETA, self.overrelaxation], np.float32)
        weights[3:5] **= 2
        minimise(planes, weights, self.iterations, 2 * self.relaxations)
        for axis in (0, 1):
            field[..., axis] += planes[5 + axis, :, 1:-1]
        return field


def _seed(a: ByteArray, b: ByteArray) -> Float32Array:
    """DIS medium on lightly smoothed frames, without its own refinement: the pyramid does better."""
    smooth_a, smooth_b = (cv2.GaussianBlur(frame, (5, 5), 0.8) for frame in (a, b))
    field = _search(get_ident()).calc(smooth_a, smooth_b, None)  # type: ignore[call-overload]  # its stub forgets None
    return np.asarray(field, np.float32)


@lru_cache(maxsize=1)
def _search(_thread: int) -> cv2.DISOpticalFlow:
    """Make a thread's solver and keep it, with its memory."""
    solver = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    solver.setVariationalRefinementIterations(0)
    return solver


def _resized(picture: Float32Array, shape: tuple[int, int]) -> Float32Array:
    """Resample a frame, or a field, whose vectors are scaled alike."""
    if picture.shape[:2] == shape:
        return picture
    result = np.asarray(cv2.resize(picture, shape[::-1]), np.float32)
    for axis in (0, 1) if result.ndim == 3 else ():  # both at once, broadcast, take seven times as long
        result[..., axis] *= shape[1 - axis] / picture.shape[1 - axis]
    return result


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

    `reach` lists distances in pixels of the neighbours: left, right, above and below at each. The first
    change must bring the mean difference under ``share * difference - floor``, so that noise moves nothing;
    further ones need only be better.
    """
    (height, width), pixels = a.shape, _pixels(a)

    def difference(candidates: Float32Array) -> Float32Array:
        """Mean capped difference of patches; outside, the second frame is black."""
        seen = cv2.remap(b, pixels + candidates, None, cv2.INTER_LINEAR)  # type: ignore[call-overload]  # its stub forgets None
        apart = cv2.min(cv2.absdiff(seen, a), _CAP)  # type: ignore[call-overload]  # nor numbers
        return np.asarray(cv2.boxFilter(apart, cv2.CV_32F, (_SIDE, _SIDE)), np.float32)

    limit = np.asarray(difference(field) * np.float32(share) - np.float32(floor), np.float32)
    result = field.copy()
    for far in reach:
        around = np.asarray(cv2.copyMakeBorder(result, far, far, far, far, _REPLICATE), np.float32)
        for x, y in _DIRECTIONS:
            left, top = far * (1 + x), far * (1 + y)
            candidates = around[top : top + height, left : left + width]
            found = difference(candidates)
            better = cv2.compare(found, limit, cv2.CMP_LT)
            cv2.copyTo(candidates, better, result)
            cv2.copyTo(found, better, limit)
    return result


def _pixels(frame: npt.NDArray[Any]) -> Float32Array:
    """Where the pixels of a frame (H, W) are, (H, W, 2)."""
    return np.dstack(np.meshgrid(*(np.arange(side, dtype=np.float32) for side in frame.shape[::-1])))
