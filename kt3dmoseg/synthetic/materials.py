"""How surfaces look: grey values as functions of metres on the surface and of the ray's footprint.

Every pattern is averaged over the footprint in closed form or from a rip-map, so that far surfaces fade to
their mean grey instead of flickering.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from kt3dmoseg.synthetic.noise import Noise
from kt3dmoseg.types import FloatArray

SHADOW = 0.62  # brightness where the sun does not reach


@dataclass(frozen=True, eq=False)
class Patch:
    """What a material needs to know of the places to shade: R positions on one face.

    Parameters
    ----------
    u, v : (R,) float64
        Metres along and up the face.
    fu, fv : (R,) float64
        Footprint of the ray in metres.
    grain, cloud : Noise
        The scene's fine and coarse noise.
    """

    u: FloatArray
    v: FloatArray
    fu: FloatArray
    fv: FloatArray
    grain: Noise
    cloud: Noise

    def noise(self, fine: float, coarse: float, salt: float) -> FloatArray:
        """Dirt: fine noise (4 m period) and coarse noise (31 m) with these standard deviations."""
        u, v = self.u + 3.7 * salt, self.v + 5.3 * salt
        return fine * self.grain.sample(u, v, self.fu, self.fv, 4.1) + coarse * self.cloud.sample(
            u, v, self.fu, self.fv, 31.0
        )


class Material(Protocol):
    """Grey values of a surface before lighting."""

    def shade(self, patch: Patch) -> FloatArray:
        """Grey values (R,), about 0 to 255."""
        ...


@dataclass(frozen=True)
class Plain:
    """One grey with dirt."""

    grey: float
    fine: float = 6.0
    coarse: float = 8.0
    salt: float = 0.0

    def shade(self, patch: Patch) -> FloatArray:
        """See `Material`."""
        return self.grey + patch.noise(self.fine, self.coarse, self.salt)


@dataclass(frozen=True)
class Asphalt:
    """A road along v with lane lines, tar patches and cracks."""

    grey: float
    lines: tuple[tuple[float, float], ...]  # (u of the middle, dash length; 0 = continuous)
    crossing: float  # v of the side street's middle: no lines there
    shade_edge: float  # u of the kerb on the side of the sun, where the houses' shadow is broadest
    salt: float

    def shade(self, patch: Patch) -> FloatArray:
        """See `Material`."""
        u, v = patch.u, patch.v
        shape = patch.cloud.sample(u + 7, v, patch.fu, patch.fv, 13.0)
        crack = np.exp(-((shape / 0.06) ** 2)) / (1 + 40 * patch.fv)
        tar = _mosaic(patch, (2.3, 5.9), self.salt, _TAR)
        grey = self.grey + patch.noise(9.0, 7.0, self.salt) - 30 * crack + tar
        paint = np.zeros_like(u)
        for middle, dash in self.lines:
            line = band(u, middle - 0.07, middle + 0.07, patch.fu)
            paint += line * (stripes(v, 3 * dash, 0.0, dash, patch.fv) if dash else 1.0)
        paint *= 1 - band(v, self.crossing - 5, self.crossing + 5, patch.fv)
        worn: FloatArray = np.clip(0.85 + 0.12 * patch.grain.sample(u, v, patch.fu, patch.fv, 2.0), 0, 1)
        roofs = replace(patch, u=np.zeros_like(v), fu=np.zeros_like(v))
        reach = self.shade_edge - 1.0 - 2.4 * _mosaic(roofs, (1.0, 7.1), self.salt + 5)
        dark = np.clip((u - reach) / np.maximum(patch.fu, 0.08) + 0.5, 0, 1)
        dark *= 1 - band(v, self.crossing - 5, self.crossing + 5, patch.fv)
        lit: FloatArray = (grey + paint * worn * (205 - grey)) * (1 - (1 - SHADOW) * dark)
        return lit


@dataclass(frozen=True)
class Paving:
    """Slabs with joints."""

    grey: float
    slab: float = 0.5
    salt: float = 0.0

    def shade(self, patch: Patch) -> FloatArray:
        """See `Material`."""
        joint = 1 - (1 - stripes(patch.u, self.slab, 0.0, 0.02, patch.fu)) * (
            1 - stripes(patch.v, self.slab, 0.0, 0.02, patch.fv)
        )
        tone = 22 * (_mosaic(patch, (self.slab, self.slab), self.salt) - 0.5)
        return self.grey + patch.noise(6.0, 6.0, self.salt) + tone - 35 * joint


@dataclass(frozen=True)
class Facade:
    """A house front: wall, ledges, rows of framed windows, a ground floor of larger ones."""

    wall: float
    pitch: float  # metres from window to window
    window: tuple[float, float]  # width, height
    storey: float
    frame: float
    bricks: float  # contrast of the courses
    salt: float

    def shade(self, patch: Patch) -> FloatArray:
        """See `Material`."""
        u, v, fu, fv = patch.u, patch.v, patch.fu, patch.fv
        width, height = self.window
        left, sill = 0.5 * (self.pitch - width), 0.32 * (self.storey - height) + 0.5
        course = stripes(v, 0.25, 0.0, 0.03, fv) - 0.12
        wall = self.wall + patch.noise(7.0, 11.0, self.salt) - self.bricks * course
        wall += 28 * stripes(v, self.storey, 0.0, 0.22, fv) - 45 * band(v, 0.0, 0.7, fv)
        opening = stripes(u, self.pitch, left, width, fu) * stripes(v, self.storey, sill, height, fv)
        surround = stripes(u, self.pitch, left - 0.14, width + 0.28, fu) * stripes(
            v, self.storey, sill - 0.14, height + 0.28, fv
        )
        bars = 1 - (1 - stripes(u, self.pitch, left + width / 2 - 0.03, 0.06, fu)) * (
            1 - stripes(v, self.storey, sill + 0.62 * height, 0.06, fv)
        )
        room = _cells(u / self.pitch, v / self.storey, self.salt, _TABLE)
        hem = (1 - room) / 0.8 * self.storey  # a curtain hangs from the top of the window down to here
        curtain = np.clip((np.mod(v, self.storey) - hem) / np.maximum(fv, 1e-9) + 0.5, 0, 1)
        glass = 28 + 50 * room + 75 * curtain + patch.noise(5.0, 9.0, self.salt + 1)
        pane = glass + bars * (self.frame - glass)
        return wall * (1 - surround) + self.frame * (surround - opening) + pane * opening


@dataclass(frozen=True)
class Mark:
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
        across, up = patch.u - np.mean(self.u), patch.v - np.mean(self.v)
        gap = (1 - np.hypot(across / radius[0], up / radius[1])) * min(radius)
        return np.clip(gap / np.maximum(np.hypot(patch.fu, patch.fv), 1e-9) + 0.5, 0, 1)


@dataclass(frozen=True)
class Painted:
    """A plain surface with marks painted on it in order."""

    ground: Plain
    marks: tuple[Mark, ...] = ()

    def shade(self, patch: Patch) -> FloatArray:
        """See `Material`."""
        grey = self.ground.shade(patch)
        dirt = patch.noise(4.0, 5.0, self.ground.salt + 2)
        for mark in self.marks:
            grey = grey + mark.cover(patch) * (mark.grey + dirt - grey)
        return grey


@dataclass(frozen=True)
class Foliage:
    """Leaves: strong noise at all scales."""

    grey: float
    salt: float

    def shade(self, patch: Patch) -> FloatArray:
        """See `Material`."""
        return self.grey * np.exp(np.clip(patch.noise(0.35, 0.5, self.salt), -1.5, 1.2))


@dataclass(frozen=True)
class Pillar:
    """A post, shaded like a cylinder across its width."""

    grey: float
    width: float
    salt: float = 0.0

    def shade(self, patch: Patch) -> FloatArray:
        """See `Material`."""
        across = np.clip(2 * patch.u / self.width - 1, -1, 1)
        ring = stripes(patch.v, 1.1, 0.4, 0.12, patch.fv)
        return self.grey * (1.1 - 0.45 * across**2) + patch.noise(9.0, 9.0, self.salt) + 35 * ring


def band(x: FloatArray, low: float, high: float, width: FloatArray) -> FloatArray:
    """Average the indicator of [low, high] over an interval of `width` around x."""
    width = np.maximum(width, 1e-9)
    share: FloatArray = np.clip((x - low) / width + 0.5, 0, 1) - np.clip((x - high) / width + 0.5, 0, 1)
    return share


def stripes(x: FloatArray, period: float, start: float, thickness: float, width: FloatArray) -> FloatArray:
    """Average the indicator of [start, start + thickness], repeated every `period`, over `width` around x."""
    width = np.maximum(width, 1e-9)

    def integral(at: FloatArray) -> FloatArray:
        turns = np.floor((at - start) / period)
        return turns * thickness + np.minimum(at - start - turns * period, thickness)

    share: FloatArray = (integral(x + width / 2) - integral(x - width / 2)) / width
    return share


def _mosaic(
    patch: Patch, size: tuple[float, float], salt: float, tones: FloatArray | None = None
) -> FloatArray:
    """Average a mosaic of `size` rectangles, one tone each, over the footprint."""
    (u0, u1, part_u), (v0, v1, part_v) = (
        _straddle(x / side, width / side)
        for x, width, side in ((patch.u, patch.fu, size[0]), (patch.v, patch.fv, size[1]))
    )
    tones = _TABLE if tones is None else tones
    near = _cells(u0, v0, salt, tones) * (1 - part_u) + _cells(u1, v0, salt, tones) * part_u
    far = _cells(u0, v1, salt, tones) * (1 - part_u) + _cells(u1, v1, salt, tones) * part_u
    mean = float(tones.mean())
    seen = mean + (near * (1 - part_v) + far * part_v - mean) / (
        np.maximum(1, patch.fu / size[0]) * np.maximum(1, patch.fv / size[1])
    )
    return np.asarray(seen)


def _straddle(x: FloatArray, width: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Give the cells where an interval of at most one cell starts and ends, and the share of the second."""
    width = np.clip(width, 1e-9, 1)
    first, last = np.floor(x - width / 2), np.floor(x + width / 2)
    return first, last, np.where(last > first, (x + width / 2 - last) / width, 0.0)


