"""Rigid bodies over many frames: cameras by robust bundle adjustment, points by triangulation.

A point of a body is (x, y, rho): it lies on the ray (x, y, 1) of the reference frame's camera at inverse
depth rho, and appears in frame f where R_f (x, y, 1)^T + rho t_f points. Every moving body has cameras of its
own, so static scene and moving objects are treated alike. Several bodies are adjusted at once, as arrays.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kt3dmoseg.types import BoolArray, FloatArray, IntArray

# Stages of a descent: standard deviation over noise, and steps. From far to near where all points would be
# outliers of cameras that have not moved, as in a deep scene; at once where motion is small or depth shallow;
# from a factorisation; last, from the best end of these.
_GRADUAL = ((100.0, 7), (27.0, 7), (7.0, 7))
_DIRECT = ((1.0, 12),)
_FACTORED = ((27.0, 5), (7.0, 5))
_FINAL = ((1.0, 30),)
# Residual, in standard deviations, at which a trajectory loses half of its weight.
_HALF_WEIGHT = 2.0
# A stage ends for a body that gains less than this part of its cost.
_GAIN = 1e-3
# Depth below which a point is taken to be at this depth: behind a camera the image is meaningless.
_NEAREST = 0.05
# Random inverse depths at the start of the gradual descent, in units of their median.
_DEPTHS = (0.3, 1.7)
_DAMPING = 1e-3
_TINY = 1e-12
# Steps are found in single precision; whether they are good is evaluated in double.
_STEP = np.float32
# Least square of an axis of the shape, relative to the largest, that the metric upgrade may leave.
_FLATTEST = 1e-2


_Array = NDArray[np.floating[Any]]


class Cameras(NamedTuple):
    """Cameras of B bodies in F frames: rotation (B, F, 3, 3) and translation (B, F, 3) float64."""

    rotation: FloatArray
    translation: FloatArray


class _State(NamedTuple):
    """Cameras, points (B, n, 3) and what follows from them.

    `rotated` (B, F, 3, n) are the rays in the cameras' axes, `image` (B, 2, F, n) where they appear,
    `inverse` (B, F, n) one over the depth, `error` (B, 2, F, n) the residuals, zero where unseen, `square`
    (B, n) their mean square over noise, and `cost` (B,) as `adjust` returns it.
    """

    rotation: FloatArray
    translation: FloatArray
    points: FloatArray
    rotated: FloatArray
    image: FloatArray
    inverse: FloatArray
    error: FloatArray
    square: FloatArray
    cost: FloatArray

    def of(self, bodies: IntArray) -> _State:
        """State of some of the bodies."""
        return _State(*(part[bodies] for part in self))


def adjust(
    image: FloatArray, visible: BoolArray, rng: np.random.Generator, *, noise: float
) -> tuple[Cameras, FloatArray]:
    """Find the cameras of bodies from the images of their points, some of which may belong elsewhere.

    Levenberg and Marquardt's method with the points eliminated (Schur complement). A trajectory is an outlier
    as a whole: its weight falls with its mean squared residual as Cauchy's does. Of several descents each
    body keeps the best: from cameras that do not move, with random depths and a scale that narrows;
    from the same with equal depths; and, where all points are seen in all frames, from two factorisations
    under weak perspective, which find bodies that turn far. From the best end it descends to the noise.

    Parameters
    ----------
    image : (B, F, n, 2) float64
        Normalised image coordinates of n points of each of B bodies, anything where not visible.
    visible : (B, F, n) bool
        Where points are seen; a point may be seen nowhere.
    rng : numpy.random.Generator
        Draws the random depths.
    noise : float
        Standard deviation of image coordinates.

    Returns
    -------
    cameras : Cameras
        Their scale is free: the median inverse depth is 1.
    cost : (B,) float64
        Sum over the trajectories of ``m log(1 + r^2 / 4)``, m the number of their frames and r^2 their mean
        squared residual over `noise` squared.

    References
    ----------
    Triggs, McLauchlan, Hartley, Fitzgibbon, "Bundle adjustment: a modern synthesis", 1999. The start: Yu,
    Gallup, "3D reconstruction from accidental motion", CVPR 2014.
    """
    end = _adjusted(image, visible, rng, noise)
    return Cameras(end.rotation, end.translation), end.cost


def focal_length(
    image: FloatArray, visible: BoolArray, rng: np.random.Generator, *, noise: float, lengths: Sequence[float]
) -> float:
    """Choose among focal lengths that under which bodies are most rigid.

    Bodies are adjusted under the middle one, from there under its neighbours, and so on. Parameters as for
    `adjust`, but `image` and `noise` in the units of the `lengths`, which are in order.
    """
    middle = len(lengths) // 2
    first = _adjusted(image / lengths[middle], visible, rng, noise / lengths[middle])
    costs = {lengths[middle]: first.cost.sum()}
    reference = visible.sum(axis=2).argmax(axis=1)
    for order in (lengths[middle::-1], lengths[middle:]):
        end = first
        for last, f in itertools.pairwise(order):
            points = end.points * np.array([last / f, last / f, 1.0])
            cameras = Cameras(end.rotation, end.translation * np.array([last / f, last / f, 1.0]))
            end = _descend(image / f, visible, reference, cameras, points, _FINAL, noise / f)
            costs[f] = end.cost.sum()
    return min(costs, key=costs.__getitem__)


def _adjusted(image: FloatArray, visible: BoolArray, rng: np.random.Generator, noise: float) -> _State:
    """Descend from several starts, and from the best end of each body to the noise."""
    reference = visible.sum(axis=2).argmax(axis=1)
    deep = rng.uniform(*_DEPTHS, (visible.shape[0], visible.shape[2]))
    starts: list[tuple[Cameras, FloatArray, Sequence[tuple[float, int]]]] = [
        (*_still(image, visible, reference, deep), _GRADUAL),
        (*_still(image, visible, reference, np.ones_like(deep)), _DIRECT),
    ]
    if (visible == visible.any(axis=1, keepdims=True)).all():
        starts += [(*start, _FACTORED) for start in _factored(image, visible, reference)]
    ends = [_descend(image, visible, reference, *start, noise) for start in starts]
    best = np.stack([end.cost for end in ends]).argmin(axis=0), np.arange(len(visible))
    rotation, translation, points = (
        np.stack([getattr(end, part) for end in ends])[best] for part in ("rotation", "translation", "points")
    )
    return _descend(image, visible, reference, Cameras(rotation, translation), points, _FINAL, noise)


def _descend(
    image: FloatArray,
    visible: BoolArray,
    reference: IntArray,
    cameras: Cameras,
    points: FloatArray,
    stages: Sequence[tuple[float, int]],
    noise: float,
) -> _State:
    """Adjust bodies from a start; the end's cost is that at `noise`."""
    n_bodies, n_frames, _ = visible.shape
    fixed = np.zeros((n_bodies, n_frames), dtype=np.bool_)
    fixed[np.arange(n_bodies), reference] = True
    planes = np.moveaxis(image, -1, 1)
    for scale, steps in stages:
        sigma = scale * noise
        state = _evaluate(cameras, points, planes, visible, sigma)
        damping = np.full(n_bodies, _DAMPING)
        active = np.arange(n_bodies)
        for _ in range(steps):
            old = state.of(active)
            step = _step(old, visible[active], fixed[active], damping[active], sigma)
            tried = _evaluate(*step, planes[active], visible[active], sigma)
            better = tried.cost < old.cost
            gain = np.where(better, (old.cost - tried.cost) / np.maximum(old.cost, _TINY), np.inf)
            for part, new in zip(state, tried, strict=True):
                part[active[better]] = new[better]
            damping[active] = np.clip(damping[active] * np.where(better, 0.2, 5.0), 1e-9, 1e6)
            active = active[gain >= _GAIN]
            if not len(active):
                break
        # Scale and sign of translations and inverse depths are free together.
        depth = np.median(state.points[..., 2], axis=1)
        depth = np.where(np.abs(depth) > _TINY, depth, 1.0)
        points = state.points / np.stack([np.ones_like(depth), np.ones_like(depth), depth], axis=1)[:, None]
        cameras = Cameras(state.rotation, state.translation * depth[:, None, None])
    return _evaluate(cameras, points, planes, visible, noise)


