"""The drives of the synthetic benchmark: drawn from a seed, one hardness at a time, measured, and clips.

A drive is drawn until its vehicles collide with nothing and are in view long enough to be tracked. What
makes it hard is then measured on the exact geometry, not taken from what was intended.
"""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np

from kt3dmoseg import synthetic
from kt3dmoseg.errors import KT3DMoSegError
from kt3dmoseg.frames import FrameInfo, FrameSource
from kt3dmoseg.io.images import Colour
from kt3dmoseg.synthetic.scene import BACKGROUND, FRAMES_PER_SECOND, Layout, Scene, SceneOptions
from kt3dmoseg.synthetic.street import street
from kt3dmoseg.synthetic.vehicles import LANE, ONCOMING, PARKED_RIGHT, Drive, Kind, Vehicle
from kt3dmoseg.types import ByteArray, FloatArray, IntArray, Labels, Trajectories

Part: TypeAlias = Literal["public", "test"]
CameraKind: TypeAlias = Literal["driving", "planar", "turning", "rotating", "standing"]
Trait: TypeAlias = Literal["none", "epipolar", "small", "intermittent"]
KeyT = TypeVar("KeyT")

PER_PART = 100
SAMPLES = 1  # ray per pixel: half the time of four, and tracks with an eighth more noise
_PARTS: tuple[Part, ...] = ("public", "test")
# How many of the hundred drives of a part have so many motions, such a camera, such a hardness.
_MOTIONS = {1: 8, 2: 30, 3: 26, 4: 20, 5: 10, 6: 6}
_CAMERAS: dict[CameraKind, int] = {"driving": 46, "planar": 12, "turning": 18, "rotating": 12, "standing": 12}
_TRAITS: dict[Trait, int] = {"none": 40, "epipolar": 20, "small": 20, "intermittent": 20}
_ALONG = ("leading", "overtaking", "oncoming")  # roles whose course is the camera's
_ROLES = (*_ALONG, "leaving", "crossing", "walking", "riding")
_KINDS: dict[str, tuple[Kind, ...]] = {
    "walking": ("pedestrian",),
    "riding": ("cyclist",),
    "leaving": ("car", "van"),
}
# Grey levels. Beyond 2 this is no camera's, but gives the tracks the noise of the real clips, where contrast
# is lower and light changes.
_NOISE = 1.5, 5.0
_FREE = 60.0  # metres of the right-hand kerb without parked cars, where one leaves
_TRIES = 400
_GRID = 8  # pixels between the points at which a drive is measured: those of the tracker
_SEEN, _LARGE, _SHARE = 14, 5000, 0.5  # points on a vehicle in view, at most, in this share of the frames
_LEAST_MOTION = 1.0  # pixels in five frames; what moves less nobody would label
_GAP = 5  # frames between which motion is measured
_STILL = 0.02  # metres; a camera that moves less between two frames only turns
_ON_IT = 0.75  # share of a trajectory's frames that must lie on one object


@dataclass(frozen=True)
class DrivePlan:
    """What is intended for one drive of the benchmark."""

    seed: int  # other than 0 it is in the drive's name
    part: Part
    number: int  # from 1 to 100 in either part
    motions: int  # with the static scene
    camera: CameraKind
    trait: Trait

    @property
    def name(self) -> str:
        """``synth_p001`` of the public part, ``synth_t001`` of the test part."""
        return f"synth{self.seed or ''}_{self.part[0]}{self.number:03d}"


def plan_drives(seed: int = 0) -> list[DrivePlan]:
    """Plan the 200 drives of a seed; both parts have as many of each number, and nearly of each kind."""
    plans = []
    for half, part in enumerate(_PARTS):
        rng = np.random.default_rng([seed, half])
        motions, cameras = _shuffled(_MOTIONS, rng), _shuffled(_CAMERAS, rng)
        for k, trait in enumerate(_shuffled(_TRAITS, rng)):
            plan = DrivePlan(seed, part, k + 1, motions[k], cameras[k], trait if motions[k] > 1 else "none")
            if plan.trait == "epipolar" and plan.camera != "planar":
                plan = replace(plan, camera="driving")  # one that only turns has no epipolar lines
            plans.append(plan)
    return plans


