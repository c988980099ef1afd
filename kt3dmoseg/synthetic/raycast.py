"""Nearest hit of rays from a pinhole camera with the faces of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from kt3dmoseg.synthetic.surfaces import Mesh
from kt3dmoseg.types import BoolArray, FloatArray, IntArray

NEAR = 0.1  # metres; nothing nearer to the camera is seen
SKY = -1  # "face" of a ray that hits nothing

_Rectangle = tuple[float, float, float, float]


class Rays(Protocol):
    """Directions (X, Y, 1) in camera coordinates, and which of them fall into a rectangle."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the results."""
        ...

    def directions(self) -> tuple[FloatArray, FloatArray]:
        """X and Y of every ray, flat."""
        ...

    def within(self, rectangle: _Rectangle) -> tuple[Any, FloatArray, FloatArray]:
        """Give (index into the results, X, Y) of the rays with x0 <= X <= x1 and y0 <= Y <= y1."""
        ...


@dataclass(frozen=True, eq=False)
class Grid:
    """Rays through a regular grid: ascending X of the columns (W,), Y of the rows (H,)."""

    columns: FloatArray
    rows: FloatArray

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W)."""
        return len(self.rows), len(self.columns)

    def directions(self) -> tuple[FloatArray, FloatArray]:
        """X and Y of every ray, row by row, (H W,)."""
        x, y = np.meshgrid(self.columns, self.rows)
        return x.ravel(), y.ravel()

    def within(self, rectangle: _Rectangle) -> tuple[Any, FloatArray, FloatArray]:
        """Give a pair of slices, X (1, w) and Y (h, 1)."""
        x0, y0, x1, y1 = rectangle
        across = slice(np.searchsorted(self.columns, x0), np.searchsorted(self.columns, x1, "right"))
        down = slice(np.searchsorted(self.rows, y0), np.searchsorted(self.rows, y1, "right"))
        return (down, across), self.columns[None, across], self.rows[down, None]


@dataclass(frozen=True, eq=False)
class Points:
    """Single rays: X (R,), Y (R,)."""

    x: FloatArray
    y: FloatArray

    @property
    def shape(self) -> tuple[int, ...]:
        """(R,)."""
        return self.x.shape

    def directions(self) -> tuple[FloatArray, FloatArray]:
        """X and Y of every ray, (R,)."""
        return self.x, self.y

    def within(self, rectangle: _Rectangle) -> tuple[Any, FloatArray, FloatArray]:
        """Give row numbers, X and Y."""
        x0, y0, x1, y1 = rectangle
        rows = np.flatnonzero((self.x >= x0) & (self.x <= x1) & (self.y >= y0) & (self.y <= y1))
        return rows, self.x[rows], self.y[rows]


def cast(mesh: Mesh, rays: Rays) -> tuple[FloatArray, IntArray]:
    """Find the nearest face along every ray.

    A ray r meets the plane of a face (corner o, normal n) at depth z = n.o / n.r; the hit counts where its
    coordinates on the face, (z r - o).eu and (z r - o).ev, are inside the extent.

    Parameters
    ----------
    mesh : Mesh
        Faces in camera coordinates.
    rays : Rays
        Directions.

    Returns
    -------
    depth : float64, shape of the rays
        z in metres; infinite where nothing is hit.
    face : int64, shape of the rays
        Row of the mesh, or `SKY`.
    """
    depth = np.full(rays.shape, np.inf)
    face = np.full(rays.shape, SKY, dtype=np.int64)
    normal = np.cross(mesh.eu, mesh.ev)
    distance = np.einsum("fi,fi->f", normal, mesh.origin)
    for row in np.flatnonzero(distance < 0).tolist():  # the others show us their back
        rectangle = _bounds(mesh, row)
        if rectangle is None:
            continue
        where, x, y = rays.within(rectangle)
        with np.errstate(divide="ignore", invalid="ignore"):  # rays parallel to the face
            z = distance[row] / _along(normal[row], x, y)
            inside = _meets(mesh, row, x, y, z)
        known = depth[where]
        inside &= z < known
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


def _meets(mesh: Mesh, row: int, x: FloatArray, y: FloatArray, z: FloatArray) -> BoolArray:
    u, v = surface_coordinates(mesh, row, x, y, z)
    (width, height), (left, right) = mesh.extent[row], mesh.lean[row]
    inside: BoolArray = (z > NEAR) & (v >= 0) & (v <= height) & (u >= left * v) & (u <= width - right * v)
    return inside


def _bounds(mesh: Mesh, row: int) -> _Rectangle | None:
    """Rectangle in X, Y around the part of a face in front of the camera; None when there is none."""
    corners = mesh.corners(row)
    ahead = corners[:, 2] > NEAR
    following = np.roll(corners, -1, axis=0)
    crossing = ahead != np.roll(ahead, -1)
    share = (NEAR - corners[crossing, 2]) / (following[crossing, 2] - corners[crossing, 2])
    cut = corners[crossing] + share[:, None] * (following[crossing] - corners[crossing])
    seen = np.concatenate([corners[ahead], cut])
    if not len(seen):
        return None
    flat = seen[:, :2] / np.maximum(seen[:, 2:], NEAR)
    (x0, y0), (x1, y1) = flat.min(axis=0) - 1e-9, flat.max(axis=0) + 1e-9
    return float(x0), float(y0), float(x1), float(y1)
