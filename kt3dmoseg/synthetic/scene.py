"""A synthetic scene: rendered frames, and everything about them that is known exactly."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.options import check, option
from kt3dmoseg.synthetic import render
from kt3dmoseg.synthetic.street import street
from kt3dmoseg.synthetic.vehicles import CROSSING_AHEAD, Drive, Vehicle, traffic, vehicle_faces
from kt3dmoseg.types import (
    BoolArray,
    ByteArray,
    Clip,
    Float32Array,
    FloatArray,
    IntArray,
    Labels,
    Trajectories,
)

FRAMES_PER_SECOND = 10.0
BACKGROUND = 1
# KITTI's rectified gray camera of 2011_09_26: focal length and principal point at 1242 x 375.
_FOCAL, _CENTRE, _KITTI_SIZE = 721.5377, (609.5593, 172.854), (1242, 375)
_CAMERA_HEIGHT = 1.65
_PITCH, _ROLL, _BOUNCE = 0.0035, 0.0025, 0.012  # radians, radians, metres: a car on its springs
_RAYS = 200_000  # painted together, as long as they fit into the caches of a processor
_SAME_DEPTH = 1e-6  # relative; a point is hidden only by what is nearer than this


@dataclass(frozen=True)
class SceneOptions:
    """Options of a synthetic drive.

    The defaults give a clip with the size, focal length, frame rate and image noise of a KITTI raw drive.

    Raises
    ------
    InvalidValueError
        When a number is out of bounds.
    """

    width: int = option(1242, "image width in pixels", low=64, high=4096)
    height: int = option(375, "image height in pixels", low=32, high=4096)
    frames: int = option(12, "number of frames, 10 a second", low=1, high=2000)
    objects: int = option(3, "number of independently moving vehicles", low=0, high=4)
    seed: int = option(0, "seed of everything random: street, textures, motions, image noise", low=0)
    speed: float = option(5.0, "speed of the camera in m/s", low=0.0, high=40.0)
    turn: float = option(3.0, "yaw rate of the camera in degrees per second, to the right", low=-45, high=45)
    noise: float = option(1.5, "standard deviation of the image noise in grey levels", low=0.0, high=50.0)
    samples: int = option(2, "rays per pixel: the square of this", low=1, high=8)

    def __post_init__(self) -> None:
        check(self, where="SceneOptions")


class Layout(NamedTuple):
    """What a scene consists of, besides its pictures' size and number."""

    camera: Drive  # time 0 is the middle of the clip
    vehicles: list[Vehicle]
    faces: list[render.Face]  # of the static scene
    shake: float = 1.0  # how much the camera car nods and rolls on its springs; 0: not at all


def usual_layout(options: SceneOptions, rng: np.random.Generator) -> Layout:
    """Lay out the scene that `SceneOptions` describe."""
    length = options.speed * (options.frames - 1) / FRAMES_PER_SECOND
    middle, swept = length / 2, 4.0 + 0.5 * length
    camera = Drive(0.0, middle, 0.0, options.speed, np.radians(options.turn))
    vehicles = traffic(rng, options.objects, middle, options.speed)
    free = middle + 8 - swept, middle + 10 + swept
    return Layout(camera, vehicles, street(rng, length, middle + CROSSING_AHEAD, free))


