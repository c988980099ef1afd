"""Flats: affine subspaces through samples of points, many at once.

Under an affine camera the trajectories of a rigid motion lie on a flat of dimension three at most.
"""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import FloatArray, IntArray


def flat_distances(points: FloatArray, samples: IntArray) -> FloatArray:
    """Distances of points to the flats through samples of them.

    Parameters
    ----------
    points : (N, D) float64
        Points as rows.
    samples : (M, p) int64
        The p points that each flat, of dimension p - 1, passes through. A flat through points that
        depend on each other is one of those that contain them.

    Returns
    -------
    (N, M) float64
        Euclidean distances; zero everywhere where D < p: such a flat is all of space.
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


def best_flat_distances(points: FloatArray, members: IntArray, dimension: int) -> FloatArray:
    """Distances (N,) of points (N, D) to the flat that fits the members best in the least squares sense.

    Its dimension is `dimension`, or one less than the number of members where these are few.
    """
    mean = points[members].mean(axis=0)
    _, _, right = np.linalg.svd(points[members] - mean, full_matrices=False)
    basis = right[: min(dimension, len(members) - 1)]
    centred = points - mean
    return np.asarray(np.linalg.norm(centred - (centred @ basis.T) @ basis, axis=1))
