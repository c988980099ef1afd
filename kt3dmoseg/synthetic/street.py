"""The static part of a scene: road, pavements, houses, a side street, parked cars, posts and hedges."""

from functools import partial

import numpy as np

from kt3dmoseg.synthetic import materials
from kt3dmoseg.synthetic.materials import Mark, Material, Plain, painted
from kt3dmoseg.synthetic.render import Face, box, placed
from kt3dmoseg.synthetic.vehicles import PARKED_RIGHT, Kind, vehicle_faces

_PARKED_LEFT = -6.55
_KERB_RIGHT, _KERB_LEFT = 4.3, -7.7
_WALL_RIGHT, _WALL_LEFT = 8.0, -11.4
_SIDE_STREET = 5.0  # half its width
_BEHIND = 14.0


def street(
    rng: np.random.Generator, length: float, crossing: float, free: tuple[float, float], view: float = 75.0
) -> list[Face]:
    """Build a straight street with one side street.

    The camera drives `length` metres from z = 0; `crossing` is the z of the side street's middle, `free` the
    range of z on the right-hand side without parked cars; the houses end `view` metres after the crossing.
    """
    end = max(length, crossing) + view
    faces = [_road(rng, end, crossing)]
    for start, stop in ((-_BEHIND, crossing - _SIDE_STREET), (crossing + _SIDE_STREET, end)):
        faces += _pavements(rng, start, stop)
        faces += _houses(rng, start, stop, _WALL_LEFT, -1) + _houses(rng, start, stop, _WALL_RIGHT, 1)
        faces += _furniture(rng, start, stop)
    for x, yaw in ((PARKED_RIGHT, 0.0), (_PARKED_LEFT, np.pi)):
        taken = [(crossing - 8, crossing + 8), *([free] if x > 0 else [])]
        faces += _parked(rng, x, yaw, end, taken)
    return faces + _horizon(rng, end, crossing)


def _road(rng: np.random.Generator, end: float, crossing: float) -> Face:
    left = -160.0
    lines = ((-1.75 - left, 3.0), (1.95 - left, 0.0), (-5.4 - left, 0.0))
    grey, salt = rng.uniform(88, 112), rng.uniform(0, 50)
    look = partial(materials.asphalt, grey=grey, salt=salt, lines=lines)
    surface = partial(look, crossing=crossing + _BEHIND, shade_edge=_KERB_RIGHT - left)
    right, _, forward = np.eye(3)
    return Face(surface, np.array([left, 0.0, -_BEHIND]), right, forward, (320.0, end + 90 + _BEHIND))


def _pavements(rng: np.random.Generator, start: float, stop: float) -> list[Face]:
    faces = []
    for x0, x1, lit in ((_WALL_LEFT - 2, _KERB_LEFT, 1.0), (_KERB_RIGHT, _WALL_RIGHT + 2, materials.SHADOW)):
        kerb = Plain(125.0, 10.0, 8.0, rng.uniform(0, 50))
        size, salt = float(rng.choice([0.35, 0.5])), rng.uniform(0, 50)
        slabs = partial(materials.paving, grey=lit * rng.uniform(115, 145), slab=size, salt=salt)
        faces += box((x0, -0.13, start), (x1, 0.0, stop), kerb, top=slabs)
    return faces


def _houses(rng: np.random.Generator, start: float, stop: float, wall: float, side: int) -> list[Face]:
    faces, z = [], start
    while z < stop - 3:
        length = min(rng.uniform(9, 17), stop - z)
        height, front = rng.uniform(8.5, 15), wall + side * rng.uniform(0, 1.2)
        x0, x1 = sorted((front, front + side * 12))
        faces += box((x0, -height, z), (x1, 0.0, z + length), materials.facade(rng), top=Plain(70.0))
        ledge = Plain(150.0, 6.0, 8.0, rng.uniform(0, 50))
        e0, e1 = sorted((front - side * 0.35, front))
        faces += box((e0, -height - 0.25, z), (e1, -height + 0.2, z + length), ledge)
        tiles = Plain(rng.uniform(60, 95), 14.0, 9.0, rng.uniform(0, 50))
        faces += box((x0, -height - 3.4, z), (x1, -height - 0.25, z + length), tiles, (0.4, 0.4, 4.5))
        z += length + (0.0 if rng.random() < 0.75 else rng.uniform(1.5, 3.5))
    return faces


