"""The default flow: DIS for the large motions, then a variational pyramid for the precision."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from kt3dmoseg.flow.base import check_pair
from kt3dmoseg.flow.smoothing import smooth
from kt3dmoseg.options import option
from kt3dmoseg.types import ByteArray, Float32Array


@dataclass(frozen=True)
class VariationalPyramid:
    """DIS at reduced size, refined level by level up to full size.

    DIS (Kroeger et al., ECCV 2016) finds motions of any size; at each level the energy of Brox,
    Bruhn, Papenberg and Weickert (ECCV 2004) - robust gray and gradient constancy, robust
    smoothness - is minimised around the warped flow with OpenCV's `VariationalRefinement`.
    """

    smoothing: float = option(0.8, "presmoothing of the frames, sigma in pixels", low=0, high=5)
    coarsest: float = option(0.5, "size of the first level to the frame", low=0.1, high=1)
    step: float = option(0.9, "size of a level to the next finer one", low=0.3, high=0.98)
    alpha: float = option(20.0, "weight of smoothness", low=0)
    delta: float = option(0.5, "weight of gray value constancy", low=0)
    gamma: float = option(6.0, "weight of gradient constancy", low=0)
    iterations: int = option(3, "fixed-point iterations at each level", low=1, high=100)
    relaxations: int = option(3, "SOR sweeps in each fixed-point iteration", low=1, high=100)

    def __call__(self, a: ByteArray, b: ByteArray) -> Float32Array:
        """Displacement of every pixel of `a`; see `kt3dmoseg.flow.base.Flow`."""
        check_pair(a, b)
        frames = [smooth(frame.astype(np.float32), self.smoothing) for frame in (a, b)]
        field = self._seed(*(np.rint(frame).astype(np.uint8) for frame in frames))
        solver = self._solver()
        for scale in self._scales():
            first, second = (_resize(frame, scale) for frame in frames)
            field = _resize_flow(field, first.shape)
            field = np.asarray(solver.calc(first, second, field), np.float32)
        return field

    def _seed(self, a: ByteArray, b: ByteArray) -> Float32Array:
        solver = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        return np.asarray(solver.calc(a, b, None), np.float32)  # type: ignore[call-overload]  # its stub forgets None

    def _solver(self) -> cv2.VariationalRefinement:
        solver = cv2.VariationalRefinement.create()
        solver.setAlpha(self.alpha)
        solver.setDelta(self.delta)
        solver.setGamma(self.gamma)
        solver.setFixedPointIterations(self.iterations)
        solver.setSorIterations(self.relaxations)
        return solver

    def _scales(self) -> list[float]:
        levels = int(np.ceil(np.log(self.coarsest) / np.log(self.step) - 1e-9))
        return [max(self.coarsest, self.step**level) for level in range(levels, -1, -1)]


def _resize(frame: Float32Array, scale: float) -> Float32Array:
    height, width = (max(1, round(side * scale)) for side in frame.shape)
    if (height, width) == frame.shape:
        return frame
    return np.asarray(cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def _resize_flow(field: Float32Array, shape: tuple[int, int]) -> Float32Array:
    if field.shape[:2] == shape:
        return field
    ratio = np.array([shape[1] / field.shape[1], shape[0] / field.shape[0]], np.float32)
    shrinks = shape[0] < field.shape[0]
    method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    resized = cv2.resize(field, (shape[1], shape[0]), interpolation=method)
    return np.asarray(resized * ratio, np.float32)
