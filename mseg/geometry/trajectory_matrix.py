"""The trajectory matrix: 2F rows x1, y1, x2, y2, ..., one column per trajectory, and its subspaces.

Under an affine camera the trajectories of one rigid motion span at most four dimensions (Tomasi and
Kanade, IJCV 1992); every method that segments by subspaces starts from this matrix.
"""

from __future__ import annotations

import numpy as np

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import Camera, FloatArray, Trajectories


def normalising_matrix(trajectories: Trajectories, camera: Camera | None = None) -> FloatArray:
    """Matrix that maps normalised to pixel coordinates, by the first of three rules that applies.

    1. The camera's own matrix ``K``. Hopkins155 files hold the one with which that benchmark
       normalised its coordinates, so that ``x = inv(K) y`` is the file's own ``x``.
    2. The image size: the borders map to -1 and 1, ``x = 2 y / size - 1`` in each direction (the
       convention of most Hopkins155 sequences; anisotropic).
    3. The range of the visible positions stands in for the image borders, in each direction.

    Parameters
    ----------
    trajectories : Trajectories
        Their image size, and their positions where there is nothing better.
    camera : Camera or None
        The clip's camera.

    Returns
    -------
    (3, 3) float64
        Upper triangular, invertible.

    Raises
    ------
    InvalidValueError
        When the camera's matrix is singular or its last row is not (0, 0, 1).
    """
    if camera is not None and camera.K is not None:
        affine = np.isfinite(camera.K).all() and np.array_equal(camera.K[2], (0, 0, 1))
        if not affine or np.linalg.matrix_rank(camera.K) < 3:
            raise InvalidValueError(
                "camera.K", expected="invertible, last row 0 0 1", found=str(camera.K.tolist())
            )
        return camera.K
    if trajectories.image_size is not None:
        half = np.array(trajectories.image_size) / 2
        return _scaling(half, half)
    seen = trajectories.xy[trajectories.visible]
    if not len(seen):
        return np.eye(3)
    low, high = seen.min(axis=0), seen.max(axis=0)
    half = (high - low) / 2
    return _scaling(np.where(half > 0, half, 1.0), (low + high) / 2)


def normalised(trajectories: Trajectories, matrix: FloatArray) -> FloatArray:
    """Positions mapped by the inverse of `matrix`.

    Parameters
    ----------
    trajectories : Trajectories
        N trajectories over F frames.
    matrix : (3, 3) float64
        Maps normalised to pixel coordinates, of `normalising_matrix`.

    Returns
    -------
    (N, F, 2) float64
        NaN where invisible.
    """
    inverse = np.linalg.inv(matrix)
    return np.asarray(trajectories.xy @ inverse[:2, :2].T + inverse[:2, 2], dtype=np.float64)


def trajectory_matrix(xy: FloatArray) -> FloatArray:
    """Stack positions (N, F, 2) into the matrix (2F, N), rows x1, y1, x2, y2, ...; NaN stays NaN."""
    return np.ascontiguousarray(xy.reshape(len(xy), -1).T)


def leading_row_space(matrix: FloatArray, dimension: int) -> FloatArray:
    """Leading right singular vectors: whitened coordinates of the columns.

    Parameters
    ----------
    matrix : (D, N) float64
        Complete data.
    dimension : int
        Number of vectors wanted; clipped to the smaller side of `matrix`.

    Returns
    -------
    (N, r) float64
        Orthonormal columns, by decreasing singular value (which is dropped).
    """
    _, _, right = np.linalg.svd(matrix, full_matrices=False)
    return np.ascontiguousarray(right[:dimension].T)


def project(matrix: FloatArray, dimension: int) -> FloatArray:
    """Coordinates of the columns in the best subspace of a dimension: ``U_r^T X``, uncentred PCA.

    Parameters
    ----------
    matrix : (D, N) float64
        Complete data.
    dimension : int
        Dimension r, clipped to the smaller side of `matrix`.

    Returns
    -------
    (r, N) float64
        Projected columns; inner products are those of the best rank-r approximation.
    """
    left, _, _ = np.linalg.svd(matrix, full_matrices=False)
    return np.asarray(left[:, :dimension].T @ matrix, dtype=np.float64)


def _scaling(half: FloatArray, centre: FloatArray) -> FloatArray:
    return np.array([[half[0], 0, centre[0]], [0, half[1], centre[1]], [0, 0, 1]], dtype=np.float64)
