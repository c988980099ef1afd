"""What files of other tools leave out of an object: its motion, a kind we know, frames without a shape."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from kt3dmoseg.annotate.model import KINDS, KeyFrame, Kind, Motion


def known_kind(name: str) -> Kind:
    """Return the kind of that name, ``"other"`` where we have none."""
    return next((kind for kind in KINDS if kind == name), "other")


def own_motions(told: Iterable[Motion | None]) -> list[Motion]:
    """Give every object that tells no motion one of its own, from after the largest told on.

    >>> own_motions([None, 3, "reject", None])
    [4, 3, 'reject', 5]
    """
    given = list(told)
    free = max((motion for motion in given if isinstance(motion, int)), default=0)
    motions: list[Motion] = []
    for motion in given:
        free += motion is None
        motions.append(free if motion is None else motion)
    return motions


def key_frames_of(seen: Mapping[int, KeyFrame], n_frames: int) -> tuple[KeyFrame, ...]:
    """Key frames of an object that is seen in some frames: those, and one wherever it is gone."""
    keys: list[KeyFrame] = []
    for frame in range(n_frames):
        if frame in seen:
            keys.append(seen[frame])
        elif not keys or keys[-1].visibility != "outside":
            keys.append(KeyFrame(frame, "outside"))
    return tuple(keys)