def _shuffled(counts: Mapping[KeyT, int], rng: np.random.Generator) -> list[KeyT]:
    """List every key as often as it counts, in random order."""
    each = [key for key, count in counts.items() for _ in range(count)]
    return [each[k] for k in rng.permutation(len(each))]


def make_drive(plan: DrivePlan) -> Scene:
    """Make the scene of a plan; the same plan gives the same scene."""
    rng, film = (np.random.default_rng([plan.seed, _PARTS.index(plan.part), plan.number, k]) for k in (7, 8))
    noise = float(_NOISE[0] * (_NOISE[1] / _NOISE[0]) ** film.random())
    for _ in range(_TRIES):
        frames, textures = int(rng.integers(10, 21)), int(rng.integers(1 << 31))
        layout = _draw_layout(plan, (frames - 1) / FRAMES_PER_SECOND, rng)
        if layout is None:
            continue
        scene = Scene(SceneOptions(frames=frames, seed=textures, noise=noise, samples=SAMPLES), layout)
        if _in_view(scene) and _LEAST_MOTION <= measure_drive(scene).get("motion", _LEAST_MOTION) < np.inf:
            return scene
    raise KT3DMoSegError(f"{plan.name}: no such drive in {_TRIES} tries")


def _draw_layout(plan: DrivePlan, seconds: float, rng: np.random.Generator) -> Layout | None:
    """Draw motions and surroundings; None where they collide."""
    draw = rng.uniform
    speed, turn = {
        "driving": (draw(3, 11), draw(-3, 3)),
        "planar": (draw(3, 11), draw(-3, 3)),
        "turning": (draw(3, 8), rng.choice([-1, 1]) * draw(8, 20)),
        "rotating": (0.0, rng.choice([-1, 1]) * draw(4, 12)),
        "standing": (0.0, 0.0),
    }[plan.camera]
    middle = speed * seconds / 2
    crossing = middle + draw(14, 34)
    camera = Drive(LANE, middle, 0.0, speed, 0.0 if plan.trait == "epipolar" else np.radians(turn))
    special = int(rng.integers(plan.motions - 1)) if plan.motions > 1 else -1
    bodies = [Vehicle("camera", "car", camera)]
    for k in range(plan.motions - 1):
        trait = plan.trait if k == special or plan.trait == "epipolar" else "none"
        for _ in range(30):
            vehicle = _draw_vehicle(trait, camera, crossing, seconds, rng)
            if not any(_collide(vehicle, other, seconds) for other in bodies):
                bodies.append(vehicle)
                break
        else:
            return None
    vehicles = bodies[1:]
    kerb = middle - _FREE / 2, middle + _FREE / 2
    free = kerb if any(abs(v.drive.x - PARKED_RIGHT) < 2 for v in vehicles) else (crossing, crossing)
    shake = 1.0 if plan.camera in ("driving", "turning") else 0.0
    view = draw(8, 75)  # metres from the side street to where the street ends: how deep the scene is
    return Layout(camera, vehicles, street(rng, 2 * middle, crossing, free, view), shake)


