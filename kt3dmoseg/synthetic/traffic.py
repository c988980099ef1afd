"""The moving vehicles: which ones there are and how they drive."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.synthetic.motion import Drive
from kt3dmoseg.synthetic.street import LANE, ONCOMING, PARKED_RIGHT
from kt3dmoseg.synthetic.vehicles import Kind, Vehicle, make_vehicle

CROSSING_AHEAD = 27.0  # metres from the camera to the side street in the middle of the clip


def traffic(rng: np.random.Generator, count: int, middle: float, speed: float) -> list[Vehicle]:
    """Choose `count` vehicles that all are in view in the middle of the clip and do not collide.

    They come in the order of how well their motion can be told from the camera's: one crosses the street,
    one ahead changes lanes, one leaves a parking place, one comes towards us. The nearer a vehicle's course
    is to the camera's, the less its points leave the epipolar lines of the static scene.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of kinds, places and speeds.
    count : int
        0 to 4.
    middle : float
        z of the camera in the middle of the clip, metres.
    speed : float
        Speed of the camera, m/s.
    """

    def draw(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    side = int(rng.choice([-1, 1]))
    crossing = Drive(
        ONCOMING + draw(1.0, 3.0),
        middle + CROSSING_AHEAD + side * 1.4,
        side * np.pi / 2,
        draw(3.5, 5.5),
        draw(-0.1, 0.1),
    )
    lead = Drive(
        LANE + draw(-0.2, 0.2), middle + draw(11.5, 12.2), draw(-0.12, -0.07), speed + draw(0.8, 1.5)
    )
    leaving = Drive(
        PARKED_RIGHT, middle + draw(7.5, 8.3), -0.15, 0.6 * speed + draw(0.3, 1.2), draw(-0.2, -0.1)
    )
    oncoming = Drive(
        ONCOMING + draw(-0.1, 0.2), middle + draw(12.5, 15), np.pi + draw(0.05, 0.12), draw(2.5, 5.0)
    )
    plans = [("crossing", crossing), ("leading", lead), ("leaving", leaving), ("oncoming", oncoming)]
    kinds: dict[str, tuple[Kind, ...]] = {
        "crossing": ("truck",),
        "oncoming": ("van", "car"),
        "leading": ("car", "van"),
        "leaving": ("car",),
    }
    vehicles = []
    for role, drive in plans[:count]:
        kind = kinds[role][int(rng.integers(len(kinds[role])))]
        vehicles.append(make_vehicle(f"{role} {kind}", kind, drive))
    return vehicles
