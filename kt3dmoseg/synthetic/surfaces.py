"""The flat faces that a scene is made of, and boxes built from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kt3dmoseg.synthetic.materials import Material
from kt3dmoseg.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Face:
    """A rectangle in the coordinates of its body.

    Parameters
    ----------
    origin : (3,) float64
        The corner where u = v = 0, metres.
    eu, ev : (3,) float64
        Orthogonal unit vectors along u and v; ``cross(eu, ev)`` points out of the visible side.
    extent : (2,) float64
        Size along u and v, metres.
    material : Material
        How it looks.
    body : int
        0 = static scene, k = k-th moving object.
    """

    origin: FloatArray
    eu: FloatArray
    ev: FloatArray
    extent: FloatArray
    material: Material
    body: int = 0

    def corners(self) -> FloatArray:
        """Give the four corners in order, (4, 3)."""
        u, v = self.eu * self.extent[0], self.ev * self.extent[1]
        return np.stack([self.origin, self.origin + u, self.origin + u + v, self.origin + v])


@dataclass(frozen=True)
class Skin:
    """Materials of a box: front (towards +z), back, the two long sides and the top."""

    front: Material
    back: Material
    side: Material
    top: Material


def box(low: Sequence[float], high: Sequence[float], skin: Skin) -> list[Face]:
    """Faces of an axis-parallel box without its underside.

    Parameters
    ----------
    low, high : sequence of 3 float
        Smallest and largest x, y, z in metres (y points down: `low[1]` is the top).
    skin : Skin
        Materials. On walls u runs to the right as seen from outside and v upwards from the foot.
    """
    (x0, y0, z0), (x1, y1, z1) = low, high
    right, up, forward = np.eye(3)[0], -np.eye(3)[1], np.eye(3)[2]
    width, height, length = x1 - x0, y1 - y0, z1 - z0
    walls = [
        (np.array([x0, y1, z0]), right, width, skin.back),
        (np.array([x1, y1, z1]), -right, width, skin.front),
        (np.array([x1, y1, z0]), forward, length, skin.side),
        (np.array([x0, y1, z1]), -forward, length, skin.side),
    ]
    faces = [Face(o, along, up, np.array([size, height]), m) for o, along, size, m in walls]
    lid = Face(np.array([x0, y0, z0]), right, forward, np.array([width, length]), skin.top)
    return [*faces, lid]


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
    body: IntArray

    @classmethod
    def of(cls, faces: Sequence[Face]) -> Mesh:
        """Stack the geometry of `faces`."""
        return cls(
            np.stack([f.origin for f in faces]),
            np.stack([f.eu for f in faces]),
            np.stack([f.ev for f in faces]),
            np.stack([f.extent for f in faces]),
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
        return Mesh(turned[0] + shift, turned[1], turned[2], self.extent, self.body)
