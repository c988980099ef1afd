"""Rigid bodies over many frames: cameras by robust bundle adjustment, points by triangulation.

A point of a body is (x, y, rho): it lies on the ray (x, y, 1) of the reference frame's camera at inverse
depth rho, and appears in frame f where R_f (x, y, 1)^T + rho t_f points. Every moving body has cameras
[R t] of its own, so static scene and moving objects are treated alike. Images (n, F, 2) are in normalised
coordinates, NaN where a point is not seen. In compiled code parts of arrays are named before they change:
numba takes seconds to compile an assignment to a slice.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import TypeAlias

import numpy as np

from kt3dmoseg.compiled import compiled
from kt3dmoseg.types import FloatArray, IntArray

# Stages of a descent: standard deviation over noise, and steps. From far to near where all points would be
# outliers of cameras that have not moved, as in a deep scene; at once where motion is small or depth shallow;
# from a factorisation; last, from the best end of these.
_GRADUAL = np.array([(100.0, 7), (27.0, 7), (7.0, 7)])
_DIRECT = np.array([(1.0, 12)])
_FACTORED = np.array([(27.0, 5), (7.0, 5)])
_FINAL = np.array([(1.0, 30)])
# Residual, in standard deviations, at which a trajectory loses half of its weight.
_HALF_WEIGHT = 2.0
# A stage ends for a body that gains less than this part of its cost.
_GAIN = 1e-3
# Depth below which a point is taken to be at this depth: behind a camera the image is meaningless.
_NEAREST = 0.05
# Random inverse depths at the start of the gradual descent, in units of their median.
_DEPTHS = (0.3, 1.7)
_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-9, 1e6
_TINY = 1e-12
# Least square of an axis of the shape, relative to the largest, that the metric upgrade may leave.
_FLATTEST = 1e-2
# Passes of triangulation; what is added to the diagonal of its equations.
_PASSES = 3
_RIDGE = np.eye(3, 4) * np.array([1e-9, 1e-9, 1e-7, 0.0])

_Body: TypeAlias = tuple[float, FloatArray, FloatArray]  # cost, cameras (F, 3, 4), points (n, 3)


def adjust(image: FloatArray, rng: np.random.Generator, *, noise: float) -> FloatArray:
    """Find the cameras of a body from the images of its points, some of which may belong elsewhere.

    Levenberg and Marquardt's method with the points eliminated (Schur complement). A trajectory is an outlier
    as a whole: its weight falls with its mean squared residual as Cauchy's does. The best of several descents
    is kept: from cameras that do not move, with random depths and a scale that narrows;
    from the same with equal depths; and, where all points are seen in all frames, from two factorisations
    under weak perspective, which find bodies that turn far. From the best end it descends to the noise.

    Parameters
    ----------
    image : (n, F, 2) float64
        Of n points, each of which may be seen nowhere.
    rng : numpy.random.Generator
        Draws the random depths.
    noise : float
        Standard deviation of image coordinates.

    Returns
    -------
    cameras : (F, 3, 4) float64
        Rotation and translation. Their scale is free: the median inverse depth is 1.

    References
    ----------
    Triggs, McLauchlan, Hartley, Fitzgibbon, "Bundle adjustment: a modern synthesis", 1999. The start: Yu,
    Gallup, "3D reconstruction from accidental motion", CVPR 2014.
    """
    image, order = _in_order(image)
    _, cameras, _ = _adjusted(image, rng, noise)
    return cameras[order.argsort()]


def focal_costs(
    images: Sequence[FloatArray], rng: np.random.Generator, *, noise: float, lengths: Sequence[float]
) -> FloatArray:
    """Compute what bodies cost (B, L) under focal lengths: the less, the more rigid they are.

    Bodies are adjusted under the middle one, from there under its neighbours, and so on. `images`, one of
    each body as for `adjust`, and `noise` are in the units of the `lengths`, which are sorted.
    """
    middle = len(lengths) // 2
    costs = np.empty((len(images), len(lengths)))
    for (image, _), row in zip(map(_in_order, images), costs, strict=True):
        first = _adjusted(image / lengths[middle], rng, noise / lengths[middle])
        row[middle] = first[0]
        for order in (range(middle, -1, -1), range(middle, len(lengths))):
            _, cameras, points = first
            for last, k in itertools.pairwise(order):
                scale = np.array([lengths[last] / lengths[k], lengths[last] / lengths[k], 1.0])
                cameras = np.concatenate([cameras[:, :, :3], cameras[:, :, 3:] * scale[:, None]], axis=2)
                start = image / lengths[k], cameras, points * scale
                row[k], cameras, points = _descend(*start, _FINAL, noise / lengths[k])
    return costs


def triangulate(cameras: FloatArray, image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the points of trajectories, as if they belonged to a body, and what that leaves.

    The equations (x, y, rho) -> R_f (x, y, 1)^T + rho t_f are linear up to the depth, by which they are
    weighted, each pass with the depths of the one before (Hartley and Sturm, "Triangulation", CVIU 1997).
    Points lie in front of the reference camera, at most at infinity.

    Parameters
    ----------
    cameras : (F, 3, 4) float64
        Of the body.
    image : (N, F, 2) float64
        Of the trajectories.

    Returns
    -------
    points : (N, 3) float64
        (x, y, rho), see the module.
    residual : (N,) float64
        Sum of squared image residuals of each trajectory.
    """
    return _locate(cameras, np.array(image, order="C"))


