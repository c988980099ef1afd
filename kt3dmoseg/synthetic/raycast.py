"""The flat faces that a scene is made of, boxes built from them, and the nearest hit of rays with them.

Coordinates are in metres: x right, y down, z forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from kt3dmoseg.synthetic.materials import Material
from kt3dmoseg.types import FloatArray, IntArray

NEAR = 0.1  # metres; nothing nearer to the camera is seen
SKY = -1  # "face" of a ray that hits nothing
_MARGIN = 1e-9  # rounding errors of projected corners
_RIGHT, _DOWN, _FORWARD = np.eye(3)


@dataclass(frozen=True, eq=False)
class Face:
    """A rectangle or symmetric or skew trapezoid in the coordinates of its body.

    It covers 0 <= v <= extent[1] and lean[0] v <= u <= extent[0] - lean[1] v.
    """

    origin: FloatArray  # (3,): the corner where u = v = 0
    eu: FloatArray  # (3,) unit vectors along u and v; cross(eu, ev) points out of the visible side
    ev: FloatArray
    extent: FloatArray  # (2,): length of the base along u, height along v
    material: Material
    lean: FloatArray = field(default_factory=lambda: np.zeros(2))  # of the two sides, inwards per metre of v
    body: int = 0  # 0 = static scene, k = k-th moving object


@dataclass(frozen=True)
class Skin:
    """Materials of a box: front (towards +z), back, the two long sides and the top."""

    front: Material
    back: Material
    side: Material
    top: Material


def box(
    low: Sequence[float],
    high: Sequence[float],
    skin: Skin | Material,
    inset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    underside: Material | None = None,
) -> list[Face]:
    """Give the faces of an axis-parallel box between two corners (y points down: `low[1]` is the top).

    The edges of the top (front, back, sides) lie `inset` inside those of the foot; an `underside` closes
    the foot, where it can be seen from below. On walls u runs to the right as seen from outside, v upwards.
    """
    (x0, y0, z0), (x1, y1, z1) = low, high
    front, back, sides = inset
    skin = skin if isinstance(skin, Skin) else Skin(skin, skin, skin, skin)
    across, along = x1 - x0, z1 - z0

    def wall(
        x: float, z: float, eu: FloatArray, base: float, inwards: FloatArray, setback: float,
        taper: tuple[float, float], material: Material,
    ) -> Face:  # fmt: skip
        slope = float(np.hypot(setback, y1 - y0))
        ev = (inwards * setback - _DOWN * (y1 - y0)) / slope
        extent = np.array([base, slope])
        return Face(np.array([x, y1, z]), eu, ev, extent, material, lean=np.array(taper) / slope)

    faces = [
        wall(x0, z0, _RIGHT, across, _FORWARD, back, (sides, sides), skin.back),
        wall(x1, z1, -_RIGHT, across, -_FORWARD, front, (sides, sides), skin.front),
        wall(x1, z0, _FORWARD, along, -_RIGHT, sides, (back, front), skin.side),
        wall(x0, z1, -_FORWARD, along, _RIGHT, sides, (front, back), skin.side),
    ]
    lid = np.array([across - 2 * sides, along - front - back])
    faces.append(Face(np.array([x0 + sides, y0, z0 + back]), _RIGHT, _FORWARD, lid, skin.top))
    if underside is not None:
        floor = np.array([along, across])
        faces.append(Face(np.array([x0, y1, z0]), _FORWARD, _RIGHT, floor, underside))
    return faces


def placed(faces: Sequence[Face], x: float, z: float, yaw: float) -> list[Face]:
    """Give the faces of a body that stays at a place in the world."""
    turn, shift = rotation_y(yaw), np.array([x, 0.0, z])
    return [replace(f, origin=turn @ f.origin + shift, eu=turn @ f.eu, ev=turn @ f.ev) for f in faces]


def rotation_y(angle: float) -> FloatArray:
    """Rotate about the vertical axis: +z towards +x for a positive angle."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


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
        names = ("origin", "eu", "ev", "extent", "lean", "body")
        return cls(*(np.array([getattr(face, name) for face in faces]) for name in names))

    def moved(self, poses: FloatArray) -> Mesh:
        """Give the mesh in other coordinates, by ``T_new_body`` (B, 4, 4) of every body."""
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


