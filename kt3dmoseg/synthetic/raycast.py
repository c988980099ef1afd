"""Nearest hit of rays from a pinhole camera with the faces of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from kt3dmoseg.synthetic.surfaces import Mesh
from kt3dmoseg.types import BoolArray, FloatArray, IntArray

NEAR = 0.1  # metres; nothing nearer to the camera is seen
_MARGIN = 1e-9  # rounding errors of projected corners
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

    def extent(self) -> _Rectangle:
        """Smallest rectangle (x0, y0, x1, y1) that holds all rays."""
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

    def extent(self) -> _Rectangle:
        """Smallest rectangle (x0, y0, x1, y1) that holds all rays."""
        return float(self.columns[0]), float(self.rows[0]), float(self.columns[-1]), float(self.rows[-1])

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

    def extent(self) -> _Rectangle:
        """Smallest rectangle (x0, y0, x1, y1) that holds all rays; an empty one without rays."""
        if not len(self.x):
            return np.inf, np.inf, -np.inf, -np.inf
        return float(self.x.min()), float(self.y.min()), float(self.x.max()), float(self.y.max())

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
    for row, rectangle, nearest in _candidates(mesh, distance < 0, rays.extent()):
        where, x, y = rays.within(rectangle)
        known = depth[where]
        if not known.size or known.max() < nearest:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):  # rays parallel to the face
            z = distance[row] / _along(normal[row], x, y)
            inside = _meets(mesh, row, x, y, z)
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


def _candidates(mesh: Mesh, facing: BoolArray, extent: _Rectangle) -> list[tuple[int, _Rectangle, float]]:
    """Faces that show us their outside and may fall into `extent`, from near to far.

    Each with its rectangle in X, Y and its least depth.
    """
    corners = mesh.corners()
    low, high = _bounds(corners)
    nearest = corners[..., 2].min(axis=1)
    overlap = (low <= extent[2:]).all(axis=1) & (high >= extent[:2]).all(axis=1)
    rows = np.flatnonzero(facing & overlap)
    rows = rows[np.argsort(nearest[rows], kind="stable")]
    rectangles = np.hstack([low[rows], high[rows]]).tolist()
    return list(zip(rows.tolist(), map(tuple, rectangles), nearest[rows].tolist(), strict=True))


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
