"""What a camera sees at one moment: rays to surface points, and surface points to pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kt3dmoseg.synthetic.raycast import NEAR, SKY, Grid, Points, Rays, cast
from kt3dmoseg.synthetic.surfaces import Mesh
from kt3dmoseg.types import BoolArray, FloatArray, IntArray

_SAME_DEPTH = 1e-6  # relative; a point is hidden only by what is nearer than this


@dataclass(frozen=True, eq=False)
class View:
    """A scene in the coordinates of the camera at one moment.

    Parameters
    ----------
    mesh : Mesh
        All faces in camera coordinates.
    poses : (B, 4, 4) float64
        ``T_cam_body``, the static scene first.
    K : (3, 3) float64
        Intrinsic matrix without skew.
    image_size : (W, H)
        Pixels.
    """

    mesh: Mesh
    poses: FloatArray
    K: FloatArray
    image_size: tuple[int, int]

    def grid(self, x: FloatArray, y: FloatArray) -> Grid:
        """Rays through the pixels at columns `x` and rows `y`."""
        return Grid((x - self.K[0, 2]) / self.K[0, 0], (y - self.K[1, 2]) / self.K[1, 1])

    def pixels(self) -> Grid:
        """Rays through all pixel centres."""
        width, height = self.image_size
        return self.grid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))

    def points(self, xy: FloatArray) -> Points:
        """Rays through image positions (R, 2)."""
        return Points((xy[:, 0] - self.K[0, 2]) / self.K[0, 0], (xy[:, 1] - self.K[1, 2]) / self.K[1, 1])

    def locate(self, rays: Rays) -> tuple[FloatArray, IntArray]:
        """Find the surface points that rays hit.

        Returns
        -------
        points : (R, 4) float64
            Homogeneous, in the coordinates of their bodies. The sky is at infinity: its points are
            directions, with last coordinate 0.
        body : (R,) int64
            0 = static scene and sky.
        """
        depth, face = (part.ravel() for part in cast(self.mesh, rays))
        sky = face == SKY
        z = np.where(sky, 1.0, depth)
        x, y = rays.directions()
        seen = np.stack([x * z, y * z, z, np.where(sky, 0.0, 1.0)], axis=1)
        body = np.where(sky, 0, self.mesh.body[face])
        to_bodies = np.asarray(np.linalg.inv(self.poses), dtype=np.float64)
        return _transform(to_bodies, body, seen), body

    def project(self, points: FloatArray, body: IntArray) -> tuple[FloatArray, BoolArray]:
        """Find where surface points, as `locate` gives them, are in the image.

        Returns
        -------
        xy : (R, 2) float64
            Pixels; NaN behind the camera.
        visible : (R,) bool
            Whether the point is inside the image and nothing hides it.
        """
        seen = _transform(self.poses, body, points)
        z = np.where(seen[:, 2] > NEAR * seen[:, 3], seen[:, 2], np.nan)
        z[z <= 0] = np.nan
        xy = np.stack([seen[:, k] / z * self.K[k, k] + self.K[k, 2] for k in (0, 1)], axis=1)
        inside = np.flatnonzero(((xy >= -0.5) & (xy < np.array(self.image_size) - 0.5)).all(axis=1))
        nearest, _ = cast(self.mesh, self.points(xy[inside]))
        with np.errstate(divide="ignore"):
            own = seen[inside, 2] / seen[inside, 3]  # infinite in the sky
        visible = np.zeros(len(xy), dtype=np.bool_)
        visible[inside] = nearest >= own * (1 - _SAME_DEPTH)
        return xy, visible


def _transform(poses: FloatArray, body: IntArray, points: FloatArray) -> FloatArray:
    """Apply to every point (R, 4) the pose of its body."""
    out = np.empty_like(points)
    for k, pose in enumerate(poses):
        rows = body == k
        out[rows] = points[rows] @ pose.T
    return out
