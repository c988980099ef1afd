"""Moving bodies: how they drive, what vehicles look like, and which ones a scene has.

World coordinates are in metres: x right, y down, z forward along the street, y = 0 on the road. A body
has the same axes, its origin on the ground. Poses are 4x4 matrices ``T_world_body`` that take body to world
coordinates.
"""

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from kt3dmoseg.synthetic.materials import Mark, Material, Plain, block_letters, painted
from kt3dmoseg.synthetic.render import Face, box, rotation
from kt3dmoseg.types import FloatArray

Kind: TypeAlias = Literal["car", "van", "truck", "cyclist", "pedestrian"]

CROSSING_AHEAD = 27.0  # metres from the camera to the side street in the middle of the clip
LANE, ONCOMING = 0.0, -3.5  # x of the middle of the lanes
PARKED_RIGHT = 3.15
_SIZES: dict[Kind, tuple[float, float, float]] = {
    "car": (1.78, 1.48, 4.3),
    "van": (1.95, 2.05, 5.0),
    "truck": (2.4, 3.1, 7.2),
    "cyclist": (0.55, 1.75, 1.75),
    "pedestrian": (0.6, 1.75, 0.45),
}
_INSETS = {"car": (0.1, 0.05, 0.0), "van": (0.45, 0.0, 0.06), "truck": (0.0, 0.0, 0.0)}
_GREYS = (55.0, 75.0, 95.0, 150.0, 205.0, 225.0)
_FLOOR = 0.28  # metres from the ground to the body
_SWAY = 0.6  # metres; a body weaves about its straight path by at most twice this
_SLOWEST_WEAVE = 0.5  # radians per second


@dataclass(frozen=True)
class Drive:
    """Motion along a gentle weave: near time 0 a turn at a constant rate, in the long run straight on."""

    x: float  # metres, at time 0 as all the others
    z: float
    yaw: float = 0.0  # heading in radians; 0 looks along +z, positive turns right
    speed: float = 0.0  # metres per second along the heading
    yaw_rate: float = 0.0  # radians per second
    during: tuple[float, float] = (-np.inf, np.inf)  # seconds between which it moves at all

    def pose(self, time: float) -> FloatArray:
        """``T_world_body`` (4, 4) at `time` seconds.

        Sideways s(t) = v r / w^2 (1 - cos wt) and heading atan(r / w sin wt), the direction of travel, so
        that s'' (0) / v is the yaw rate r; w is chosen so that v r / w^2 stays within the lane.
        """
        time = min(max(time, self.during[0]), self.during[1])
        weave = max(_SLOWEST_WEAVE, np.sqrt(self.speed * abs(self.yaw_rate) / _SWAY))
        aside = self.speed * self.yaw_rate / weave**2 * (1 - np.cos(weave * time))
        pose, base = np.eye(4), rotation(1, self.yaw)
        pose[:3, :3] = base @ rotation(1, np.arctan(self.yaw_rate / weave * np.sin(weave * time)))
        pose[:3, 3] = [self.x, 0.0, self.z] + base @ [aside, 0.0, self.speed * time]
        return pose


@dataclass(frozen=True)
class Vehicle:
    """A rigid moving object."""

    name: str  # for instance "oncoming van"
    kind: Kind
    drive: Drive  # its motion; time 0 is the middle of the clip

    @property
    def size(self) -> tuple[float, float, float]:
        """Width, height and length in metres."""
        return _SIZES[self.kind]


