"""Periodic fractal noise that can be sampled at any scale without aliasing."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kt3dmoseg.types import Float32Array, FloatArray

_SIZE = 512
_LEVELS = 9  # 512 = 2**9: the coarsest level is one texel


class Noise:
    """A periodic texture of mean 0 and standard deviation 1 with amplitude spectrum f**-slope.

    Kept as a rip-map: averaged separately in both directions by all powers of two, because a road seen
    from a car is squeezed far more along than across.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the pattern.
    slope : float
        0 is white; 1 is close to natural images.
    """

    def __init__(self, rng: np.random.Generator, slope: float) -> None:
        frequency = np.hypot(*np.meshgrid(np.fft.rfftfreq(_SIZE), np.fft.fftfreq(_SIZE))) * _SIZE
        frequency[0, 0] = np.inf
        spectrum = np.fft.rfft2(rng.standard_normal((_SIZE, _SIZE))) * frequency**-slope
        field = np.fft.irfft2(spectrum, s=(_SIZE, _SIZE))
        tables: list[Float32Array] = []
        self._offset = np.zeros((_LEVELS + 1, _LEVELS + 1), dtype=np.int32)
        rows = field / field.std()
        for v in range(_LEVELS + 1):
            table = rows
            for u in range(_LEVELS + 1):
                self._offset[v, u] = sum(t.size for t in tables)
                tables.append(table.astype(np.float32).ravel())
                table = 0.5 * (table[:, ::2] + table[:, 1::2]) if u < _LEVELS else table
            rows = 0.5 * (rows[::2] + rows[1::2]) if v < _LEVELS else rows
        self._flat = np.concatenate(tables)

    def sample(
        self, u: FloatArray, v: FloatArray, fu: FloatArray, fv: FloatArray, period: float
    ) -> Float32Array:
        """Noise at surface positions, averaged over the footprint of a ray.

        Parameters
        ----------
        u, v : (R,) float64
            Positions in metres.
        fu, fv : (R,) float64
            Extent of the ray's footprint in metres.
        period : float
            Metres after which the pattern repeats.

        Returns
        -------
        (R,) float32
        """
        scale = _SIZE / period
        level_u, low_u, high_u, part_u = _cells(u * scale, fu * scale)
        level_v, low_v, high_v, part_v = _cells(v * scale, fv * scale)
        start, width = self._offset[level_v, level_u], _WIDTH[level_u]
        top, bottom = start + low_v * width, start + high_v * width
        flat = self._flat
        upper = _mix(flat.take(top + low_u), flat.take(top + high_u), part_u)
        lower = _mix(flat.take(bottom + low_u), flat.take(bottom + high_u), part_u)
        return _mix(upper, lower, part_v)


_Index = npt.NDArray[np.int32]
_SHRINK = (0.5 ** np.arange(_LEVELS + 1)).astype(np.float64)
_WIDTH = (_SIZE >> np.arange(_LEVELS + 1)).astype(np.int32)


def _cells(position: FloatArray, footprint: FloatArray) -> tuple[_Index, _Index, _Index, Float32Array]:
    """Level, the two neighbouring cells there, and the linear weight of the second."""
    # The level whose cells come nearest to the footprint: the rounded binary logarithm.
    level = np.clip(np.frexp((np.sqrt(2) * footprint).astype(np.float32))[1] - 1, 0, _LEVELS)
    inside = position * _SHRINK[level] - 0.5
    low = np.floor(inside)
    part = (inside - low).astype(np.float32)
    first, mask = low.astype(np.int32), _WIDTH[level] - 1
    return level, first & mask, (first + 1) & mask, part


def _mix(first: Float32Array, second: Float32Array, share: Float32Array) -> Float32Array:
    mixed: Float32Array = first + share * (second - first)
    return mixed
