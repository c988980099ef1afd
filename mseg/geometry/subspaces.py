"""The trajectory matrix: 2F rows x1, y1, x2, y2, ..., one column per trajectory; its subspaces and flats.

Under an affine camera the trajectories of one rigid motion span at most four dimensions, a flat (affine
subspace) of three (Tomasi and Kanade, IJCV 1992); methods that segment by subspaces start from this matrix.
"""

import numpy as np

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import Camera, FloatArray, IntArray, Trajectories


def normalising_matrix(trajectories: Trajectories, camera: Camera | None = None) -> FloatArray:
    """Matrix (3, 3) that maps normalised to pixel coordinates, by the first of three rules that applies.

    1. The camera's own matrix ``K``. Hopkins155 files hold the one with which that benchmark
       normalised its coordinates, so that ``x = inv(K) y`` is the file's own ``x``.
    2. The image size: the borders map to -1 and 1, ``x = 2 y / size - 1`` in each direction (the
       convention of most Hopkins155 sequences; anisotropic).
    3. The range of the visible positions takes the place of the image borders, in each direction.
    """
    if camera is not None and camera.K is not None:
        affine = np.isfinite(camera.K).all() and np.array_equal(camera.K[2], (0, 0, 1))
        if not affine or np.linalg.matrix_rank(camera.K) < 3:
            raise InvalidValueError(
                "camera.K", expected="invertible, last row 0 0 1", found=str(camera.K.tolist())
            )
        return camera.K
    if trajectories.image_size is not None:
        low, high = np.zeros(2), np.array(trajectories.image_size)
    else:
        seen = trajectories.xy[trajectories.visible]
        low, high = (seen.min(axis=0), seen.max(axis=0)) if len(seen) else (-np.ones(2), np.ones(2))
    half, centre = (high - low) / 2, (low + high) / 2
    half[half <= 0] = 1.0
    return np.array([[half[0], 0, centre[0]], [0, half[1], centre[1]], [0, 0, 1]], dtype=np.float64)


def normalised(xy: FloatArray, matrix: FloatArray) -> FloatArray:
    """Map positions (N, F, 2) in pixels by the inverse of a `normalising_matrix`; NaN stays NaN."""
    inverse = np.linalg.inv(matrix)
    return np.asarray(xy @ inverse[:2, :2].T + inverse[:2, 2], dtype=np.float64)


def trajectory_matrix(xy: FloatArray) -> FloatArray:
    """Stack positions (N, F, 2) into the matrix (2F, N), rows x1, y1, x2, y2, ...; NaN stays NaN."""
    return np.ascontiguousarray(xy.reshape(len(xy), -1).T)


def leading_row_space(matrix: FloatArray, dimension: int) -> FloatArray:
    """Leading right singular vectors (N, r) of a matrix (D, N): whitened coordinates of its columns."""
    _, _, right = np.linalg.svd(matrix, full_matrices=False)
    return np.ascontiguousarray(right[:dimension].T)


def project(matrix: FloatArray, dimension: int) -> FloatArray:
    """Coordinates (r, N) of columns (D, N) in their best subspace of a dimension r: uncentred PCA."""
    left, _, _ = np.linalg.svd(matrix, full_matrices=False)
    return np.asarray(left[:, :dimension].T @ matrix, dtype=np.float64)


def flat_distances(points: FloatArray, samples: IntArray) -> FloatArray:
    """Distances (N, M) of points (N, D) to the flats through samples (M, p) of them, each of dimension p - 1.

    A flat through points that depend on each other is one of those that contain them; where D < p it is
    all of space.
    """
    origin = points[samples[:, 0]]
    directions = points[samples[:, 1:]] - origin[:, None]
    basis, _ = np.linalg.qr(directions.transpose(0, 2, 1), mode="complete")
    normals = basis[:, :, directions.shape[1] :]
    offset = np.einsum("md,mdk->mk", origin, normals)
    squares = np.zeros((len(points), len(samples)))
    for k in range(normals.shape[2]):
        squares += (points @ normals[:, :, k].T - offset[:, k]) ** 2
    return np.asarray(np.sqrt(squares))


def best_flat_distances(points: FloatArray, rows: IntArray, dimension: int) -> FloatArray:
    """Distances (N,) of points (N, D) to the flat that fits some of them best in the least squares sense.

    Its dimension is `dimension`, or one less than the number of `rows` where these are few.
    """
    mean = points[rows].mean(axis=0)
    _, _, right = np.linalg.svd(points[rows] - mean, full_matrices=False)
    basis = right[: min(dimension, len(rows) - 1)]
    centred = points - mean
    return np.asarray(np.linalg.norm(centred - (centred @ basis.T) @ basis, axis=1))