def traffic(rng: np.random.Generator, count: int, middle: float, speed: float) -> list[Vehicle]:
    """Choose `count` vehicles that all are in view in the middle of the clip and do not collide.

    They come in the order of how far their points leave the epipolar lines of the static scene. `middle` is
    the z of the camera in the middle of the clip, `speed` its speed.
    """
    draw, side, slow = rng.uniform, int(rng.choice([-1, 1])), 0.6 * speed
    across, ahead = side * np.pi / 2, CROSSING_AHEAD + side * 1.4
    kinds: dict[str, tuple[Kind, ...]] = {
        "crossing": ("truck",), "leading": ("car", "van"), "leaving": ("car",), "oncoming": ("van", "car")
    }  # fmt: skip
    drives = [  # x, z, heading, speed, yaw rate
        Drive(ONCOMING + draw(1.0, 3.0), middle + ahead, across, draw(3.5, 5.5), draw(-0.1, 0.1)),
        Drive(LANE + draw(-0.2, 0.2), middle + draw(11.5, 12.2), draw(-0.12, -0.07), speed + draw(0.8, 1.5)),
        Drive(PARKED_RIGHT, middle + draw(7.5, 8.3), -0.15, slow + draw(0.3, 1.2), draw(-0.2, -0.1)),
        Drive(ONCOMING + draw(-0.1, 0.2), middle + draw(12.5, 15), np.pi + draw(0.05, 0.12), draw(2.5, 5.0)),
    ]
    vehicles = []
    for (role, choice), drive in list(zip(kinds.items(), drives, strict=True))[:count]:
        kind = choice[int(rng.integers(len(choice)))]
        vehicles.append(Vehicle(f"{role} {kind}", kind, drive))
    return vehicles


def vehicle_faces(kind: Kind, rng: np.random.Generator) -> list[Face]:
    """Faces of a vehicle around its origin, which is on the ground below its middle."""
    width, height, length = _SIZES[kind]
    grey, salt = float(rng.choice(_GREYS)), rng.uniform(0, 50)
    if kind in ("pedestrian", "cyclist"):
        return _figure(kind, grey, salt, rng)
    half, waist = width / 2, 0.86 if kind == "car" else height
    paint, under = Plain(grey, 6.0, 11.0, salt), Plain(18.0, 5.0, 3.0, salt)
    skin = {"front": _nose(paint, width, waist, rng), "back": _tail(paint, width, waist, kind, rng)}
    skin["side"] = _flank(paint, kind, rng)
    faces = box((-half + 0.12, -_FLOOR, -length / 2 + 0.1), (half - 0.12, 0.0, length / 2 - 0.1), under)
    faces += box((-half, -waist, -length / 2), (half, -_FLOOR, length / 2), paint, _INSETS[kind], **skin)
    marks = [Mark(u, u, grey, True) for u, grey in (((0.12, 0.54), 150.0), ((0.26, 0.40), 60.0))]
    tread, rim = Plain(22.0, 4.0, 2.0), painted(Plain(20.0, 3.0, 3.0), marks)
    for z in (-0.31 * length, 0.31 * length):
        # One dark block per axle, a centimetre proud of the flanks; nobody looks under a car.
        faces += box((-half - 0.01, -0.66, z - 0.33), (half + 0.01, 0.0, z + 0.33), tread, side=rim)
    return faces + (_cabin(paint, half, waist, height, length) if kind == "car" else [])


def _figure(kind: Kind, grey: float, salt: float, rng: np.random.Generator) -> list[Face]:
    """Someone on foot or on a bicycle, as stiff as the vehicles: legs or wheels, a coat, a head."""
    width, height, length = _SIZES[kind]
    half, thin, lower = width / 2, width / 2 - 0.08, 0.85
    coat, legs = Plain(grey, 14.0, 18.0, salt), Plain(float(rng.choice(_GREYS)), 12.0, 12.0, salt + 1)
    marks = block_letters(rng, (0.05, width - 0.05), (0.1, 0.5), 3, 3, 255.0 - grey)
    side: Material = legs
    if kind == "cyclist":
        thin, tyres = 0.06, [(0.02, 0.66), (length - 0.66, length - 0.02)]
        wheels = [Mark(u, (0.02, 0.66), 25.0, True) for u in tyres]
        wheels += [Mark((u + 0.06, v - 0.06), (0.08, 0.6), 120.0, True) for u, v in tyres]
        side = painted(Plain(75.0, 12.0, 12.0, salt + 1), wheels)
    faces = box((-thin, -lower, -length / 2), (thin, 0.0, length / 2), legs, side=side)
    faces += box((-half, -1.45, -0.2), (half, -lower, 0.2), painted(coat, marks), (0.03, 0.03, 0.06))
    return faces + box((-0.11, -height, -0.11), (0.11, -1.45, 0.11), Plain(170.0, 20.0, 10.0, salt))


