"""From hits to grey values: materials, sunlight, sky."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kt3dmoseg.synthetic.materials import Material, Patch
from kt3dmoseg.synthetic.noise import Noise
from kt3dmoseg.synthetic.raycast import SKY, Grid, cast, footprint, surface_coordinates
from kt3dmoseg.synthetic.surfaces import Face, Mesh
from kt3dmoseg.types import FloatArray, IntArray

_SUN = np.array([0.45, -0.8, -0.4]) / np.linalg.norm([0.45, -0.8, -0.4])  # towards the sun
_AMBIENT, _DIRECT = 0.6, 0.5


@dataclass(frozen=True, eq=False)
class Painter:
    """Shades the faces of one scene.

    Parameters
    ----------
    materials : sequence of Material
        One per face.
    light : (F,) float64
        Brightness of each face: Lambert's law with its normal in body coordinates, so that a turning
        vehicle keeps its grey values.
    grain, cloud : Noise
        Fine and coarse noise for all materials.
    """

    materials: tuple[Material, ...]
    light: FloatArray
    grain: Noise
    cloud: Noise

    @classmethod
    def make(cls, rng: np.random.Generator, faces: Sequence[Face]) -> Painter:
        """Prepare the painter of a scene."""
        normals = np.stack([np.cross(face.eu, face.ev) for face in faces])
        light = _AMBIENT + _DIRECT * np.clip(normals @ _SUN, 0, None)
        return cls(tuple(f.material for f in faces), light, Noise(rng, 0.55), Noise(rng, 1.1))

    def paint(self, mesh: Mesh, rays: Grid, camera: FloatArray, spacing: float) -> FloatArray:
        """Grey value of every ray.

        Parameters
        ----------
        mesh : Mesh
            Faces in camera coordinates.
        rays : Grid
            Rays, `spacing` apart.
        camera : (4, 4) float64
            ``T_world_cam``, for the sky.
        spacing : float
            Distance of neighbouring rays on the plane z = 1.

        Returns
        -------
        (H, W) float64
        """
        depth, face = cast(mesh, rays)
        x, y = rays.directions()
        grey = np.empty(x.shape)
        z = depth.ravel()
        for row, where in _groups(face.ravel()):
            if row == SKY:
                grey[where] = self._sky(x[where], y[where], camera)
                continue
            at = x[where], y[where], z[where]
            u, v = surface_coordinates(mesh, row, *at)
            fu, fv = footprint(mesh, row, *at, spacing)
            patch = Patch(u, v, fu, fv, self.grain, self.cloud)
            grey[where] = self.light[row] * self.materials[row].shade(patch)
        return grey.reshape(rays.shape)

    def _sky(self, x: FloatArray, y: FloatArray, camera: FloatArray) -> FloatArray:
        direction = np.stack([x, y, np.ones_like(x)], axis=1) @ camera[:3, :3].T
        around = np.arctan2(direction[:, 0], direction[:, 2])
        up = np.arctan2(-direction[:, 1], np.hypot(direction[:, 0], direction[:, 2]))
        fine = np.full_like(around, 1e-3)
        clouds = self.cloud.sample(around, up, fine, fine, 1.7)
        grey: FloatArray = 228 + 14 * clouds - 30 * up
        return grey


def _groups(face: IntArray) -> list[tuple[int, IntArray]]:
    """Rows of each distinct face number."""
    order = np.argsort(face.astype(np.int16), kind="stable")
    starts = np.flatnonzero(np.diff(face[order], prepend=SKY - 1))
    return [(int(face[order[s]]), rows) for s, rows in zip(starts, np.split(order, starts[1:]), strict=True)]