def _draw_vehicle(
    trait: Trait, camera: Drive, crossing: float, seconds: float, rng: np.random.Generator
) -> Vehicle:
    """Draw a vehicle that keeps to the camera's course, moves little, or in a part of the clip only."""
    draw, side, speed = rng.uniform, int(rng.choice([-1, 1])), camera.speed
    role = str(rng.choice(_ALONG if trait == "epipolar" else _ROLES))
    across, weave = side * np.pi / 2, draw(-0.12, 0.12)
    # x, z ahead of the camera in the middle of the clip, heading, speed
    x, z, yaw, pace = {
        "leading": (LANE + draw(-0.3, 0.3), draw(6, 30), weave, speed * draw(0.7, 1.2) + draw(0.5, 3)),
        "overtaking": (ONCOMING + draw(-0.3, 0.3), draw(5, 22), weave, speed + draw(1, 5)),
        "oncoming": (ONCOMING + draw(-0.3, 0.3), draw(8, 32), np.pi + weave, draw(2, 8)),
        "leaving": (PARKED_RIGHT, draw(6, 16), draw(-0.4, -0.1), 0.6 * speed + draw(0.3, 1.5)),
        "crossing": (draw(-6, 6), crossing - camera.z + side * 1.6, across, draw(2, 8)),
        "walking": (draw(-6, 6.5), draw(4, 20), rng.choice([across, across, 0, np.pi]), draw(0.8, 1.8)),
        "riding": (draw(-5, 4), draw(5, 24), rng.choice([across, 0, np.pi]), draw(2, 5)),
    }[role]
    rate = draw(-0.15, 0.15) if role in ("leading", "leaving", "crossing") else 0.0
    during = (-np.inf, np.inf)
    if trait == "epipolar":
        yaw, rate = (np.pi if role == "oncoming" else 0.0), 0.0
    elif trait == "small":
        pace = draw(0.2, 0.8)
    elif trait == "intermittent":
        change = draw(-0.2, 0.2) * seconds
        during = (-np.inf, change) if rng.random() < 0.5 else (change, np.inf)
    kinds = _KINDS.get(role, ("car", "van", "truck"))
    kind = kinds[int(rng.integers(len(kinds)))]
    drive = Drive(float(x), float(camera.z + z), float(yaw), float(pace), float(rate), during)
    return Vehicle(f"{role} {kind}", kind, drive)


def _collide(first: Vehicle, second: Vehicle, seconds: float) -> bool:
    """Whether two vehicles meet, with some room, at any of seven moments of a clip of so many seconds."""
    width, _, length = second.size
    for time in np.linspace(-seconds / 2, seconds / 2, 7):
        apart = np.linalg.inv(first.drive.pose(time)) @ second.drive.pose(time)
        ahead, aside = abs(apart[2, 2]), abs(apart[0, 2])
        across = 0.5 * (first.size[0] + width * ahead + length * aside) + 0.3
        along = 0.5 * (first.size[2] + length * ahead + width * aside) + 0.5
        if abs(apart[0, 3]) < across and abs(apart[2, 3]) < along:
            return True
    return False


def _in_view(scene: Scene) -> bool:
    """Whether every vehicle shows enough, and not too much, in enough frames."""
    n = len(scene.vehicles)
    seen = [_grid_bodies(scene, frame)[1] for frame in range(0, scene.n_frames, 3)]
    counts = np.array([np.bincount(body, minlength=n + 1)[1:] for body in seen])
    return bool(((counts >= _SEEN).mean(axis=0) >= _SHARE).all() and (counts < _LARGE).all())


def _grid_bodies(scene: Scene, frame: int) -> tuple[FloatArray, IntArray]:
    """Surface points (R, 4) of the tracker's grid in a frame, and their bodies."""
    x, y = np.meshgrid(*(np.arange(_GRID // 2, side, _GRID) for side in scene.image_size))
    return scene.surface_points(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, frame)]))


