"""How surfaces look: grey values as functions of metres on the surface and of the ray's footprint.

Every pattern is averaged over the footprint in closed form or from a rip-map, so that far surfaces fade to
their mean grey instead of flickering.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.types import Float32Array, FloatArray

SHADOW = 0.62  # brightness where the sun does not reach
_SIZE = 512
_LEVELS = 9  # 512 = 2**9: the coarsest level is one texel
_SHRINK = 0.5 ** np.arange(_LEVELS + 1)
_WIDTH = (_SIZE >> np.arange(_LEVELS + 1)).astype(np.int32)
_Index: TypeAlias = npt.NDArray[np.int32]


class Noise:
    """A periodic texture of mean 0 and standard deviation 1 with amplitude spectrum f**-slope.

    Kept as a rip-map: averaged separately in both directions by all powers of two, because a road seen
    from a car is squeezed far more along than across.
    """

    def __init__(self, rng: np.random.Generator, slope: float) -> None:
        frequency = np.hypot(*np.meshgrid(np.fft.rfftfreq(_SIZE), np.fft.fftfreq(_SIZE))) * _SIZE
        frequency[0, 0] = np.inf
        spectrum = np.fft.rfft2(rng.standard_normal((_SIZE, _SIZE))) * frequency**-slope
        field = np.fft.irfft2(spectrum, s=(_SIZE, _SIZE))
        tables, rows = [], field / field.std()
        for _ in _WIDTH:
            table = rows
            for _ in _WIDTH:
                tables.append(table.astype(np.float32).ravel())
                table = 0.5 * (table[:, ::2] + table[:, 1::2])
            rows = 0.5 * (rows[::2] + rows[1::2])
        start = np.cumsum([0, *(table.size for table in tables[:-1])], dtype=np.int32)
        self._start, self._flat = start.reshape(len(_WIDTH), -1), np.concatenate(tables)

    def sample(
        self, u: FloatArray, v: FloatArray, fu: FloatArray, fv: FloatArray, period: float
    ) -> Float32Array:
        """Noise (R,) at u, v, averaged over fu, fv; the pattern repeats after `period`; all in metres."""
        scale, flat = _SIZE / period, self._flat
        level_u, width, left, right, part_u = _texels(u * scale, fu * scale)
        level_v, _, low, high, part_v = _texels(v * scale, fv * scale)
        start = self._start.take(level_v * len(_WIDTH) + level_u)
        top, bottom = start + low * width, start + high * width
        upper = _mix(flat.take(top + left), flat.take(top + right), part_u)
        lower = _mix(flat.take(bottom + left), flat.take(bottom + right), part_u)
        return _mix(upper, lower, part_v)


def _texels(
    position: FloatArray, footprint: FloatArray
) -> tuple[_Index, _Index, _Index, _Index, Float32Array]:
    """Level, its width, the two neighbouring texels there, and the linear weight of the second."""
    # The level whose texels come nearest to the footprint: the rounded binary logarithm.
    level = np.frexp((np.sqrt(2) * footprint).astype(np.float32))[1] - 1
    level = np.minimum(np.maximum(level, 0), _LEVELS)
    inside = position * _SHRINK.take(level) - 0.5
    low = np.floor(inside)
    first, width = low.astype(np.int32), _WIDTH.take(level)
    mask = width - 1
    return level, width, first & mask, (first + 1) & mask, (inside - low).astype(np.float32)


def _mix(first: Float32Array, second: Float32Array, share: Float32Array) -> Float32Array:
    return np.asarray(first + share * (second - first))


class Patch(NamedTuple):
    """R positions on one face: metres along and up the face, the ray's footprint, the scene's noises."""

    u: FloatArray
    v: FloatArray
    fu: FloatArray
    fv: FloatArray
    grain: Noise
    cloud: Noise

    def noise(self, fine: float, coarse: float, salt: float) -> FloatArray:
        """Dirt: fine noise (4 m period) and coarse noise (31 m) with these standard deviations."""
        at = self.u + 3.7 * salt, self.v + 5.3 * salt, self.fu, self.fv
        return fine * self.grain.sample(*at, 4.1) + coarse * self.cloud.sample(*at, 31.0)


Material: TypeAlias = Callable[[Patch], FloatArray]
"""Grey values (R,) of a surface before lighting, about 0 to 255."""


@dataclass(frozen=True)
class Plain:
    """One grey with dirt: fine and coarse noise with these standard deviations."""

    grey: float
    fine: float = 6.0
    coarse: float = 8.0
    salt: float = 0.0

    def __call__(self, patch: Patch) -> FloatArray:
        """Shade a patch; see `Material`."""
        return self.grey + patch.noise(self.fine, self.coarse, self.salt)


def asphalt(
    patch: Patch,
    grey: float,
    lines: Sequence[tuple[float, float]],
    crossing: float,
    shade_edge: float,
    salt: float,
) -> FloatArray:
    """Shade a road along v with lane lines, tar patches and cracks.

    Lines are u of their middle and length of their dashes (0 = continuous); around v = `crossing`, the side
    street, there are none. `shade_edge` is u of the sunny kerb, where the houses' shadow is broadest.
    """
    u, v, fu, fv, grain, cloud = patch
    crack = np.exp(-((cloud.sample(u + 7, v, fu, fv, 13.0) / 0.06) ** 2)) / (1 + 40 * fv)
    bare = grey + patch.noise(9.0, 7.0, salt) - 30 * crack + _mosaic(patch, (2.3, 5.9), salt, _TAR)
    paint = np.zeros_like(u)
    for middle, dash in lines:
        line = band(u, middle - 0.07, middle + 0.07, fu)
        paint += line * (stripes(v, 3 * dash, 0.0, dash, fv) if dash else 1.0)
    straight = 1 - band(v, crossing - 5, crossing + 5, fv)
    worn = np.clip(0.85 + 0.12 * grain.sample(u, v, fu, fv, 2.0), 0, 1)
    roofs = patch._replace(u=np.zeros_like(v), fu=np.zeros_like(v))
    reach = shade_edge - 1.0 - 2.4 * _mosaic(roofs, (1.0, 7.1), salt + 5)
    dark = _above(u, reach, np.maximum(fu, 0.08)) * straight
    return np.asarray((bare + paint * straight * worn * (205 - bare)) * (1 - (1 - SHADOW) * dark))


def paving(patch: Patch, grey: float, slab: float, salt: float) -> FloatArray:
    """Shade square slabs with joints."""
    across = stripes(patch.u, slab, 0.0, 0.02, patch.fu)
    along = stripes(patch.v, slab, 0.0, 0.02, patch.fv)
    tone = 22 * (_mosaic(patch, (slab, slab), salt) - 0.5)
    return grey + patch.noise(6.0, 6.0, salt) + tone - 35 * (1 - (1 - across) * (1 - along))


def facade(rng: np.random.Generator) -> Material:
    """Make a house front: wall, ledges, rows of framed windows, a ground floor of larger ones."""
    plaster, pitch = rng.uniform(75, 190), rng.uniform(2.0, 3.2)
    width, height = rng.uniform(0.95, 1.4), rng.uniform(1.3, 1.8)
    storey, frame = rng.uniform(2.9, 3.6), float(rng.choice([55.0, 215.0, 235.0]))
    bricks, salt = float(rng.choice([0.0, 18.0, 30.0])), rng.uniform(0, 50)
    left, sill = 0.5 * (pitch - width), 0.32 * (storey - height) + 0.5

    def shade(patch: Patch) -> FloatArray:
        u, v, fu, fv, *_ = patch
        opening, surround = (
            stripes(u, pitch, left - bleed, width + 2 * bleed, fu)
            * stripes(v, storey, sill - bleed, height + 2 * bleed, fv)
            for bleed in (0.0, 0.14)
        )
        wall = plaster + patch.noise(7.0, 11.0, salt) - bricks * (stripes(v, 0.25, 0.0, 0.03, fv) - 0.12)
        wall += 28 * stripes(v, storey, 0.0, 0.22, fv) - 45 * band(v, 0.0, 0.7, fv)
        upright = stripes(u, pitch, left + width / 2 - 0.03, 0.06, fu)
        bars = 1 - (1 - upright) * (1 - stripes(v, storey, sill + 0.62 * height, 0.06, fv))
        room = _cells(u / pitch, v / storey, salt, _TABLE)
        # A curtain hangs from the top of the window down to a height of its room's.
        curtain = _above(np.mod(v, storey), (1 - room) / 0.8 * storey, fv)
        glass = 28 + 50 * room + 75 * curtain + patch.noise(5.0, 9.0, salt + 1)
        pane = glass + bars * (frame - glass)
        return wall * (1 - surround) + frame * (surround - opening) + pane * opening

    return shade


def foliage(patch: Patch, grey: float, salt: float) -> FloatArray:
    """Shade leaves: strong noise at all scales."""
    return grey * np.exp(np.clip(patch.noise(0.35, 0.5, salt), -1.5, 1.2))


def pillar(patch: Patch, grey: float, width: float, salt: float) -> FloatArray:
    """Shade a post, like a cylinder across its width."""
    across = np.clip(2 * patch.u / width - 1, -1, 1)
    ring = stripes(patch.v, 1.1, 0.4, 0.12, patch.fv)
    return grey * (1.1 - 0.45 * across**2) + patch.noise(9.0, 9.0, salt) + 35 * ring


class Mark(NamedTuple):
    """A filled rectangle, or the ellipse in it, painted on a surface: metres, grey."""

    u: tuple[float, float]
    v: tuple[float, float]
    grey: float
    round: bool = False

    def cover(self, patch: Patch) -> FloatArray:
        """Share of the footprint that is painted."""
        if not self.round:
            return band(patch.u, *self.u, patch.fu) * band(patch.v, *self.v, patch.fv)
        radius = 0.5 * (self.u[1] - self.u[0]), 0.5 * (self.v[1] - self.v[0])
        away = np.hypot((patch.u - np.mean(self.u)) / radius[0], (patch.v - np.mean(self.v)) / radius[1])
        return _above((1 - away) * min(radius), 0.0, np.hypot(patch.fu, patch.fv))


def painted(ground: Plain, marks: Sequence[Mark]) -> Material:
    """Make a plain surface with marks painted on it in order."""

    def shade(patch: Patch) -> FloatArray:
        grey, dirt = ground(patch), patch.noise(4.0, 5.0, ground.salt + 2)
        for mark in marks:
            grey = grey + mark.cover(patch) * (mark.grey + dirt - grey)
        return grey

    return shade


def block_letters(
    rng: np.random.Generator, u: Sequence[float], v: Sequence[float], rows: int, columns: int, grey: float
) -> list[Mark]:
    """Dark or light blocks scattered over a rectangle, like lettering on a van."""
    du, dv = (u[1] - u[0]) / columns, (v[1] - v[0]) / rows
    marks = []
    for row, column in np.ndindex(rows, columns):
        if rng.random() < 0.6:
            left, foot = u[0] + column * du, v[0] + row * dv
            size = rng.uniform(0.45, 0.95, 2)
            tone = grey + rng.uniform(-40, 40)
            marks.append(Mark((left, left + size[0] * du), (foot, foot + size[1] * dv), tone))
    return marks


def _above(x: FloatArray, edge: FloatArray | float, width: FloatArray) -> FloatArray:
    """Average the indicator of x > edge over an interval of `width` around x."""
    return np.minimum(np.maximum((x - edge) / np.maximum(width, 1e-9) + 0.5, 0), 1)


def band(x: FloatArray, low: float, high: float, width: FloatArray) -> FloatArray:
    """Average the indicator of [low, high] over an interval of `width` around x."""
    return _above(x, low, width) - _above(x, high, width)


def stripes(x: FloatArray, period: float, start: float, thickness: float, width: FloatArray) -> FloatArray:
    """Average the indicator of [start, start + thickness], repeated every `period`, over `width` around x."""
    width = np.maximum(width, 1e-9)

    def integral(at: FloatArray) -> FloatArray:
        turns = np.floor((at - start) / period)
        return turns * thickness + np.minimum(at - start - turns * period, thickness)

    return np.asarray((integral(x + width / 2) - integral(x - width / 2)) / width)


_ORDER = np.random.default_rng(20101).permutation(256)
_TABLE = np.random.default_rng(20102).permutation(256) / 256.0
_TAR = np.where(_TABLE > 0.8, -14.0, 9 * _TABLE)  # a fifth of the road is patched


def _mosaic(patch: Patch, size: tuple[float, float], salt: float, tones: FloatArray = _TABLE) -> FloatArray:
    """Average a mosaic of `size` rectangles, one tone each, over the footprint."""
    wide, high = patch.fu / size[0], patch.fv / size[1]
    left, right, part_u = _straddle(patch.u / size[0], wide)
    low, top, part_v = _straddle(patch.v / size[1], high)
    near, far = (
        _cells(left, row, salt, tones) * (1 - part_u) + _cells(right, row, salt, tones) * part_u
        for row in (low, top)
    )
    mean, seen = float(tones.mean()), near * (1 - part_v) + far * part_v
    return np.asarray(mean + (seen - mean) / (np.maximum(1, wide) * np.maximum(1, high)))


def _straddle(x: FloatArray, width: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Give the cells where an interval of at most one cell starts and ends, and the share of the second."""
    width = np.clip(width, 1e-9, 1)
    first, last = np.floor(x - width / 2), np.floor(x + width / 2)
    return first, last, np.where(last > first, (x + width / 2 - last) / width, 0.0)


def _cells(u: FloatArray, v: FloatArray, salt: float, tones: FloatArray) -> FloatArray:
    """Give every unit cell one of 256 tones, from a table as fixed as a hash function."""
    row = np.floor(v).astype(np.int64) * 57 + int(salt * 31)
    return np.asarray(tones[(np.floor(u).astype(np.int64) + _ORDER[row & 255]) & 255])
