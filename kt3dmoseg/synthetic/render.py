"""From flat faces to grey values: boxes, the nearest hit of rays, light, pixels that gather it, the camera.

Coordinates are in metres: x right, y down, z forward.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from kt3dmoseg.synthetic.materials import Material, Noise, Patch
from kt3dmoseg.types import ByteArray, FloatArray, IntArray

NEAR = 0.1  # metres; nothing nearer to the camera is seen
SKY = -1  # "face" of a ray that hits nothing
_MARGIN = 1e-9  # rounding errors of projected corners
_RIGHT, _DOWN, _FORWARD = np.eye(3)
_SUN = np.array([0.45, -0.8, -0.4]) / np.linalg.norm([0.45, -0.8, -0.4])  # towards the sun
_AMBIENT, _DIRECT = 0.6, 0.5
_GAIN, _GAMMA, _WHITE = 1.25, 1.4, 255.0


class Face(NamedTuple):
    """A trapezoid, 0 <= v <= extent[1] and lean[0] v <= u <= extent[0] - lean[1] v, in a body's coordinates.

    In metres from `origin` along unit vectors `eu` and `ev`; cross(eu, ev) points out of the visible side.
    """

    material: Material
    origin: FloatArray
    eu: FloatArray
    ev: FloatArray
    extent: tuple[float, float]
    lean: tuple[float, float] = (0.0, 0.0)
    body: int = 0  # 0 = static scene, k = k-th moving object


def box(
    low: Sequence[float],
    high: Sequence[float],
    material: Material,
    inset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    **parts: Material,
) -> list[Face]:
    """Give the faces of a box between two corners, whose top's edges (front, back, sides) lie `inset` inside.

    `parts` are other materials of its front (towards +z), back, side (both), top, and floor, which it else
    lacks. On walls u runs to the right as seen from outside, v upwards.
    """
    (x0, y0, z0), (x1, y1, z1) = low, high
    front, back, sides = inset
    across, along, height = x1 - x0, z1 - z0, y1 - y0
    walls = [
        ("back", x0, z0, _RIGHT, across, _FORWARD, back, (sides, sides)),
        ("front", x1, z1, -_RIGHT, across, -_FORWARD, front, (sides, sides)),
        ("side", x1, z0, _FORWARD, along, -_RIGHT, sides, (back, front)),
        ("side", x0, z1, -_FORWARD, along, _RIGHT, sides, (front, back)),
    ]
    faces = []
    for part, x, z, eu, base, inwards, setback, (left, right) in walls:
        slope = float(np.hypot(setback, height))
        ev, lean = (inwards * setback - _DOWN * height) / slope, (left / slope, right / slope)
        faces.append(Face(parts.get(part, material), np.array([x, y1, z]), eu, ev, (base, slope), lean))
    corner, lid = np.array([x0 + sides, y0, z0 + back]), (across - 2 * sides, along - front - back)
    faces.append(Face(parts.get("top", material), corner, _RIGHT, _FORWARD, lid))
    if "floor" in parts:
        faces.append(Face(parts["floor"], np.array([x0, y1, z0]), _FORWARD, _RIGHT, (along, across)))
    return faces


def placed(faces: Sequence[Face], x: float, z: float, yaw: float) -> list[Face]:
    """Give the faces of a body that stays at a place in the world."""
    turn, shift = rotation(1, yaw), np.array([x, 0.0, z])
    return [f._replace(origin=turn @ f.origin + shift, eu=turn @ f.eu, ev=turn @ f.ev) for f in faces]


def rotation(axis: int, angle: float) -> FloatArray:
    """Rotate about x, y or z; about the vertical axis, y, a positive angle turns +z towards +x."""
    turn, (i, j) = np.eye(3), ((axis + 1) % 3, (axis + 2) % 3)
    turn[i, i] = turn[j, j] = np.cos(angle)
    turn[j, i], turn[i, j] = np.sin(angle), -np.sin(angle)
    return turn


class Mesh(NamedTuple):
    """The geometry of F faces, as arrays over them; see `Face`."""

    origin: FloatArray
    eu: FloatArray
    ev: FloatArray
    extent: FloatArray
    lean: FloatArray
    body: IntArray

    @classmethod
    def of(cls, faces: Sequence[Face]) -> Mesh:
        """Stack the geometry of `faces`."""
        return cls(*(np.array(column) for column in list(zip(*faces, strict=True))[1:]))

    def moved(self, poses: FloatArray) -> Mesh:
        """Give the mesh in other coordinates, by ``T_new_body`` (B, 4, 4) of every body."""
        rotation, shift = poses[self.body, :3, :3], poses[self.body, :3, 3]
        origin, eu, ev = (np.einsum("fij,fj->fi", rotation, part) for part in self[:3])
        return Mesh(origin + shift, eu, ev, *self[3:])

    def normals(self) -> FloatArray:
        """Return unit vectors (F, 3) out of the visible sides."""
        return np.cross(self.eu, self.ev)

    def corners(self) -> FloatArray:
        """Corners of all faces in order, (F, 4, 3)."""
        (width, height), (left, right) = self.extent.T, (self.lean * self.extent[:, 1:]).T
        u = np.stack([0 * width, width, width - right, left], axis=1)
        v = np.stack([0 * height, 0 * height, height, height], axis=1)
        across, up = u[..., None] * self.eu[:, None], v[..., None] * self.ev[:, None]
        return np.asarray(self.origin[:, None] + across + up)

    def surface(self, row: int, x: FloatArray, y: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Metres along u and v of a face where rays (x, y, 1) meet it at depth z."""
        eu, ev, origin = self.eu[row], self.ev[row], self.origin[row]
        return z * _along(eu, x, y) - origin @ eu, z * _along(ev, x, y) - origin @ ev

    def surfaces(
        self, rows: IntArray, x: FloatArray, y: FloatArray, z: FloatArray, spacing: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Where rays (x, y, 1) meet their faces at depth z, and how large a ray is there.

        Faces come in `rows`, equal ones together. Returns metres along u and v of the face, and metres along
        both between neighbouring rays `spacing` apart in X and Y.
        """
        starts = np.flatnonzero(np.diff(rows, prepend=SKY))
        faces, counts = rows[starts], np.diff(starts, append=rows.size)
        normal = self.normals()[faces].T.repeat(counts, axis=1)
        over = spacing * z
        facing = _along(normal, x, y)
        places, sizes = [], []
        for edges in (self.eu[faces], self.ev[faces]):
            edge = edges.T.repeat(counts, axis=1)
            along = _along(edge, x, y)
            shift = [origin @ one for origin, one in zip(self.origin[faces], edges, strict=True)]
            places.append(z * along - np.repeat(shift, counts))
            # With u = z (e.r) - o.e and z = n.o / n.r:  du/dX = z (e_x - (e.r) n_x / n.r), same for Y.
            share = along / facing
            sizes.append(np.hypot(*(over * (edge[k] - share * normal[k]) for k in (0, 1))))
        return *places, *sizes


def _along(vector: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    return np.asarray(vector[0] * x + (vector[1] * y + vector[2]))


def cast(mesh: Mesh, x: FloatArray, y: FloatArray) -> tuple[FloatArray, IntArray]:
    """Find the nearest face along every ray (x, y, 1): single ones (R,), or a grid of (1, W) and (H, 1).

    A ray r meets the plane of a face (corner o, normal n) at depth z = n.o / n.r. Returns, (R,) or (H, W),
    the depth z, infinite where nothing is hit, and the row of the mesh, or `SKY`.
    """
    shape = np.broadcast_shapes(x.shape, y.shape)
    depth, face = np.full(shape, np.inf), np.full(shape, SKY, dtype=np.int64)
    normal = mesh.normals()
    distance = np.einsum("fi,fi->f", normal, mesh.origin)
    low, high, nearest = _bounds(mesh)
    first, last = (
        (x.min(initial=np.inf), y.min(initial=np.inf)),
        (x.max(initial=-np.inf), y.max(initial=-np.inf)),
    )
    rows = np.flatnonzero((distance < 0) & (low <= last).all(axis=1) & (high >= first).all(axis=1))
    rows = rows[np.argsort(nearest[rows], kind="stable")]
    for row, (where, x_in, y_in) in zip(rows.tolist(), _within(x, y, low[rows], high[rows]), strict=True):
        known = depth[where]
        if not known.size or known.max() < nearest[row]:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):  # rays parallel to the face
            z = distance[row] / _along(normal[row], x_in, y_in)
            u, v = mesh.surface(row, x_in, y_in, z)
            (width, height), (left, right) = mesh.extent[row], mesh.lean[row]
            inside = (z > NEAR) & (z < known) & (v >= 0) & (v <= height)
            inside &= (u >= left * v) & (u <= width - right * v)
        depth[where] = np.where(inside, z, known)
        face[where] = np.where(inside, row, face[where])
    return depth, face


def _within(
    x: FloatArray, y: FloatArray, low: FloatArray, high: FloatArray
) -> Iterator[tuple[Any, FloatArray, FloatArray]]:
    """Give (index into the results, X, Y) of the rays in each box low <= (X, Y) <= high, (F, 2).

    Those of a grid ascend.
    """
    if x.ndim == 1:
        for (left, top), (right, bottom) in zip(low, high, strict=True):
            rows = np.flatnonzero((x >= left) & (x <= right) & (y >= top) & (y <= bottom))
            yield rows, x[rows], y[rows]
        return
    sides = [
        (np.searchsorted(side.ravel(), first), np.searchsorted(side.ravel(), last, "right"))
        for side, first, last in zip((x, y), low.T, high.T, strict=True)
    ]
    for left, right, top, bottom in np.array(sides).reshape(4, -1).T.tolist():
        across, down = slice(left, right), slice(top, bottom)
        yield (down, across), x[:, across], y[down]


def _bounds(mesh: Mesh) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Lowest and highest (X, Y), (F, 2), of what is in front of the camera, and smallest depth (F,).

    Where nothing is in front, lowest is +inf and highest -inf.
    """
    corners = mesh.corners()
    ahead, following = corners[..., 2] > NEAR, np.roll(corners, -1, axis=1)
    crossing = ahead != np.roll(ahead, -1, axis=1)
    rise = np.where(crossing, following[..., 2] - corners[..., 2], 1.0)
    share = np.where(crossing, (NEAR - corners[..., 2]) / rise, 0.0)
    points = np.concatenate([corners, corners + share[..., None] * (following - corners)], axis=1)
    counts = np.concatenate([ahead, crossing], axis=1)[..., None]
    flat = points[..., :2] / np.maximum(points[..., 2:], NEAR)
    low, high = np.where(counts, flat, np.inf).min(axis=1), np.where(counts, flat, -np.inf).max(axis=1)
    return low - _MARGIN, high + _MARGIN, corners[..., 2].min(axis=1)


class Painter:
    """Shades faces by Lambert's law, with normals in body coordinates: vehicles keep their grey values."""

    def __init__(self, rng: np.random.Generator, faces: Sequence[Face]) -> None:
        self._light = _AMBIENT + _DIRECT * np.clip(Mesh.of(faces).normals() @ _SUN, 0, None)
        self._materials = [face.material for face in faces]
        first = {id(material): row for row, material in reversed([*enumerate(self._materials)])}
        self._material_of = np.array([first[id(material)] for material in self._materials])
        # Faces of one material follow one another; the last place is that of `SKY`.
        self._place = np.append(np.argsort(np.argsort(self._material_of, kind="stable")), -1).astype(np.int16)
        self._grain, self._cloud = Noise(rng, 0.55), Noise(rng, 1.1)

    def paint(
        self, mesh: Mesh, x: FloatArray, y: FloatArray, camera: FloatArray, spacing: float
    ) -> FloatArray:
        """Light (K, H, W) of K grids of rays (K, 1, W), (K, H, 1), see `cast`; by ``T_world_cam``.

        Neighbouring rays of a grid are `spacing` apart. All grids at once take less time than one by one.
        """
        depth, face = (np.stack(part) for part in zip(*map(partial(cast, mesh), x, y), strict=True))
        order = np.argsort(self._place[face.ravel()], kind="stable")
        x, y, z = (part.ravel()[order] for part in np.broadcast_arrays(x, y, depth))
        rows, light = face.ravel()[order], np.empty(depth.size)
        sky = int(np.count_nonzero(rows == SKY))
        light[order[:sky]] = self._sky(x[:sky], y[:sky], camera)
        order, rows = order[sky:], rows[sky:]
        u, v, fu, fv = mesh.surfaces(rows, x[sky:], y[sky:], z[sky:], spacing)
        ends = np.flatnonzero(np.diff(self._material_of[rows], append=-1)) + 1
        shades = np.empty(rows.size)
        for start, end in pairwise([0, *ends.tolist()]):
            at = slice(start, end)
            patch = Patch(u[at], v[at], fu[at], fv[at], self._grain, self._cloud)
            shades[at] = self._materials[rows[start]](patch)
        light[order] = self._light[rows] * shades
        return light.reshape(depth.shape)

    def _sky(self, x: FloatArray, y: FloatArray, camera: FloatArray) -> FloatArray:
        right, down, ahead = camera[:3, :3] @ np.stack([x, y, np.ones_like(x)])
        around, up = np.arctan2(right, ahead), np.arctan2(-down, np.hypot(right, ahead))
        fine = np.full_like(around, 1e-3)
        return np.asarray(228 + 14 * self._cloud.sample(around, up, fine, fine, 1.7) - 30 * up)


def ray_offsets(samples: int) -> FloatArray:
    """Where in a pixel its rays pass, relative to its centre: (n^2, 2), x and y in (-0.5, 0.5).

    A square grid turned by atan(1/n): no two rays lie in one column or row, so that an upright edge moves
    over the pixel in steps of 1/n^2 instead of 1/n.
    """
    count = samples * samples
    column = np.arange(1, count + 1)
    row = samples * column % (count + 1)
    return (np.stack([column, row], axis=1) - 0.5) / count - 0.5


def gather(light: FloatArray, offset: FloatArray) -> FloatArray:
    """Give every pixel the light of its own ray and of its neighbours', weighed by a tent two pixels wide.

    That is about the blur of a good lens. `light` (H + 2, W + 2) has one pixel more on each side; `offset`
    (2,) is where the rays pass, relative to the pixels' centres.
    """
    for shift in offset[::-1]:
        before, here, after = (max(0.0, 1 - abs(shift + step)) for step in (-1, 0, 1))
        light = (before * light[:-2] + here * light[1:-1] + after * light[2:]).T
    return light


def respond(light: FloatArray) -> FloatArray:
    """Grey value of light: 255 (1.25 light / 255)^1.4, saturated at 255, as of KITTI (docs/synthetic.md)."""
    return np.asarray(_WHITE * np.clip(_GAIN * light / _WHITE, 0, 1) ** _GAMMA)


def expose(image: FloatArray, noise: float, rng: np.random.Generator) -> ByteArray:
    """Turn light (H, W) into grey values: the camera's response, then Gaussian noise of this deviation."""
    seen = respond(image) + noise * rng.standard_normal(image.shape)
    return np.clip(np.rint(seen), 0, 255).astype(np.uint8)