def _in_order(image: FloatArray) -> tuple[FloatArray, IntArray]:
    """Put the frame that sees most points first, the reference, then those around it; and that order (F,)."""
    reference = np.isfinite(image[..., 0]).sum(axis=0).argmax()
    order = np.abs(np.arange(image.shape[1]) - reference).argsort(kind="stable")
    return np.array(image[:, order], order="C"), order


def _adjusted(image: FloatArray, rng: np.random.Generator, noise: float) -> _Body:
    """Descend from several starts, and from the best end to the noise; the first frame is the reference."""
    seen, deep = np.isfinite(image[..., 0]), rng.uniform(*_DEPTHS, len(image))
    # Cameras that do not move, and points where they are first seen.
    still = np.tile(np.eye(3, 4), (image.shape[1], 1, 1))
    at = image[np.arange(len(image)), seen.argmax(axis=1)]
    starts = [
        (still, np.column_stack([at, deep]), _GRADUAL),
        (still, np.column_stack([at, np.ones_like(deep)]), _DIRECT),
    ]
    if seen.all():
        starts += [(*start, _FACTORED) for start in _factored(image)]
    _, cameras, points = min((_descend(image, *start, noise) for start in starts), key=lambda end: end[0])
    return _descend(image, cameras, points, _FINAL, noise)