@dataclass(frozen=True, eq=False)
class Rays:
    """Directions (X, Y, 1) in camera coordinates.

    Of a grid, X (W,) of its columns and Y (H,) of its rows, ascending; else X and Y (R,) of single rays.
    """

    x: FloatArray
    y: FloatArray
    grid: bool

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W) or (R,)."""
        return (len(self.y), len(self.x)) if self.grid else self.x.shape

    def directions(self) -> tuple[FloatArray, FloatArray]:
        """X and Y of every ray, row by row, flat."""
        x, y = np.meshgrid(self.x, self.y) if self.grid else (self.x, self.y)
        return x.ravel(), y.ravel()

    def within(self, low: FloatArray, high: FloatArray) -> tuple[Any, FloatArray, FloatArray]:
        """Give (index into the results, X, Y) of the rays with low <= (X, Y) <= high."""
        (x0, y0), (x1, y1) = low, high
        if not self.grid:
            rows = np.flatnonzero((self.x >= x0) & (self.x <= x1) & (self.y >= y0) & (self.y <= y1))
            return rows, self.x[rows], self.y[rows]
        across = slice(np.searchsorted(self.x, x0), np.searchsorted(self.x, x1, "right"))
        down = slice(np.searchsorted(self.y, y0), np.searchsorted(self.y, y1, "right"))
        return (down, across), self.x[None, across], self.y[down, None]


def cast(mesh: Mesh, rays: Rays) -> tuple[FloatArray, IntArray]:
    """Find the nearest face along every ray.

    A ray r meets the plane of a face (corner o, normal n) at depth z = n.o / n.r; the hit counts where its
    coordinates on the face, (z r - o).eu and (z r - o).ev, are inside the extent. Both results have the
    shape of the rays: depth z, infinite where nothing is hit, and row of the mesh, or `SKY`.
    """
    depth, face = np.full(rays.shape, np.inf), np.full(rays.shape, SKY, dtype=np.int64)
    normal = np.cross(mesh.eu, mesh.ev)
    distance = np.einsum("fi,fi->f", normal, mesh.origin)
    corners = mesh.corners()
    (low, high), nearest = _bounds(corners), corners[..., 2].min(axis=1)
    first = rays.x.min(initial=np.inf), rays.y.min(initial=np.inf)
    last = rays.x.max(initial=-np.inf), rays.y.max(initial=-np.inf)
    rows = np.flatnonzero((distance < 0) & (low <= last).all(axis=1) & (high >= first).all(axis=1))
    for row in rows[np.argsort(nearest[rows], kind="stable")].tolist():
        where, x, y = rays.within(low[row], high[row])
        known = depth[where]
        if not known.size or known.max() < nearest[row]:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):  # rays parallel to the face
            z = distance[row] / _along(normal[row], x, y)
            u, v = surface_coordinates(mesh, row, x, y, z)
            (width, height), (left, right) = mesh.extent[row], mesh.lean[row]
            inside = (z > NEAR) & (z < known) & (v >= 0) & (v <= height)
            inside &= (u >= left * v) & (u <= width - right * v)
        depth[where] = np.where(inside, z, known)
        face[where] = np.where(inside, row, face[where])
    return depth, face


def surface_coordinates(
    mesh: Mesh, row: int, x: FloatArray, y: FloatArray, depth: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Metres along u and v of face `row` where the rays (x, y) at `depth` meet it."""
    eu, ev, origin = mesh.eu[row], mesh.ev[row], mesh.origin[row]
    return depth * _along(eu, x, y) - origin @ eu, depth * _along(ev, x, y) - origin @ ev


def footprint(
    mesh: Mesh, row: int, x: FloatArray, y: FloatArray, depth: FloatArray, spacing: float
) -> tuple[FloatArray, FloatArray]:
    """Metres along u and v of face `row` between neighbouring rays `spacing` apart in X and Y."""
    eu, ev = mesh.eu[row], mesh.ev[row]
    normal = np.cross(eu, ev)
    sizes = []
    for edge in (eu, ev):
        # With u = z (e.r) - o.e and z = n.o / n.r:  du/dX = z (e_x - (e.r) n_x / n.r), same for Y.
        along = _along(edge, x, y) / _along(normal, x, y)
        dx = depth * spacing * (edge[0] - along * normal[0])
        dy = depth * spacing * (edge[1] - along * normal[1])
        sizes.append(np.hypot(dx, dy))
    return sizes[0], sizes[1]


def _along(vector: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    product: FloatArray = vector[0] * x + (vector[1] * y + vector[2])
    return product


def _bounds(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest (X, Y) of the parts of quadrilaterals (F, 4, 3) in front of the camera.

    Where nothing is in front, lowest is +inf and highest -inf.
    """
    ahead = corners[..., 2] > NEAR
    following = np.roll(corners, -1, axis=1)
    crossing = ahead != np.roll(ahead, -1, axis=1)
    rise = np.where(crossing, following[..., 2] - corners[..., 2], 1.0)
    share = np.where(crossing, (NEAR - corners[..., 2]) / rise, 0.0)
    cut = corners + share[..., None] * (following - corners)
    points = np.concatenate([corners, cut], axis=1)
    counts = np.concatenate([ahead, crossing], axis=1)[..., None]
    flat = points[..., :2] / np.maximum(points[..., 2:], NEAR)
    low = np.where(counts, flat, np.inf).min(axis=1) - _MARGIN
    high = np.where(counts, flat, -np.inf).max(axis=1) + _MARGIN
    return low, high