def _flank(paint: Plain, kind: Kind, rng: np.random.Generator) -> Material:
    _, height, length = _SIZES[kind]
    dark = paint.grey * 0.45
    marks = [Mark((s * length, s * length + 0.025), (0.0, 0.9), dark) for s in (0.3, 0.52, 0.72)]
    marks.append(Mark((0.1, length - 0.1), (0.2, 0.27), dark))
    if kind == "car":
        marks += [Mark((s * length, s * length + 0.18), (0.42, 0.47), 30.0) for s in (0.32, 0.54)]
    else:
        marks += block_letters(rng, (0.1 * length, 0.85 * length), (0.75, height - 0.75), 4, 16, _ink(paint))
    return painted(paint, marks)


def _ink(paint: Plain) -> float:
    return 40.0 if paint.grey > 110 else 215.0


def _plate(width: float, foot: float, grey: float, rng: np.random.Generator) -> list[Mark]:
    middle = width / 2
    letters = block_letters(rng, (middle - 0.23, middle + 0.23), (foot + 0.02, foot + 0.09), 1, 7, 50.0)
    return [Mark((middle - 0.26, middle + 0.26), (foot, foot + 0.11), grey), *letters]


def _nose(paint: Plain, width: float, waist: float, rng: np.random.Generator) -> Material:
    high, marks = waist - _FLOOR, [Mark((0.5, width - 0.5), (0.12, 0.4), 25.0)]
    marks += [Mark((u, u + 0.32), (0.25, 0.43), 235.0) for u in (0.1, width - 0.42)]
    marks += _plate(width, 0.06, 225.0, rng)
    if high > 1:
        marks.append(Mark((0.12, width - 0.12), (0.55 * high, 0.92 * high), 45.0))
    return painted(paint, marks)


def _tail(paint: Plain, width: float, waist: float, kind: Kind, rng: np.random.Generator) -> Material:
    high, marks = waist - _FLOOR, [Mark((0.0, width), (0.0, 0.12), 40.0)]
    marks += [Mark((u, u + 0.2), (0.25, 0.5), 85.0) for u in (0.05, width - 0.25)]
    marks += _plate(width, 0.22, 230.0, rng)
    if kind == "van":
        marks.append(Mark((0.15, width - 0.15), (0.55 * high, 0.9 * high), 40.0))
        marks.append(Mark((width / 2 - 0.015, width / 2 + 0.015), (0.12, high), paint.grey * 0.5))
    if kind == "truck":
        marks += block_letters(rng, (0.3, width - 0.3), (0.8, high - 0.4), 5, 6, _ink(paint))
    return painted(paint, marks)


def _cabin(paint: Plain, half: float, waist: float, height: float, length: float) -> list[Face]:
    high, deep, inner, back = height - waist, 0.62 * length, half - 0.08, -0.45 * length
    pane = Mark((0.1, 2 * inner - 0.1), (0.04, high + 0.05), 42.0)
    ends = painted(paint, (pane, Mark((0.35, inner), (0.1, high), 95.0)))  # with a reflection
    glass = [Mark(u, (0.05, high - 0.07), 38.0) for u in ((0.3, 0.48 * deep), (0.52 * deep, deep - 0.3))]
    heads = [Mark((u, u + 0.22), (0.08, 0.36), 75.0) for u in (0.27 * deep, 0.62 * deep)]
    skin = {"front": ends, "back": ends, "side": painted(paint, (*glass, *heads))}
    return box((-inner, -height, back), (inner, -waist, back + deep), paint, (0.75, 0.45, 0.16), **skin)
