"""From hits to grey values: materials in sunlight and sky along rays, pixels that gather them, the camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kt3dmoseg.synthetic.materials import Noise, Patch
from kt3dmoseg.synthetic.raycast import SKY, Face, Mesh, Rays, cast, footprint, surface_coordinates
from kt3dmoseg.types import ByteArray, FloatArray, IntArray

_SUN = np.array([0.45, -0.8, -0.4]) / np.linalg.norm([0.45, -0.8, -0.4])  # towards the sun
_AMBIENT, _DIRECT = 0.6, 0.5
_GAIN, _GAMMA, _WHITE = 1.25, 1.4, 255.0


class Painter:
    """Shades the faces of one scene.

    The brightness of a face follows Lambert's law with its normal in body coordinates, so that a turning
    vehicle keeps its grey values.
    """

    def __init__(self, rng: np.random.Generator, faces: Sequence[Face]) -> None:
        normals = np.stack([np.cross(face.eu, face.ev) for face in faces])
        self._light = _AMBIENT + _DIRECT * np.clip(normals @ _SUN, 0, None)
        self._materials = [face.material for face in faces]
        self._grain, self._cloud = Noise(rng, 0.55), Noise(rng, 1.1)

    def paint(self, mesh: Mesh, rays: Rays, camera: FloatArray, spacing: float) -> FloatArray:
        """Grey value of every ray of a grid, `spacing` apart on the plane z = 1, by ``T_world_cam``."""
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
            grey[where] = self._light[row] * self._materials[row](
                Patch(u, v, fu, fv, self._grain, self._cloud)
            )
        return grey.reshape(rays.shape)

    def _sky(self, x: FloatArray, y: FloatArray, camera: FloatArray) -> FloatArray:
        direction = np.stack([x, y, np.ones_like(x)], axis=1) @ camera[:3, :3].T
        around = np.arctan2(direction[:, 0], direction[:, 2])
        up = np.arctan2(-direction[:, 1], np.hypot(direction[:, 0], direction[:, 2]))
        fine = np.full_like(around, 1e-3)
        grey: FloatArray = 228 + 14 * self._cloud.sample(around, up, fine, fine, 1.7) - 30 * up
        return grey


def _groups(face: IntArray) -> list[tuple[int, IntArray]]:
    """Rows of each distinct face number."""
    order = np.argsort(face.astype(np.int16), kind="stable")
    starts = np.flatnonzero(np.diff(face[order], prepend=SKY - 1))
    return [(int(face[order[s]]), rows) for s, rows in zip(starts, np.split(order, starts[1:]), strict=True)]


def ray_offsets(samples: int) -> FloatArray:
    """Where in a pixel its rays pass, relative to its centre: (n^2, 2), x and y in (-0.5, 0.5).

    A square grid of n x n rays turned by atan(1/n): all n^2 rays lie in different columns and in
    different rows, so that an upright edge moves over the pixel in steps of 1/n^2 instead of 1/n.
    """
    count = samples * samples
    column = np.arange(1, count + 1)
    row = samples * column % (count + 1)
    return (np.stack([column, row], axis=1) - 0.5) / count - 0.5


def gather(light: FloatArray, offset: FloatArray) -> FloatArray:
    """Give every pixel the light of its own ray and of its neighbours', weighed by a tent two pixels wide.

    That is about the blur of a good lens on a sensor. The weights of one ray per pixel add to 1, and a
    linear ramp stays what it is, wherever in the pixel the rays pass. `light` (H + 2, W + 2) has one pixel
    more on each side; `offset` is where the rays pass, x and y relative to the pixels' centres.
    """
    for shift in offset[::-1]:
        before, here, after = (max(0.0, 1 - abs(shift + step)) for step in (-1, 0, 1))
        light = (before * light[:-2] + here * light[1:-1] + after * light[2:]).T
    return light


def respond(light: FloatArray) -> FloatArray:
    """Grey value of light: 255 (1.25 light / 255)^1.4, saturated at 255.

    The two constants bring contrast, gradients and the share of saturated pixels to those of KITTI's gray
    cameras on the 22 clips (docs/synthetic.md).
    """
    grey: FloatArray = _WHITE * np.clip(_GAIN * light / _WHITE, 0, 1) ** _GAMMA
    return grey


def expose(image: FloatArray, noise: float, rng: np.random.Generator) -> ByteArray:
    """Turn light (H, W) into grey values: the camera's response, then Gaussian noise of this deviation."""
    seen = respond(image) + noise * rng.standard_normal(image.shape)
    grey: ByteArray = np.clip(np.rint(seen), 0, 255).astype(np.uint8)
    return grey
