"""Vehicles made of boxes: cars, vans and trucks, parked or moving."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from kt3dmoseg.synthetic.materials import Mark, Painted, Plain, block_letters
from kt3dmoseg.synthetic.motion import Drive, rotation_y
from kt3dmoseg.synthetic.surfaces import Face, Skin, box, frustum

Kind: TypeAlias = Literal["car", "van", "truck"]

_SIZES: dict[Kind, tuple[float, float, float]] = {
    "car": (1.78, 1.48, 4.3),
    "van": (1.95, 2.05, 5.0),
    "truck": (2.4, 3.1, 7.2),
}
_GREYS = (55.0, 75.0, 95.0, 150.0, 205.0, 225.0)


@dataclass(frozen=True, eq=False)
class Vehicle:
    """A rigid moving object.

    Parameters
    ----------
    name : str
        For instance ``"oncoming van"``.
    kind : str
        ``"car"``, ``"van"`` or ``"truck"``.
    drive : Drive
        Its motion; time 0 is the middle of the clip.
    size : (width, height, length)
        Metres.
    """

    name: str
    kind: Kind
    drive: Drive
    size: tuple[float, float, float]


def make_vehicle(name: str, kind: Kind, drive: Drive) -> Vehicle:
    """Describe a vehicle of the usual size of its kind."""
    return Vehicle(name, kind, drive, _SIZES[kind])


def vehicle_faces(kind: Kind, rng: np.random.Generator) -> list[Face]:
    """Faces of a vehicle around its origin, which is on the ground below its middle."""
    width, height, length = _SIZES[kind]
    grey, salt = float(rng.choice(_GREYS)), float(rng.uniform(0, 50))
    paint = Plain(grey, fine=6.0, coarse=11.0, salt=salt)
    half, under = width / 2, Plain(18.0, fine=5.0, coarse=3.0, salt=salt)
    floor, waist = 0.28, 0.86 if kind == "car" else height
    hollow = Skin.all(under)
    body = Skin(
        _nose(paint, width, waist, rng),
        _tail(paint, width, waist, kind, rng),
        _flank(paint, kind, rng),
        paint,
    )
    faces = box((-half + 0.12, -floor, -length / 2 + 0.1), (half - 0.12, 0.0, length / 2 - 0.1), hollow)
    nose = (0.1, 0.05, 0.0) if kind == "car" else (0.45, 0.0, 0.06) if kind == "van" else (0.0, 0.0, 0.0)
    faces += frustum((-half, -waist, -length / 2), (half, -floor, length / 2), body, nose)
    faces += _wheels(half, length)
    if kind == "car":
        faces += _cabin(paint, half, waist, height, length)
    return faces


def placed(faces: Sequence[Face], x: float, z: float, yaw: float) -> list[Face]:
    """Give the faces of a body that stands still at a place in the world."""
    turn, shift = rotation_y(yaw), np.array([x, 0.0, z])
    return [replace(f, origin=turn @ f.origin + shift, eu=turn @ f.eu, ev=turn @ f.ev) for f in faces]


def _wheels(half: float, length: float) -> list[Face]:
    rim = Painted(
        Plain(20.0, 3.0, 3.0),
        (Mark((0.12, 0.54), (0.12, 0.54), 150.0, True), Mark((0.26, 0.40), (0.26, 0.40), 60.0, True)),
    )
    tread = Plain(22.0, 4.0, 2.0)
    skin = Skin(tread, tread, rim, tread)
    axles = []
    for z in (-0.31 * length, 0.31 * length):
        # One dark block per axle, a centimetre proud of the flanks; nobody looks under a car.
        axles += box((-half - 0.01, -0.66, z - 0.33), (half + 0.01, 0.0, z + 0.33), skin)
    return axles


def _flank(paint: Plain, kind: Kind, rng: np.random.Generator) -> Painted:
    _, height, length = _SIZES[kind]
    dark = paint.grey * 0.45
    seams = [Mark((s * length, s * length + 0.025), (0.0, 0.9), dark) for s in (0.3, 0.52, 0.72)]
    trim = [Mark((0.1, length - 0.1), (0.2, 0.27), dark)]
    if kind == "car":
        handles = [Mark((s * length, s * length + 0.18), (0.42, 0.47), 30.0) for s in (0.32, 0.54)]
        return Painted(paint, (*seams, *trim, *handles))
    ink = 40.0 if paint.grey > 110 else 215.0
    letters = block_letters(rng, (0.1 * length, 0.85 * length), (0.75, height - 0.75), 4, 16, ink)
    return Painted(paint, (*seams, *trim, *letters))


def _nose(paint: Plain, width: float, waist: float, rng: np.random.Generator) -> Painted:
    high = waist - 0.28
    lamps = [Mark((u, u + 0.32), (0.25, 0.43), 235.0) for u in (0.1, width - 0.42)]
    grille = Mark((0.5, width - 0.5), (0.12, 0.4), 25.0)
    plate = Mark((width / 2 - 0.26, width / 2 + 0.26), (0.06, 0.17), 225.0)
    glass = (Mark((0.12, width - 0.12), (0.55 * high, 0.92 * high), 45.0),) if high > 1 else ()
    letters = block_letters(rng, (width / 2 - 0.23, width / 2 + 0.23), (0.08, 0.15), 1, 7, 50.0)
    return Painted(paint, (grille, *lamps, plate, *letters, *glass))


def _tail(paint: Plain, width: float, waist: float, kind: Kind, rng: np.random.Generator) -> Painted:
    high = waist - 0.28
    lamps = [Mark((u, u + 0.2), (0.25, 0.5), 85.0) for u in (0.05, width - 0.25)]
    bumper = Mark((0.0, width), (0.0, 0.12), 40.0)
    plate = Mark((width / 2 - 0.26, width / 2 + 0.26), (0.22, 0.33), 230.0)
    letters = block_letters(rng, (width / 2 - 0.23, width / 2 + 0.23), (0.24, 0.31), 1, 7, 50.0)
    marks = [bumper, *lamps, plate, *letters]
    if kind == "van":
        marks.append(Mark((0.15, width - 0.15), (0.55 * high, 0.9 * high), 40.0))
        marks.append(Mark((width / 2 - 0.015, width / 2 + 0.015), (0.12, high), paint.grey * 0.5))
    if kind == "truck":
        ink = 40.0 if paint.grey > 110 else 215.0
        marks += block_letters(rng, (0.3, width - 0.3), (0.8, high - 0.4), 5, 6, ink)
    return Painted(paint, tuple(marks))


def _cabin(paint: Plain, half: float, waist: float, height: float, length: float) -> list[Face]:
    high, deep = height - waist, 0.62 * length
    inner = half - 0.08
    pane = Mark((0.1, 2 * inner - 0.1), (0.04, high + 0.05), 42.0)
    reflection = Mark((0.35, inner), (0.1, high), 95.0)
    ends = Painted(paint, (pane, reflection))
    glass = [Mark(u, (0.05, high - 0.07), 38.0) for u in ((0.3, 0.48 * deep), (0.52 * deep, deep - 0.3))]
    heads = [Mark((u, u + 0.22), (0.08, 0.36), 75.0) for u in (0.27 * deep, 0.62 * deep)]
    skin = Skin(ends, ends, Painted(paint, (*glass, *heads)), paint)
    back = -0.45 * length
    return frustum((-inner, -height, back), (inner, -waist, back + deep), skin, (0.75, 0.45, 0.16))
