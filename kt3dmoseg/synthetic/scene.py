"""A synthetic scene: rendered frames, and everything about them that is known exactly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.synthetic.motion import Drive, camera_pose
from kt3dmoseg.synthetic.options import FRAMES_PER_SECOND, SceneOptions
from kt3dmoseg.synthetic.raycast import SKY, cast
from kt3dmoseg.synthetic.sensor import expose, gather, ray_offsets
from kt3dmoseg.synthetic.shading import Painter
from kt3dmoseg.synthetic.street import street
from kt3dmoseg.synthetic.surfaces import Face, Mesh, on_body
from kt3dmoseg.synthetic.traffic import CROSSING_AHEAD, traffic
from kt3dmoseg.synthetic.vehicles import Vehicle, vehicle_faces
from kt3dmoseg.synthetic.view import View
from kt3dmoseg.types import BoolArray, ByteArray, Float32Array, FloatArray, IntArray, Labels, Trajectories

# KITTI's rectified gray camera of 2011_09_26: focal length and principal point at 1242 x 375.
_FOCAL, _CENTRE, _KITTI_SIZE = 721.5377, (609.5593, 172.854), (1242, 375)
BACKGROUND = 1


@dataclass(frozen=True, eq=False)
class Scene:
    """A street with moving vehicles, filmed from a moving car.

    Made by `make_scene`. Frames count from 0; pixel coordinates have (0, 0) at the centre of the top-left
    pixel; object ids are 0 for the sky, 1 for the static scene, 2, 3, ... for ``vehicles[0]``, ...

    Parameters
    ----------
    options : SceneOptions
        What was asked for.
    camera : Drive
        Motion of the camera car; time 0 is the middle of the clip.
    vehicles : tuple of Vehicle
        The moving objects.
    faces : tuple of Face
        All surfaces.
    painter : Painter
        Turns hits into grey values.
    """

    options: SceneOptions
    camera: Drive
    vehicles: tuple[Vehicle, ...]
    faces: tuple[Face, ...]
    painter: Painter

    @property
    def n_frames(self) -> int:
        """Number of frames F."""
        return self.options.frames

    @property
    def image_size(self) -> tuple[int, int]:
        """(W, H) in pixels."""
        return self.options.width, self.options.height

    @property
    def K(self) -> FloatArray:
        """Intrinsic matrix (3, 3): KITTI's, scaled to the image width; the horizon keeps its height."""
        width, height = self.image_size
        scale = width / _KITTI_SIZE[0]
        centre = (_CENTRE[0] + 0.5) * scale - 0.5, (_CENTRE[1] + 0.5) * height / _KITTI_SIZE[1] - 0.5
        return np.array([[_FOCAL * scale, 0.0, centre[0]], [0.0, _FOCAL * scale, centre[1]], [0.0, 0.0, 1.0]])

    def time(self, frame: int) -> float:
        """Seconds from the middle of the clip."""
        return (frame - (self.n_frames - 1) / 2) / FRAMES_PER_SECOND

    def camera_pose(self, frame: int) -> FloatArray:
        """``T_world_cam`` (4, 4); world: x right, y down, z along the street, metres."""
        return camera_pose(self.camera, self.time(self._checked(frame)), phase=float(self.options.seed % 7))

    def body_poses(self, frame: int) -> FloatArray:
        """``T_cam_body`` (1 + vehicles, 4, 4): the static scene first, then every vehicle."""
        inverse = np.linalg.inv(self.camera_pose(frame))
        time = self.time(frame)
        return np.stack([inverse, *(inverse @ vehicle.drive.pose(time) for vehicle in self.vehicles)])

    def frame(self, frame: int) -> ByteArray:
        """Render a frame, (H, W) uint8: the same bytes whenever and in whatever order it is called."""
        rng = np.random.default_rng([self.options.seed, 1 + frame])
        return expose(self._light(frame), self.options.noise, rng)

    def frames(self) -> list[ByteArray]:
        """All frames."""
        return [self.frame(i) for i in range(self.n_frames)]

    def ids(self, frame: int) -> ByteArray:
        """Object id at every pixel centre, (H, W) uint8."""
        view = self._view(frame)
        _, face = cast(view.mesh, view.pixels())
        ids: ByteArray = np.where(face == SKY, 0, view.mesh.body[face] + BACKGROUND).astype(np.uint8)
        return ids

    def depth(self, frame: int) -> FloatArray:
        """Depth (z in metres) at every pixel centre, (H, W) float64; infinite in the sky."""
        view = self._view(frame)
        return cast(view.mesh, view.pixels())[0]

    def flow(self, i: int, j: int) -> tuple[Float32Array, BoolArray]:
        """Exact optical flow from frame `i` to frame `j`.

        Returns
        -------
        flow : (H, W, 2) float32
            Where the surface point at a pixel centre of `i` is in `j`, minus the pixel centre. Also given
            where something hides the point in `j`; 0 where the point is behind the camera in `j`.
        valid : (H, W) bool
            Whether the point is seen in `j`: inside the image and not hidden.
        """
        width, height = self.image_size
        view = self._view(i)
        xy, visible = self._view(j).project(*view.locate(view.pixels()))
        centres = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=2)
        moved = xy.reshape(height, width, 2) - centres
        return np.nan_to_num(moved).astype(np.float32), visible.reshape(height, width)

    def trajectories(self, points: npt.ArrayLike) -> Trajectories:
        """Exact trajectories of surface points over all frames.

        Parameters
        ----------
        points : (S, 3) array_like
            x, y and frame where each point is seen.

        Returns
        -------
        Trajectories
            Row s follows the surface point at ``points[s]``, before and after its frame; visible wherever
            it is inside the image and not hidden, so there may be gaps.
        """
        seeds = self._seeds(points)
        surface = self._at(seeds)
        shape = len(seeds), self.n_frames
        xy, visible = np.full((*shape, 2), np.nan), np.zeros(shape, dtype=bool)
        for frame in range(self.n_frames):
            where, seen = self._view(frame).project(*surface)
            xy[seen, frame], visible[:, frame] = where[seen], seen
        return Trajectories(xy, visible, image_size=self.image_size)

    def labels(self, points: npt.ArrayLike) -> Labels:
        """Motion labels of the surface points at `points` (S, 3).

        1 = background, the sky too; 2, 3, ... = ``vehicles[0]``, ``vehicles[1]``, ...
        """
        _, body = self._at(self._seeds(points))
        names = {BACKGROUND: "background"} | {k + 2: v.name for k, v in enumerate(self.vehicles)}
        return Labels(body + BACKGROUND, background=BACKGROUND, names=names)

    @cached_property
    def _mesh(self) -> Mesh:
        return Mesh.of(self.faces)

    def _light(self, frame: int) -> FloatArray:
        """Light that every pixel gathers, (H, W) float64."""
        view, n = self._view(frame), self.options.samples
        camera, spacing = self.camera_pose(frame), 1.0 / (n * self.K[0, 0])
        places = [np.arange(-1, size + 1, dtype=np.float64) for size in self.image_size]
        offsets = ray_offsets(n)
        image = np.zeros(self.image_size[::-1])
        for offset in offsets:
            rays = view.grid(places[0] + offset[0], places[1] + offset[1])
            image += gather(self.painter.paint(view.mesh, rays, camera, spacing), offset)
        return image / len(offsets)

    def _view(self, frame: int) -> View:
        poses = self.body_poses(frame)
        return View(self._mesh.moved(poses), poses, self.K, self.image_size)

    def _at(self, seeds: FloatArray) -> tuple[FloatArray, IntArray]:
        """Find the surface points (S, 4) at x, y, frame and their bodies (S,); see `View.locate`."""
        points, body = np.zeros((len(seeds), 4)), np.zeros(len(seeds), dtype=np.int64)
        for frame in np.unique(seeds[:, 2]):
            rows = np.flatnonzero(seeds[:, 2] == frame)
            view = self._view(frame)
            points[rows], body[rows] = view.locate(view.points(seeds[rows, :2]))
        return points, body

    def _seeds(self, points: npt.ArrayLike) -> FloatArray:
        seeds = np.array(points, dtype=np.float64)
        if not seeds.size:
            return np.zeros((0, 3))
        if seeds.ndim != 2 or seeds.shape[1] != 3 or not np.isfinite(seeds).all():
            raise InvalidValueError(
                "points", expected="finite x, y, frame of shape (S, 3)", found=f"shape {seeds.shape}"
            )
        for frame in np.unique(seeds[:, 2]):
            self._checked(frame)
        return seeds

    def _checked(self, frame: float) -> int:
        if frame != int(frame) or not 0 <= frame < self.n_frames:
            raise InvalidValueError(
                "frame", expected=f"a whole number in 0..{self.n_frames - 1}", found=f"{frame}"
            )
        return int(frame)


def make_scene(options: SceneOptions | None = None) -> Scene:
    """Make a scene.

    Parameters
    ----------
    options : SceneOptions, optional
        Size, length, number of moving objects, seed and so on. Same options, same bytes.
    """
    chosen = options or SceneOptions()
    layout, looks = (np.random.default_rng([chosen.seed, 0, k]) for k in (0, 1))
    length = chosen.speed * (chosen.frames - 1) / FRAMES_PER_SECOND
    middle = length / 2
    vehicles = traffic(layout, chosen.objects, middle, chosen.speed)
    swept = 4.0 + 0.5 * length
    faces = street(layout, length, middle + CROSSING_AHEAD, (middle + 8 - swept, middle + 10 + swept))
    for body, vehicle in enumerate(vehicles, start=1):
        faces += on_body(vehicle_faces(vehicle.kind, layout), body)
    camera = Drive(0.0, middle, 0.0, chosen.speed, np.radians(chosen.turn))
    return Scene(chosen, camera, tuple(vehicles), tuple(faces), Painter.make(looks, faces))