def _still(
    image: FloatArray, visible: BoolArray, reference: IntArray, depths: FloatArray
) -> tuple[Cameras, FloatArray]:
    """Start with cameras that do not move, and points (B, n, 3) where they are seen, at inverse depths."""
    n_bodies, n_frames, _ = visible.shape
    points = np.concatenate([_nearest_image(image, visible, reference), depths[..., None]], axis=2)
    still = np.tile(np.eye(3), (n_bodies, n_frames, 1, 1)), np.zeros((n_bodies, n_frames, 3))
    return Cameras(*still), points


def _factored(
    image: FloatArray, visible: BoolArray, reference: IntArray
) -> Iterator[tuple[Cameras, FloatArray]]:
    """Yield two starts by factorisation of complete tracks, which differ by a reflection in depth.

    Sources: Tomasi and Kanade, "Shape and motion from image streams under orthography", IJCV 1992; for weak
    perspective Poelman and Kanade, "A paraperspective factorization method", PAMI 1997.
    """
    n_bodies, n_frames, n_points = visible.shape
    seen = visible[:, :, None]
    planes = np.moveaxis(image, -1, 2)
    centre = (planes * seen).sum(axis=3) / np.maximum(seen.sum(axis=3), 1)
    flat = ((planes - centre[..., None]) * seen).reshape(n_bodies, 2 * n_frames, n_points)
    left, value, right = np.linalg.svd(flat, full_matrices=False)
    motion = (left[..., :3] * value[:, None, :3]).reshape(n_bodies, n_frames, 2, 3)
    upgrade = _metric(motion)
    shape = right[:, :3].swapaxes(1, 2) @ np.linalg.inv(upgrade).swapaxes(1, 2)
    left, value, right = np.linalg.svd(motion @ upgrade[:, None], full_matrices=False)
    axes, scale = left @ right, np.maximum(value.mean(axis=-1), _TINY)
    rotation = np.concatenate([axes, np.cross(axes[:, :, 0], axes[:, :, 1])[:, :, None]], axis=2)
    # The centre lies at depth 1 in the reference frame, and elsewhere where its scale puts it.
    ray = np.concatenate([centre, np.ones((n_bodies, n_frames, 1))], axis=2)
    every = np.arange(n_bodies)
    own = scale[every, reference, None]
    for mirror in (np.array([1.0, 1.0, 1.0]), np.array([1.0, 1.0, -1.0])):
        turned = rotation * mirror[:, None] * mirror
        back = turned[every, reference].swapaxes(1, 2)
        space = (shape * mirror) @ back * own[..., None] + ray[every, reference, None]
        depth = np.maximum(space[..., 2:], _NEAREST)
        turned = turned @ back[:, None]
        moved = (own / scale)[..., None] * ray - np.einsum("bfij,bj->bfi", turned, ray[every, reference])
        yield Cameras(turned, moved), np.concatenate([space[..., :2] / depth, 1 / depth], axis=2)