def _factored(image: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield two starts by factorisation of complete tracks, which differ by a reflection in depth.

    Sources: Tomasi and Kanade, "Shape and motion from image streams under orthography", IJCV 1992; for weak
    perspective Poelman and Kanade, "A paraperspective factorization method", PAMI 1997.
    """
    n_frames = image.shape[1]
    centre = image.mean(axis=0)
    flat = (image - centre).reshape(len(image), -1).T
    left, value, right = np.linalg.svd(flat, full_matrices=False)
    motion = (left[:, :3] * value[:3]).reshape(n_frames, 2, 3)
    upgrade = _metric(motion)
    shape = right[:3].T @ np.linalg.inv(upgrade).T
    left, value, right = np.linalg.svd(motion @ upgrade, full_matrices=False)
    axes, scale = left @ right, np.maximum(value.mean(axis=1), _TINY)
    rotation = np.concatenate([axes, np.cross(axes[:, 0], axes[:, 1])[:, None]], axis=1)
    # The centre lies at depth 1 in the reference frame, and elsewhere where its scale puts it.
    ray = np.column_stack([centre, np.ones(n_frames)])
    for mirror in (np.array([1.0, 1.0, 1.0]), np.array([1.0, 1.0, -1.0])):
        turned = rotation * mirror[:, None] * mirror
        back = turned[0].T
        space = (shape * mirror) @ back * scale[0] + ray[0]
        depth = np.maximum(space[:, 2:], _NEAREST)
        turned = turned @ back
        moved = (scale[0] / scale)[:, None] * ray - turned @ ray[0]
        cameras = np.concatenate([turned, moved[..., None]], axis=2)
        yield cameras, np.hstack([space[:, :2] / depth, 1 / depth])


def _metric(motion: FloatArray) -> FloatArray:
    """Find a matrix that makes the two rows of motion (F, 2, 3) orthogonal and of equal length."""
    i, j = np.triu_indices(3)
    outer = motion[:, :, None, :, None] * motion[:, None, :, None, :]  # rows, rows, columns, columns
    outer = (outer + outer.swapaxes(3, 4))[..., i, j] * np.where(i == j, 0.5, 1.0)
    rows = np.concatenate([outer[:, 0, 0] - outer[:, 1, 1], outer[:, 0, 1]])
    square = np.empty((3, 3))
    square[i, j] = square[j, i] = np.linalg.eigh(rows.T @ rows)[1][:, 0]
    values, vectors = np.linalg.eigh(square * np.sign(np.trace(square)))
    values = np.maximum(values, _FLATTEST * np.abs(values[-1]))
    return np.asarray(vectors * np.sqrt(values), dtype=np.float64)


@compiled
def _descend(
    image: FloatArray, cameras: FloatArray, points: FloatArray, stages: FloatArray, noise: float
) -> _Body:
    """Adjust a body from a start, from stage to stage; the end's cost is that at `noise`."""
    cameras, points = cameras.copy(), points.copy()
    for stage in range(len(stages)):
        sigma, damping = stages[stage, 0] * noise, _DAMPING
        cost, square = _evaluate(image, cameras, points, sigma)
        for _ in range(int(stages[stage, 1])):
            weight = 1 / (sigma * np.sqrt(1 + square / _HALF_WEIGHT**2))
            moved, found = cameras.copy(), points.copy()
            _step(image, moved, found, weight, damping)
            lower, fewer = _evaluate(image, moved, found, sigma)
            if not lower < cost:
                damping = min(5.0 * damping, _MOST_DAMPING)
                continue
            gain = (cost - lower) / max(cost, _TINY)
            cameras, points, square, cost = moved, found, fewer, lower
            damping = max(0.2 * damping, _LEAST_DAMPING)
            if gain < _GAIN:
                break
        # Scale and sign of translations and inverse depths are free together.
        depth = np.median(points[:, 2])
        if abs(depth) > _TINY:
            inverse, shifts = points[:, 2], cameras[:, :, 3]
            inverse /= depth
            shifts *= depth
    return _evaluate(image, cameras, points, noise)[0], cameras, points


@compiled
def _project(camera: FloatArray, point: FloatArray) -> tuple[float, float, float, float, float, float]:
    """Ray (a, b, c) of a point in a camera's axes, its image (u, v) and its inverse depth."""
    x, y, rho = point
    a = camera[0, 0] * x + camera[0, 1] * y + camera[0, 2]
    b = camera[1, 0] * x + camera[1, 1] * y + camera[1, 2]
    c = camera[2, 0] * x + camera[2, 1] * y + camera[2, 2]
    inverse = 1 / max(c + rho * camera[2, 3], _NEAREST)
    return a, b, c, (a + rho * camera[0, 3]) * inverse, (b + rho * camera[1, 3]) * inverse, inverse


@compiled
def _evaluate(
    image: FloatArray, cameras: FloatArray, points: FloatArray, noise: float
) -> tuple[float, FloatArray]:
    """Compute the cost, and the mean squared residuals (n,) over noise."""
    cost, square = 0.0, np.empty(len(points))
    for p in range(len(points)):
        total, frames = 0.0, 0
        for f in range(len(cameras)):
            if not np.isnan(image[p, f, 0]):
                _, _, _, u, v, _ = _project(cameras[f], points[p])
                total += (u - image[p, f, 0]) ** 2 + (v - image[p, f, 1]) ** 2
                frames += 1
        square[p] = total / (max(frames, 1) * noise**2)
        cost += frames * np.log1p(square[p] / _HALF_WEIGHT**2)
    return cost, square


@compiled
def _step(
    image: FloatArray, cameras: FloatArray, points: FloatArray, weight: FloatArray, damping: float
) -> None:
    """Solve the damped normal equations of cameras and points, and move these by the solution.

    A point's equations are three rows: columns for itself, for all cameras but the reference, and for the
    right side. Eliminated from the equations of the cameras, they leave a system of the cameras alone.
    """
    n_points, n_frames, _ = image.shape
    size = 6 * (n_frames - 1)
    of_cameras, of_points = np.zeros((size, size + 1)), np.zeros((n_points, 3, 3 + size + 1))
    rows = np.zeros((2, 10))
    for p in range(n_points):
        for f in range(n_frames):
            if not np.isnan(image[p, f, 0]):
                _differentiate(image[p, f], cameras[f], points[p], weight[p], rows)
                _add(rows, 6 * (f - 1), of_cameras, of_points[p])
        grow = damping * (of_points[p, 0, 0] + of_points[p, 1, 1] + of_points[p, 2, 2])
        for k in range(3):
            of_points[p, k, k] += grow
        _eliminate(of_points[p])
    for k in range(size):
        of_cameras[k, k] *= 1 + damping
    # Single precision is enough for what couples the cameras.
    coupling = of_points[:, :, 3:].astype(np.float32).reshape(3 * n_points, size + 1)
    of_cameras -= np.dot(coupling.T, coupling)[:-1]
    _eliminate(of_cameras)
    move = np.ones(size + 1, np.float32)
    _substitute(of_cameras, of_cameras[:, -1], move)
    for f in range(1, n_frames):
        _turn(cameras[f], move[6 * f - 6 : 6 * f - 3])
        shift = cameras[f, :, 3]
        shift += move[6 * f - 3 : 6 * f]
    turned = move[:-1]
    turned *= -1
    right = np.dot(coupling, move)
    for p in range(n_points):
        _substitute(of_points[p], right[3 * p : 3 * p + 3], move)
        point = points[p]
        point += move[:3]


@compiled
def _differentiate(
    image: FloatArray, camera: FloatArray, point: FloatArray, weight: float, rows: FloatArray
) -> None:
    """Write the derivatives of a point's image in a frame by the point and the camera, and what it lacks.

    A row is weighted and holds the gradient g (1, 0, -u) or g (0, 1, -v) by the point in the camera's axes,
    times the derivatives of that by (x, y, rho), by turn and by shift: columns of the camera, the cross
    product with the ray, and rho.
    """
    a, b, c, u, v, inverse = _project(camera, point)
    g = inverse * weight
    for axis, seen in enumerate((u, v)):
        for k, column in enumerate((0, 1, 3)):
            rows[axis, k] = g * (camera[axis, column] - seen * camera[2, column])
        rows[axis, 6 + axis], rows[axis, 8] = g * point[2], -g * seen * point[2]
        rows[axis, 9] = (image[axis] - seen) * weight
    rows[0, 3], rows[0, 4], rows[0, 5] = -g * u * b, g * (c + u * a), -g * b
    rows[1, 3], rows[1, 4], rows[1, 5] = -g * (c + v * b), g * v * a, g * a


@compiled
def _add(rows: FloatArray, at: int, of_cameras: FloatArray, of_point: FloatArray) -> None:
    """Add products of rows to the normal equations; the camera's begin at `at`, below 0 it is fixed."""
    for axis in range(2):
        for i in range(3):
            for j in range(3):
                of_point[i, j] += rows[axis, i] * rows[axis, j]
            of_point[i, -1] += rows[axis, i] * rows[axis, 9]
        if at >= 0:
            for i in range(6):
                for j in range(3):
                    of_point[j, 3 + at + i] += rows[axis, j] * rows[axis, 3 + i]
                for j in range(6):
                    of_cameras[at + i, at + j] += rows[axis, 3 + i] * rows[axis, 3 + j]
                of_cameras[at + i, -1] += rows[axis, 3 + i] * rows[axis, 9]


@compiled
def _locate(cameras: FloatArray, image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the points and residuals of `triangulate`."""
    points, residual = np.empty((len(image), 3)), np.empty(len(image))
    row = np.empty(4)
    for p in range(len(image)):
        weight = np.ones(len(cameras))
        for _ in range(_PASSES):
            normal, residual[p] = _RIDGE.copy(), 0.0
            for f in range(len(cameras)):
                if not np.isnan(image[p, f, 0]):
                    _add_rays(image[p, f], cameras[f], weight[f], row, normal)
            _eliminate(normal)
            _substitute(normal, normal[:, 3], points[p])
            if points[p, 2] < 0:
                points[p, 2] = 0.0
                _substitute(normal[:2], normal[:, 3], points[p])
            for f in range(len(cameras)):
                if not np.isnan(image[p, f, 0]):
                    _, _, _, u, v, weight[f] = _project(cameras[f], points[p])
                    residual[p] += (u - image[p, f, 0]) ** 2 + (v - image[p, f, 1]) ** 2
    return points, residual


@compiled
def _add_rays(
    image: FloatArray, camera: FloatArray, weight: float, row: FloatArray, normal: FloatArray
) -> None:
    """Add the two equations of a frame to the normal equations of a point, (3, 4)."""
    for axis in range(2):
        for k, column in enumerate((0, 1, 3, 2)):
            row[k] = weight * (camera[axis, column] - image[axis] * camera[2, column])
        for i in range(3):
            for j in range(3):
                normal[i, j] += row[i] * row[j]
            normal[i, 3] -= row[i] * row[3]


@compiled
def _eliminate(matrix: FloatArray) -> None:
    """Make the square part of rows [A B], A = U^T U, triangular: [U U^-T B] (Cholesky)."""
    n_rows, n_columns = matrix.shape
    for i in range(n_rows):
        if i % 2:
            for j in range(i, n_columns):
                matrix[i, j] -= matrix[0, i] * matrix[0, j]
        for k in range(i % 2, i, 2):  # two rows at a time: half as often from and to memory
            first, second = matrix[k, i], matrix[k + 1, i]
            for j in range(i, n_columns):
                matrix[i, j] -= first * matrix[k, j] + second * matrix[k + 1, j]
        root = np.sqrt(max(matrix[i, i], _TINY))
        matrix[i, i], inverse = root, 1 / root
        for j in range(i + 1, n_columns):
            matrix[i, j] *= inverse


@compiled
def _substitute(matrix: FloatArray, right: FloatArray, solution: FloatArray) -> None:
    """Solve U x = b from the last unknown to the first."""
    for k in range(len(matrix) - 1, -1, -1):
        total = right[k]
        for j in range(k + 1, len(matrix)):
            total -= matrix[k, j] * solution[j]
        solution[k] = total / matrix[k, k]


@compiled
def _turn(camera: FloatArray, vector: FloatArray) -> None:
    """Turn a camera by an axis-angle vector w: R + sin|w| / |w| w x R + (1 - cos|w|) / |w|^2 w x (w x R)."""
    x, y, z = vector
    angle = np.sqrt(x * x + y * y + z * z) + _TINY
    first, second = np.sin(angle) / angle, (1 - np.cos(angle)) / angle**2
    for k in range(3):
        a, b, c = camera[0, k], camera[1, k], camera[2, k]
        d, e, f = y * c - z * b, z * a - x * c, x * b - y * a
        camera[0, k] += first * d + second * (y * f - z * e)
        camera[1, k] += first * e + second * (z * d - x * f)
        camera[2, k] += first * f + second * (x * e - y * d)
