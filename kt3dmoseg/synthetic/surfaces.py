"""The flat faces that a scene is made of, and boxes built from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from kt3dmoseg.synthetic.materials import Material
from kt3dmoseg.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Face:
    """A rectangle or symmetric or skew trapezoid in the coordinates of its body.

    It covers 0 <= v <= extent[1] and lean[0] v <= u <= extent[0] - lean[1] v.

    Parameters
    ----------
    origin : (3,) float64
        The corner where u = v = 0, metres.
    eu, ev : (3,) float64
        Orthogonal unit vectors along u and v; ``cross(eu, ev)`` points out of the visible side.
    extent : (2,) float64
        Length of the base along u and height along v, metres.
    material : Material
        How it looks.
    lean : (2,) float64, optional
        How much the two sides lean inwards per metre of v; 0 for a rectangle.
    body : int
        0 = static scene, k = k-th moving object.
    """

    origin: FloatArray
    eu: FloatArray
    ev: FloatArray
    extent: FloatArray
    material: Material
    lean: FloatArray = field(default_factory=lambda: np.zeros(2))
    body: int = 0


@dataclass(frozen=True)
class Skin:
    """Materials of a box: front (towards +z), back, the two long sides and the top."""

    front: Material
    back: Material
    side: Material
    top: Material

    @classmethod
    def all(cls, material: Material) -> Skin:
        """Give all sides the same material."""
        return cls(material, material, material, material)


def box(low: Sequence[float], high: Sequence[float], skin: Skin) -> list[Face]:
    """Give the faces of an axis-parallel box without its underside; see `frustum`."""
    return frustum(low, high, skin, (0.0, 0.0, 0.0))


def frustum(
    low: Sequence[float],
    high: Sequence[float],
    skin: Skin,
    inset: tuple[float, float, float],
    underside: Material | None = None,
) -> list[Face]:
    """Give the faces of a box whose top is smaller (or larger) than its foot.

    Parameters
    ----------
    low, high : sequence of 3 float
        Smallest and largest x, y, z of the foot, in metres (y points down: `low[1]` is the top).
    skin : Skin
        Materials. On walls u runs to the right as seen from outside and v upwards from the foot.
    inset : (front, back, sides)
        How far the edges of the top lie inside those of the foot, metres.
    underside : Material, optional
        Closes the foot, where it can be seen from below.
    """
    (x0, y0, z0), (x1, y1, z1) = low, high
    front, back, sides = inset
    across, along, size = x1 - x0, z1 - z0, y1 - y0
    faces = [
        _wall((x0, y1, z0), _RIGHT, across, (_FORWARD, back, size), (sides, sides), skin.back),
        _wall((x1, y1, z1), -_RIGHT, across, (-_FORWARD, front, size), (sides, sides), skin.front),
        _wall((x1, y1, z0), _FORWARD, along, (-_RIGHT, sides, size), (back, front), skin.side),
        _wall((x0, y1, z1), -_FORWARD, along, (_RIGHT, sides, size), (front, back), skin.side),
    ]
    lid = np.array([across - 2 * sides, along - front - back])
    faces.append(Face(np.array([x0 + sides, y0, z0 + back]), _RIGHT, _FORWARD, lid, skin.top))
    if underside is not None:
        floor = np.array([along, across])
        faces.append(Face(np.array([x0, y1, z0]), _FORWARD, _RIGHT, floor, underside))
    return faces


def _wall(
    origin: tuple[float, float, float],
    eu: FloatArray,
    base: float,
    rise: tuple[FloatArray, float, float],
    taper: tuple[float, float],
    material: Material,
) -> Face:
    inwards, setback, height = rise
    slope = float(np.hypot(setback, height))
    ev = (inwards * setback - _DOWN * height) / slope
    return Face(np.array(origin), eu, ev, np.array([base, slope]), material, lean=np.array(taper) / slope)


_RIGHT, _DOWN, _FORWARD = np.eye(3)


def on_body(faces: Sequence[Face], body: int) -> list[Face]:
    """Give the same faces as part of moving object `body`."""
    return [replace(face, body=body) for face in faces]


@dataclass(frozen=True, eq=False)
class Mesh:
    """All faces of a scene as arrays over faces, for fast transformation."""

    origin: FloatArray
    eu: FloatArray
    ev: FloatArray
    extent: FloatArray
    lean: FloatArray
    body: IntArray

    @classmethod
    def of(cls, faces: Sequence[Face]) -> Mesh:
        """Stack the geometry of `faces`."""
        return cls(
            np.stack([f.origin for f in faces]),
            np.stack([f.eu for f in faces]),
            np.stack([f.ev for f in faces]),
            np.stack([f.extent for f in faces]),
            np.stack([f.lean for f in faces]),
            np.array([f.body for f in faces], dtype=np.int64),
        )

    def moved(self, poses: FloatArray) -> Mesh:
        """Give the mesh in other coordinates.

        Parameters
        ----------
        poses : (B, 4, 4) float64
            ``T_new_body`` for every body, the static scene first.
        """
        rotation, shift = poses[self.body, :3, :3], poses[self.body, :3, 3]
        turned = [np.einsum("fij,fj->fi", rotation, part) for part in (self.origin, self.eu, self.ev)]
        return Mesh(turned[0] + shift, turned[1], turned[2], self.extent, self.lean, self.body)

    def corners(self) -> FloatArray:
        """Corners of all faces in order, (F, 4, 3)."""
        (width, height), (left, right) = self.extent.T, (self.lean * self.extent[:, 1:]).T
        u = np.stack([0 * width, width, width - right, left], axis=1)
        v = np.stack([0 * height, 0 * height, height, height], axis=1)
        across, up = u[..., None] * self.eu[:, None], v[..., None] * self.ev[:, None]
        corners: FloatArray = self.origin[:, None] + across + up
        return corners