def _metric(motion: FloatArray) -> FloatArray:
    """Matrices (B, 3, 3) that make the two rows of motion (B, F, 2, 3) orthogonal and of equal length."""
    i, j = np.triu_indices(3)
    outer = motion[:, :, :, None, :, None] * motion[:, :, None, :, None, :]  # rows, rows, columns, columns
    outer = (outer + outer.swapaxes(4, 5))[..., i, j] * np.where(i == j, 0.5, 1.0)
    rows = np.concatenate([outer[:, :, 0, 0] - outer[:, :, 1, 1], outer[:, :, 0, 1]], axis=1)
    _, vectors = np.linalg.eigh(rows.swapaxes(1, 2) @ rows)
    square = np.empty((len(motion), 3, 3))
    square[:, i, j] = square[:, j, i] = vectors[:, :, 0]
    values, vectors = np.linalg.eigh(square * np.sign(np.trace(square, axis1=1, axis2=2))[:, None, None])
    values = np.maximum(values, _FLATTEST * np.abs(values[:, -1:]))
    return np.asarray(vectors * np.sqrt(values)[:, None], dtype=np.float64)


def triangulate(
    cameras: Cameras, image: FloatArray, visible: BoolArray, *, passes: int = 3
) -> tuple[FloatArray, FloatArray]:
    """Find the points of trajectories, as if they belonged to each of the bodies, and what that leaves.

    The equations (x, y, rho) -> R_f (x, y, 1)^T + rho t_f are linear up to the depth, by which they are
    weighted, each pass with the depths of the one before (Hartley and Sturm, "Triangulation", CVIU 1997).
    Points lie in front of the reference camera, at most at infinity.

    Parameters
    ----------
    cameras : Cameras
        Of B bodies in F frames.
    image : (F, N, 2) float64
        Normalised image coordinates, anything where not visible.
    visible : (F, N) bool
        Where trajectories are seen.
    passes : int
        Number of solutions.

    Returns
    -------
    points : (B, N, 3) float64
        (x, y, rho), see the module.
    residual : (B, N) float64
        Sum of squared image residuals of each trajectory under each body.
    """
    rotation, translation = cameras
    seen = visible.astype(np.float64)[None]
    columns = np.concatenate([rotation[..., :2], translation[..., None]], axis=-1)
    rows = []
    for axis in (0, 1):
        at = image[None, ..., axis]
        forms = [columns[:, :, axis, k, None] - at * columns[:, :, 2, k, None] for k in range(3)]
        rows.append((forms, at * rotation[:, :, 2, 2, None] - rotation[:, :, axis, 2, None]))
    weight = seen
    for _ in range(passes):
        normal = np.empty((len(rotation), image.shape[1], 3, 3))
        right = np.zeros((len(rotation), image.shape[1], 3))
        normal[:] = np.diag([1e-9, 1e-9, 1e-7])
        for forms, target in rows:
            for i in range(3):
                weighted = weight * forms[i]
                right[..., i] += (weighted * target).sum(axis=1)
                for j in range(i, 3):
                    normal[..., i, j] += (weighted * forms[j]).sum(axis=1)
        for i, j in ((1, 0), (2, 0), (2, 1)):
            normal[..., i, j] = normal[..., j, i]
        points = np.asarray(np.linalg.solve(normal, right[..., None])[..., 0], dtype=np.float64)
        # Nothing is seen behind the camera, or beyond infinity.
        behind = points[..., 2] < 0
        points[behind, :2] = np.linalg.solve(normal[behind, :2, :2], right[behind, :2, None])[..., 0]
        points[behind, 2] = 0
        _, projected, inverse = _project(cameras, points)
        weight = seen * inverse**2
    error = (projected - np.moveaxis(image, -1, 0)) * seen[:, None]
    return points, np.einsum("bafn,bafn->bn", error, error)