def measure_drive(scene: Scene) -> Mapping[str, float]:
    """Measure on the exact geometry what makes a drive hard.

    Every figure is that of the hardest vehicle, over the points of an 8 px grid in three frames; motion is
    measured over five frames. ``depth``: 95th to 5th percentile of the static scene's depth; and where
    something moves ``size``: points of the grid on the vehicle, ``epipolar``: pixels from the epipolar lines
    of the static scene (where the camera only turns: from where its rotation takes a point), ``motion``:
    pixels from where the point would be if it stood still, ``standing``: share of the frames in which it
    stands, ``occlusion``: share of its points in the image that something hides.
    """
    frames = [0, scene.n_frames // 2, scene.n_frames - 1]
    found = [_grid_bodies(scene, frame) for frame in frames]
    points, body = (np.concatenate(parts) for parts in zip(*found, strict=True))
    static = scene.depth(frames[1])[scene.ids(frames[1]) == 1]
    facts = {"depth": float(np.divide(*np.percentile(static, [95, 5])))}
    bodies = range(1, len(scene.vehicles) + 1)
    sizes = [float(max(np.count_nonzero(seen == k) for _, seen in found)) for k in bodies]
    movers = [_measure_vehicle(scene, points[body == k], k) | {"size": sizes[k - 1]} for k in bodies]
    hardest = {"size": min, "epipolar": min, "motion": min, "standing": max, "occlusion": max}
    if movers:
        facts |= {name: float(worst(m[name] for m in movers)) for name, worst in hardest.items()}
    return facts


def _measure_vehicle(scene: Scene, points: FloatArray, body: int) -> dict[str, float]:
    places = [scene.project(frame, points, np.full(len(points), body)) for frame in range(scene.n_frames)]
    xy, visible = (np.stack(parts, axis=1) for parts in zip(*places, strict=True))
    inside = np.all((xy >= 0) & (xy <= np.array(scene.image_size) - 1), axis=2)
    apart, moved = [], []
    for first in range(0, scene.n_frames - _GAP, 2):
        second = first + _GAP
        rows = visible[:, first] & inside[:, second]
        if rows.any():
            before, after = scene.body_poses(first), scene.body_poses(second)
            relative = after[0] @ np.linalg.inv(before[0])  # of the camera, against the static scene
            turned = (points[rows] @ before[body].T)[:, :3] @ relative[:3, :3].T
            seen, standing = xy[rows, second], _image(scene, turned + relative[:3, 3])
            moved.append(np.median(np.linalg.norm(seen - standing, axis=1)))
            infinity = _image(scene, turned)  # the line's other end: the point, infinitely far away
            line = standing - infinity
            line /= np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-12)
            (x, y), (u, v) = (seen - infinity).T, line.T
            off = np.median(np.abs(x * v - y * u))
            apart.append(off if np.linalg.norm(relative[:3, 3]) > _STILL else moved[-1])
    poses = [scene.vehicles[body - 1].drive.pose(scene.time(frame)) for frame in range(scene.n_frames)]
    return {
        "epipolar": float(np.mean(apart)) if apart else np.inf,
        "motion": float(np.mean(moved)) if moved else np.inf,
        "standing": float(np.mean([np.allclose(*pair, atol=1e-9) for pair in pairwise(poses)])),
        "occlusion": float((inside & ~visible).sum() / max(1, inside.sum())),
    }


def _image(scene: Scene, points: FloatArray) -> FloatArray:
    """Project points (R, 3) in camera coordinates, in pixels (R, 2)."""
    homogeneous = points @ scene.K.T
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


@dataclass(frozen=True)
class SyntheticDrive(FrameSource):
    """A drive of the synthetic benchmark as a source of frames that knows its labels."""

    plan: DrivePlan

    @property
    def name(self) -> str:
        return self.plan.name

    @property
    def where(self) -> str:
        return f"synthetic drive {self.name}"

    @cached_property
    def scene(self) -> Scene:
        """The scene, made on first use."""
        return make_drive(self.plan)

    def inspect(self) -> FrameInfo:
        """Describe the drive: what its bytes depend on."""
        versions = {"samples": SAMPLES, "version": synthetic.ALGORITHM_VERSION}
        return FrameInfo({"kind": "synthetic"} | asdict(self.plan) | versions)

    def numbers(self) -> range:
        return range(self.scene.n_frames)

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        del colour
        return map(self.scene.frame, range(self.scene.n_frames))

    def label(self, tracks: Trajectories) -> Labels:
        """Label trajectories by what is exactly below them.

        That is the object under three quarters of its points, 1 = static scene and sky, 2, 3, ... = the
        vehicles. A trajectory that slides from one object onto another has label 0.
        """
        votes = np.zeros((len(tracks), 2 + len(self.scene.vehicles)))
        last = np.array(self.scene.image_size) - 1
        for frame in range(tracks.n_frames):
            rows, xy = tracks.at(frame)
            x, y = np.rint(xy).astype(np.int64).clip(0, last).T
            votes[rows, np.maximum(self.scene.ids(frame)[y, x], BACKGROUND)] += 1
        label = np.where(votes.max(axis=1) >= _ON_IT * tracks.lengths, votes.argmax(axis=1), 0)
        return Labels(label, BACKGROUND, self.scene.names)

    def measure(self) -> Mapping[str, Any]:
        """Measure what makes it hard: the plan's camera, and what `measure_drive` finds."""
        return {"camera": self.plan.camera} | dict(measure_drive(self.scene))