def _furniture(rng: np.random.Generator, start: float, stop: float) -> list[Face]:
    faces: list[Face] = []
    for kerb, side in ((_KERB_LEFT, -1), (_KERB_RIGHT, 1)):
        z = start + rng.uniform(2, 6)
        while z < stop - 2:
            x, choice = kerb + side * 0.55, rng.random()
            if choice < 0.25:
                faces += _post(rng, x, z, 0.16, 7.5)
            elif choice < 0.55:
                faces += _tree(rng, x + side * 0.3, z)
            elif choice < 0.8:
                faces += _post(rng, x, z, 0.09, 3.0) + _sign(rng, x, z)
            else:
                faces += _hedge(rng, x + side * 1.6, z)
            z += rng.uniform(5, 10)
    return faces


def _post(rng: np.random.Generator, x: float, z: float, width: float, height: float) -> list[Face]:
    look = partial(materials.pillar, grey=rng.uniform(55, 150), width=width, salt=rng.uniform(0, 50))
    half = width / 2
    return box((x - half, -height, z - half), (x + half, 0.0, z + half), look)


def _sign(rng: np.random.Generator, x: float, z: float) -> list[Face]:
    grey = float(rng.choice([70.0, 215.0]))
    disc = Mark((0.06, 0.64), (0.06, 0.64), 285.0 - grey, True)
    board = painted(Plain(grey, 4.0, 4.0), (disc, Mark((0.15, 0.55), (0.28, 0.42), grey)))
    return box((x - 0.35, -3.0, z - 0.08), (x + 0.35, -2.3, z - 0.05), Plain(110.0), back=board)


def _leaves(rng: np.random.Generator, low: float, high: float) -> Material:
    return partial(materials.foliage, grey=rng.uniform(low, high), salt=rng.uniform(0, 50))


def _tree(rng: np.random.Generator, x: float, z: float) -> list[Face]:
    leaves = _leaves(rng, 80, 125)
    foot, waist, top = (rng.uniform(*span) for span in ((2.5, 3.1), (3.8, 4.6), (6.2, 7.8)))
    inner, outer = rng.uniform(0.6, 0.9), rng.uniform(1.1, 1.6)
    spread, narrow = (inner - outer,) * 3, (0.6 * outer,) * 3
    crown = box((-inner, -waist, -inner), (inner, -foot, inner), leaves, spread, floor=leaves)
    crown += box((-outer, -top, -outer), (outer, -waist, outer), leaves, narrow)
    turn = rng.uniform(0, np.pi / 2)
    around = [face for k in (0, 1) for face in placed(crown, x, z, turn + k * np.pi / 4)]
    return [*_post(rng, x, z, 0.24, foot + 0.2), *around]


def _hedge(rng: np.random.Generator, x: float, z: float) -> list[Face]:
    leaves = _leaves(rng, 50, 85)
    high, deep = rng.uniform(0.7, 1.5), rng.uniform(2, 4)
    return box((x - 0.5, -high, z - deep / 2), (x + 0.5, 0.0, z + deep / 2), leaves)


def _parked(
    rng: np.random.Generator, x: float, yaw: float, end: float, taken: list[tuple[float, float]]
) -> list[Face]:
    faces: list[Face] = []
    for z in np.arange(-6.0, end - 10, 6.2):
        if all(z + 3 < low or z - 3 > high for low, high in taken) and rng.random() < 0.55:
            kind: Kind = "car" if rng.random() < 0.85 else "van"
            place = x + rng.normal(0, 0.06), float(z + rng.normal(0, 0.2))
            faces += placed(vehicle_faces(kind, rng), *place, yaw + rng.normal(0, 0.015))
    return faces


def _horizon(rng: np.random.Generator, end: float, crossing: float) -> list[Face]:
    """Trees at the end of the street and houses along the side street: no view to the edge of the world."""
    far, right, left = (_leaves(rng, 45, 80) for _ in range(3))
    faces = box((-150, -9, end + 40), (150, 0.0, end + 44), far)
    faces += box((-99.0, -10, crossing - 60), (-95.0, 0.0, crossing + 60), left)
    return faces + box((95.0, -10, crossing - 60), (99.0, 0.0, crossing + 60), right)