def _nearest_image(image: FloatArray, visible: BoolArray, reference: IntArray) -> FloatArray:
    """Where each point is seen in the frame nearest the body's reference, (B, n, 2)."""
    away = np.abs(np.arange(visible.shape[1]) - reference[:, None])[:, :, None]
    nearest = np.where(visible, away, visible.shape[1]).argmin(axis=1)
    return np.take_along_axis(image, nearest[:, None, :, None], axis=1)[:, 0]


def _project(cameras: Cameras, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rays in the cameras' axes, images and inverse depths; see `_State`."""
    rays = np.stack([points[..., 0], points[..., 1], np.ones(points.shape[:-1])], axis=-2)
    rotated = cameras.rotation @ rays[:, None]
    seen = rotated + cameras.translation[..., None] * points[:, None, None, :, 2]
    inverse = 1 / np.maximum(seen[:, :, 2], _NEAREST)
    return rotated, seen[:, :, :2].swapaxes(1, 2) * inverse[:, None], inverse


def _evaluate(
    cameras: Cameras, points: FloatArray, image: FloatArray, visible: BoolArray, noise: float
) -> _State:
    rotated, projected, inverse = _project(cameras, points)
    error = (projected - image) * visible[:, None]
    frames = visible.sum(axis=1)
    square = np.einsum("bafn,bafn->bn", error, error) / np.maximum(frames, 1) / noise**2
    cost = (frames * np.log1p(square / _HALF_WEIGHT**2)).sum(axis=1)
    return _State(*cameras, points, rotated, projected, inverse, error, square, cost)


def _step(
    state: _State, visible: BoolArray, fixed: BoolArray, damping: FloatArray, noise: float
) -> tuple[Cameras, FloatArray]:
    """Solve the damped normal equations of cameras and points, and apply the solution."""
    n_bodies, n_frames, n_points = visible.shape
    size = 6 * n_frames
    error, by_point, by_camera, couple = _derivatives(state, visible, fixed, noise)
    lower = _cholesky(by_point, damping[:, None])
    by_point = _solve_lower(lower, np.moveaxis(by_point, 3, 0))  # (3, B, F, 2, n)
    points_right = -(by_point * error).sum(axis=(2, 3))
    by_camera = by_camera.reshape(n_bodies, n_frames, 6, -1)
    cameras_normal = by_camera @ by_camera.swapaxes(-1, -2)
    cameras_right = -(by_camera @ error.reshape(n_bodies, n_frames, -1, 1)).reshape(n_bodies, size)
    coupling = couple(by_point).reshape(n_bodies, size, 3 * n_points)
    system = -(coupling @ coupling.swapaxes(1, 2)) + _TINY * np.eye(size)
    diagonal = np.einsum("bfkk->bfk", cameras_normal)[..., None] + 1e-6 * n_points
    blocks = cameras_normal + np.eye(6) * (damping[:, None, None, None] * diagonal + fixed[:, :, None, None])
    frames = np.arange(n_frames)
    view = system.reshape(n_bodies, n_frames, 6, n_frames, 6)
    view[:, frames, :, frames, :] += blocks.swapaxes(0, 1)
    flat = points_right.swapaxes(0, 1).reshape(n_bodies, -1, 1)
    move = np.linalg.solve(system, cameras_right[..., None] - coupling @ flat)
    back = (flat.swapaxes(1, 2) - move.swapaxes(1, 2) @ coupling).reshape(n_bodies, 3, n_points)
    turn = move.reshape(n_bodies, n_frames, 6)
    return (
        Cameras(_rotations(turn[..., :3]) @ state.rotation, state.translation + turn[..., 3:]),
        state.points + np.stack(_solve_upper(lower, back.swapaxes(0, 1)), axis=2),
    )


def _derivatives(
    state: _State, visible: BoolArray, fixed: BoolArray, noise: float
) -> tuple[_Array, _Array, _Array, Callable[[_Array], _Array]]:
    """Weighted errors (B, F, 2, n) and their derivatives, single precision.

    A row is the gradient g (1, 0, -u) or g (0, 1, -v) by the point in the camera's axes, times its derivative
    by the point's (x, y, rho), (B, F, 2, 3, n), or by the camera, (B, F, 6, 2, n). The function multiplies
    the latter by what the former became, (3, B, F, 2, n). The last axis is contiguous for sums over points.
    """
    weight = visible * np.sqrt(1 / (1 + state.square / _HALF_WEIGHT**2))[:, None] / noise
    error = (state.error * weight[:, None]).swapaxes(1, 2).astype(_STEP)
    g = (state.inverse * weight)[:, :, None].astype(_STEP)
    gz = -state.image.swapaxes(1, 2).astype(_STEP) * g
    rho = np.broadcast_to(state.points[:, None, :, 2], visible.shape)
    rays = np.stack([*np.moveaxis(state.rotated, 2, 0), rho]) * ~fixed[:, :, None]
    rays = rays[:, :, :, None].astype(_STEP)
    columns = np.concatenate([state.rotation[..., :2], state.translation[..., None]], axis=-1)
    columns = columns[..., None].astype(_STEP)
    by_point = g[..., None, :] * columns[:, :, :2] + gz[:, :, :, None] * columns[:, :, 2, None]
    zero = np.zeros_like(g)
    ends = np.concatenate([g, zero], axis=2), np.concatenate([zero, g], axis=2), gz

    def couple(rows: _Array) -> _Array:
        x, y = (rows[:, :, :, axis].transpose(1, 2, 0, 3) for axis in (0, 1))
        return _by_camera((g * x, g * y, gz[:, :, :1] * x + gz[:, :, 1:] * y), rays)

    return error, by_point, _by_camera(ends, rays), couple


def _by_camera(ends: tuple[_Array, ...], rays: _Array) -> _Array:
    """Derive vectors times the rays R p + rho t by rotation and translation: (B, F, 6, ...)."""
    (a, b, c), (x, y, z, rho) = ends, rays
    return np.stack([c * y - b * z, a * z - c * x, b * x - a * y, rho * a, rho * b, rho * c], axis=2)


def _cholesky(rows: _Array, damping: _Array) -> list[list[_Array]]:
    """Lower factors, as 3 rows of (B, n), of the damped normal matrices of rows (B, F, 2, 3, n)."""
    lower = [[(rows[..., i, :] * rows[..., j, :]).sum(axis=(1, 2)) for j in range(i + 1)] for i in range(3)]
    grow = damping.astype(rows.dtype) * (lower[0][0] + lower[1][1] + lower[2][2] + 1e-6)
    for i, row in enumerate(lower):
        for j in range(i + 1):
            for k in range(j):
                row[j] = row[j] - row[k] * lower[j][k]
            row[j] = np.sqrt(np.maximum(row[j] + grow, _TINY)) if i == j else row[j] / lower[j][j]
    return lower


def _solve_lower(lower: list[list[_Array]], right: _Array) -> _Array:
    """Solve for right sides (3, B, F, 2, n)."""
    (a,), (b, c), (d, e, f) = ([part[:, None, None] for part in row] for row in lower)
    x = right[0] / a
    y = (right[1] - b * x) / c
    return np.stack([x, y, (right[2] - d * x - e * y) / f])


def _solve_upper(lower: list[list[_Array]], right: _Array) -> list[_Array]:
    """Solve with the transposed factors for right sides (3, B, n)."""
    (a,), (b, c), (d, e, f) = lower
    z = right[2] / f
    y = (right[1] - e * z) / c
    return [(right[0] - b * y - d * z) / a, y, z]


def _rotations(vectors: FloatArray) -> FloatArray:
    """Rotation matrices of axis-angle vectors (..., 3), by Rodrigues' formula."""
    angle = np.sqrt((vectors**2).sum(axis=-1))[..., None, None] + _TINY
    cross = np.zeros((*vectors.shape[:-1], 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        cross[..., k, j], cross[..., j, k] = vectors[..., i], -vectors[..., i]
    second = (1 - np.cos(angle)) / angle**2 * (cross @ cross)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * cross + second, dtype=np.float64)