class Scene:
    """A street with moving vehicles, filmed from a moving car.

    Frames count from 0; pixel coordinates have (0, 0) at the centre of the top-left pixel; object ids are 0
    for the sky, 1 for the static scene, 2, 3, ... for ``vehicles[0]``, ...

    Parameters
    ----------
    options : SceneOptions
        Size, length, number of moving objects, seed and so on. Same options, same bytes.
    layout : Layout, optional
        Other motions, objects and surroundings than `usual_layout` gives.

    Attributes
    ----------
    camera : Drive
        Motion of the camera car; time 0 is the middle of the clip.
    vehicles : list of Vehicle
        The moving objects.
    """

    def __init__(self, options: SceneOptions, layout: Layout | None = None) -> None:
        self.options, rng = options, np.random.default_rng([options.seed, 0, 0])
        self.camera, self.vehicles, faces, self._shake = layout or usual_layout(options, rng)
        for body, vehicle in enumerate(self.vehicles, start=1):
            faces = [*faces, *(face._replace(body=body) for face in vehicle_faces(vehicle.kind, rng))]
        self._faces, self._mesh = faces, render.Mesh.of(faces)

    @cached_property
    def _painter(self) -> render.Painter:
        return render.Painter(np.random.default_rng([self.options.seed, 0, 1]), self._faces)

    @property
    def n_frames(self) -> int:
        """Number of frames F."""
        return self.options.frames

    @property
    def image_size(self) -> tuple[int, int]:
        """(W, H) in pixels."""
        return self.options.width, self.options.height

    @property
    def names(self) -> dict[int, str]:
        """What each label is called."""
        return {BACKGROUND: "background"} | {k + 2: v.name for k, v in enumerate(self.vehicles)}

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
        """``T_world_cam`` (4, 4); world: x right, y down, z along the street, metres.

        The camera is mounted on a car that nods and rolls a little.
        """
        if frame != int(frame) or not 0 <= frame < self.n_frames:
            expected = f"a whole number in 0..{self.n_frames - 1}"
            raise InvalidValueError("frame", expected=expected, found=f"{frame}")
        time, phase = self.time(frame), float(self.options.seed % 7)
        pitch = self._shake * _PITCH * np.sin(7.0 * time + phase)
        roll = self._shake * _ROLL * np.sin(5.0 * time + 2 * phase)
        mount = np.eye(4)
        mount[:3, :3] = render.rotation(0, pitch) @ render.rotation(2, roll)
        mount[1, 3] = -_CAMERA_HEIGHT + self._shake * _BOUNCE * np.sin(9.0 * time + 3 * phase)
        return self.camera.pose(time) @ mount

    def body_poses(self, frame: int) -> FloatArray:
        """``T_cam_body`` (1 + vehicles, 4, 4): the static scene first, then every vehicle."""
        inverse, time = np.linalg.inv(self.camera_pose(frame)), self.time(frame)
        return np.stack([inverse, *(inverse @ vehicle.drive.pose(time) for vehicle in self.vehicles)])

    def frame(self, frame: int) -> ByteArray:
        """Render a frame, (H, W) uint8: the same bytes whenever and in whatever order it is called."""
        camera, mesh = self.camera_pose(frame), self._mesh_at(frame)
        spacing = 1.0 / (self.options.samples * self.K[0, 0])
        # One pixel more on each side: pixels also gather their neighbours' light.
        x, y = (np.arange(-1, size + 1, dtype=np.float64) for size in self.image_size)
        offsets = render.ray_offsets(self.options.samples)
        light = np.zeros(self.image_size[::-1])
        together = max(1, _RAYS // light.size)
        for some in np.split(offsets, range(together, len(offsets), together)):
            rays = self._rays(x + some[:, :1, None], y[:, None] + some[:, 1:, None])
            for seen, offset in zip(self._painter.paint(mesh, *rays, camera, spacing), some, strict=True):
                light += render.gather(seen, offset)
        rng = np.random.default_rng([self.options.seed, 1 + frame])
        return render.expose(light / len(offsets), self.options.noise, rng)

    def frames(self) -> list[ByteArray]:
        """All frames."""
        return [self.frame(i) for i in range(self.n_frames)]

    def ids(self, frame: int) -> ByteArray:
        """Object id at every pixel centre, (H, W) uint8."""
        face = render.cast(self._mesh_at(frame), *self._pixels())[1]
        return np.where(face == render.SKY, 0, self._mesh.body[face] + BACKGROUND).astype(np.uint8)

    def depth(self, frame: int) -> FloatArray:
        """Depth (z in metres) at every pixel centre, (H, W) float64; infinite in the sky."""
        return render.cast(self._mesh_at(frame), *self._pixels())[0]

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
        xy, visible = self.project(j, *self._locate(i, *self._pixels()))
        moved = xy.reshape(height, width, 2) - np.dstack(np.meshgrid(np.arange(width), np.arange(height)))
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
        surface = self.surface_points(points)
        found = [self.project(frame, *surface) for frame in range(self.n_frames)]
        xy, visible = (np.stack(parts, axis=1) for parts in zip(*found, strict=True))
        return Trajectories(np.where(visible[..., None], xy, np.nan), visible, image_size=self.image_size)

    def labels(self, points: npt.ArrayLike) -> Labels:
        """Motion labels of the surface points at `points` (S, 3).

        1 = background, the sky too; 2, 3, ... = ``vehicles[0]``, ``vehicles[1]``, ...
        """
        return Labels(self.surface_points(points)[1] + BACKGROUND, BACKGROUND, self.names)

    def clip(self, spacing: float = 16.0, name: str = "synthetic") -> Clip:
        """Make a clip of the exact trajectories and labels of a grid in the middle frame.

        `spacing` is the distance of the points of the grid, in pixels; points of the sky are left out.
        """
        (width, height), middle = self.image_size, self.n_frames // 2
        x, y = np.meshgrid(*(np.arange(spacing / 2, side, spacing) for side in (width, height)))
        points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, middle)])
        points = points[np.isfinite(self.depth(middle)[tuple(points[:, 1::-1].astype(int).T)])]
        tracks = self.trajectories(points)
        return Clip(name, tracks, np.arange(len(tracks)), self.labels(points))

    def _mesh_at(self, frame: int) -> render.Mesh:
        """All faces in camera coordinates."""
        return self._mesh.moved(self.body_poses(frame))

    def _rays(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        return (x - self.K[0, 2]) / self.K[0, 0], (y - self.K[1, 2]) / self.K[1, 1]

    def _pixels(self) -> tuple[FloatArray, FloatArray]:
        x, y = (np.arange(size, dtype=np.float64) for size in self.image_size)
        return self._rays(x[None], y[:, None])

    def _locate(self, frame: int, x: FloatArray, y: FloatArray) -> tuple[FloatArray, IntArray]:
        """Find the surface points (R, 4) that rays hit, and their bodies (R,).

        Points are homogeneous, in the coordinates of their bodies. The sky is at infinity and part of the
        static scene: its points are directions, with last coordinate 0.
        """
        depth, face = (part.ravel() for part in render.cast(self._mesh_at(frame), x, y))
        sky, (x, y) = face == render.SKY, (part.ravel() for part in np.broadcast_arrays(x, y))
        z = np.where(sky, 1.0, depth)
        seen = np.stack([x * z, y * z, z, np.where(sky, 0.0, 1.0)], axis=1)
        body = np.where(sky, 0, self._mesh.body[face])
        to_bodies = np.asarray(np.linalg.inv(self.body_poses(frame)), dtype=np.float64)
        return _transform(to_bodies, body, seen), body

    def project(self, frame: int, points: FloatArray, body: IntArray) -> tuple[FloatArray, BoolArray]:
        """Find where surface points are in a frame, (R, 2), NaN behind the camera, and which are seen."""
        seen = _transform(self.body_poses(frame), body, points)
        z = np.where(seen[:, 2] > np.maximum(render.NEAR * seen[:, 3], 0), seen[:, 2], np.nan)
        xy = np.stack([seen[:, k] / z * self.K[k, k] + self.K[k, 2] for k in (0, 1)], axis=1)
        inside = np.flatnonzero(((xy >= -0.5) & (xy < np.array(self.image_size) - 0.5)).all(axis=1))
        nearest, _ = render.cast(self._mesh_at(frame), *self._rays(*xy[inside].T))
        with np.errstate(divide="ignore"):
            own = seen[inside, 2] / seen[inside, 3]  # infinite in the sky
        visible = np.zeros(len(xy), dtype=np.bool_)
        visible[inside] = nearest >= own * (1 - _SAME_DEPTH)
        return xy, visible

    def surface_points(self, points: npt.ArrayLike) -> tuple[FloatArray, IntArray]:
        """Find the surface points (S, 4) at x, y, frame and their bodies (S,); see `_locate`."""
        seeds = np.array(points if np.size(points) else np.zeros((0, 3)), dtype=np.float64)
        if seeds.ndim != 2 or seeds.shape[1] != 3 or not np.isfinite(seeds).all():
            expected = "finite x, y, frame of shape (S, 3)"
            raise InvalidValueError("points", expected=expected, found=f"shape {seeds.shape}")
        found, body = np.zeros((len(seeds), 4)), np.zeros(len(seeds), dtype=np.int64)
        for frame in np.unique(seeds[:, 2]):
            rows = np.flatnonzero(seeds[:, 2] == frame)
            found[rows], body[rows] = self._locate(frame, *self._rays(*seeds[rows, :2].T))
        return found, body


def _transform(poses: FloatArray, body: IntArray, points: FloatArray) -> FloatArray:
    """Apply to every point (R, 4) the pose of its body."""
    out = np.empty_like(points)
    for k, pose in enumerate(poses):
        rows = body == k
        out[rows] = points[rows] @ pose.T
    return out


def make_scene(options: SceneOptions | None = None) -> Scene:
    """Make a scene, see `Scene`; without options the usual one."""
    return Scene(options or SceneOptions())


def track_errors(scene: Scene, tracks: Trajectories, after: int | None = None) -> FloatArray:
    """Measure how far trajectories are from the truth, some frames after their starts.

    Parameters
    ----------
    scene : Scene
        The scene that was tracked.
    tracks : Trajectories
        N trajectories without gaps.
    after : int or None
        Number of frames; None = at the last frame of each trajectory.

    Returns
    -------
    (N,) float64
        Pixels to where the surface point at the trajectory's start really is; NaN where the trajectory
        or the point is not seen then.
    """
    rows = np.arange(len(tracks))
    start = tracks.visible.argmax(axis=1)
    end = start + (tracks.lengths - 1 if after is None else after)
    truth = scene.trajectories(np.column_stack([tracks.xy[rows, start], start]))
    within = np.minimum(end, tracks.n_frames - 1)
    apart = np.linalg.norm(tracks.xy[rows, within] - truth.xy[rows, within], axis=1)
    return np.where(end == within, apart, np.nan)