def _cells(u: FloatArray, v: FloatArray, salt: float, tones: FloatArray) -> FloatArray:
    """Give every unit cell one of 256 tones, from a table as fixed as a hash function."""
    row = np.floor(v).astype(np.int64) * 57 + int(salt * 31)
    tone: FloatArray = tones[(np.floor(u).astype(np.int64) + _ORDER[row & 255]) & 255]
    return tone


_ORDER = np.random.default_rng(20101).permutation(256)
_TABLE = np.random.default_rng(20102).permutation(256) / 256.0
_TAR = np.where(_TABLE > 0.8, -14.0, 9 * _TABLE)  # a fifth of the road is patched


def block_letters(
    rng: np.random.Generator, u: Sequence[float], v: Sequence[float], rows: int, columns: int, grey: float
) -> tuple[Mark, ...]:
    """Dark or light blocks scattered over a rectangle, like lettering on a van."""
    du, dv = (u[1] - u[0]) / columns, (v[1] - v[0]) / rows
    marks = []
    for row, column in np.ndindex(rows, columns):
        if rng.random() < 0.6:
            left, foot = u[0] + column * du, v[0] + row * dv
            size = rng.uniform(0.45, 0.95, 2)
            tone = grey + float(rng.uniform(-40, 40))
            marks.append(Mark((left, left + size[0] * du), (foot, foot + size[1] * dv), tone))
    return tuple(marks)
