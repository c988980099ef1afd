"""Trajectories along an outline: which side they belong to is told by how they move.

Optical flow is smooth over a few pixels, so a trajectory a little outside an outline often rides on
the object, and one a little inside sometimes on what lies behind. Where the drawing cannot tell, the
motion can.

The rule. A trajectory that keeps within `halo` pixels of the outline of one region in most of its
frames is compared, step by step, with two predictions of its displacement: a similarity fitted to
the clear trajectories of that object around it (inside by more than the margin), and one fitted to
those of the background around it (outside by more than `halo`). The side whose median error is
smaller by a factor of `ratio` wins. Where the two predictions differ by less than `least_gap`
pixels, or one side has too few clear trajectories, the outline decides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kt3dmoseg.annotate.model import BACKGROUND, AnnotatedObject, Motion
from kt3dmoseg.annotate.motion import apply, fit_similarity
from kt3dmoseg.annotate.polygons import bounds, signed_distance
from kt3dmoseg.annotate.regions import Region
from kt3dmoseg.types import BoolArray, FloatArray, IntArray, Trajectories

_NEIGHBOURS = 16
_MIN_STEPS = 3


@dataclass(frozen=True)
class HaloRule:
    """Constants of the rule; lengths in pixels."""

    halo: float
    margin: float
    ratio: float
    least_gap: float


def decide_by_motion(
    trajectories: Trajectories,
    objects: Sequence[AnnotatedObject],
    regions: Mapping[int, list[Region]],
    rule: HaloRule,
) -> dict[int, Motion]:
    """Decide the trajectories along outlines by their motion.

    Parameters
    ----------
    trajectories : Trajectories
        All trajectories of the clip.
    objects : sequence of AnnotatedObject
        Its objects; only those with a motion of their own take part.
    regions : mapping of int to list of Region
        The objects' regions in every frame.
    rule : HaloRule
        Constants.

    Returns
    -------
    dict of int to int
        Row to motion (0 = background), for the rows that the motion decides.
    """
    moving = [item for item in objects if isinstance(item.motion, int) and item.motion != BACKGROUND]
    depths = {item.id: _depths(trajectories, regions[item.id], rule.halo) for item in objects}
    behind = _clear_background(trajectories, list(depths.values()), rule.halo)
    decided: dict[int, Motion] = {}
    for item in moving:
        depth = depths[item.id]
        clear = np.nan_to_num(depth, nan=-np.inf) > rule.margin
        for row in _along(depth, rule.halo, rule.margin):
            winner = _winner(trajectories, int(row), clear, behind, rule)
            if winner is not None:
                decided[int(row)] = item.motion if winner else BACKGROUND
    return decided


def _depths(trajectories: Trajectories, regions: Sequence[Region], halo: float) -> FloatArray:
    """Signed distance (N, F) to the outline, positive inside; -inf beyond `halo`, NaN where unseen."""
    depth = np.where(trajectories.visible, -np.inf, np.nan)
    for frame, region in enumerate(regions):
        if region.polygons:
            left, top, right, bottom = bounds(region.polygons)
            xy = trajectories.xy[:, frame]
            with np.errstate(invalid="ignore"):
                near = (xy >= (left - halo, top - halo)) & (xy <= (right + halo, bottom + halo))
            rows = np.flatnonzero(near.all(axis=1))
            distance = signed_distance(xy[rows], region.polygons)
            depth[rows, frame] = np.where(distance >= -halo, distance, -np.inf)
    return depth


def _clear_background(trajectories: Trajectories, depths: Sequence[FloatArray], halo: float) -> BoolArray:
    """Mask (N, F): seen, and farther than `halo` from every region."""
    clear = trajectories.visible.copy()
    for depth in depths:
        clear &= np.isneginf(depth)
    return np.asarray(clear)


def _along(depth: FloatArray, halo: float, margin: float) -> IntArray:
    """Rows that keep to the outline: within `halo` outside and about as near inside, in most frames."""
    seen = ~np.isnan(depth)
    with np.errstate(invalid="ignore"):
        close = (depth >= -halo) & (depth <= 2 * margin)
    return np.flatnonzero((close.sum(axis=1) * 2 > seen.sum(axis=1)) & seen.any(axis=1))


def _winner(
    trajectories: Trajectories, row: int, clear: BoolArray, behind: BoolArray, rule: HaloRule
) -> bool | None:
    """Tell whether it moves with the object (True), the background (False), or neither clearly (None)."""
    errors, gaps = [], []
    visible = trajectories.visible[row]
    for frame in np.flatnonzero(visible[:-1] & visible[1:]):
        here, there = trajectories.xy[row, frame], trajectories.xy[row, frame + 1]
        with_object = _predict(trajectories, clear, row, int(frame))
        with_background = _predict(trajectories, behind, row, int(frame))
        if with_object is None or with_background is None:
            continue
        errors.append((_length(there - here - with_object), _length(there - here - with_background)))
        gaps.append(_length(with_object - with_background))
    if len(gaps) < _MIN_STEPS or float(np.median(gaps)) < rule.least_gap:
        return None
    of_object, of_background = np.median(np.array(errors), axis=0)
    if of_object * rule.ratio <= of_background:
        return True
    return False if of_background * rule.ratio <= of_object else None


def _predict(trajectories: Trajectories, mask: BoolArray, row: int, frame: int) -> FloatArray | None:
    """Displacement (2,) at the trajectory, from the nearest masked ones; None where there are too few."""
    usable = mask[:, frame] & trajectories.visible[:, frame + 1]
    usable[row] = False
    rows = np.flatnonzero(usable)
    here = trajectories.xy[row, frame]
    away = ((trajectories.xy[rows, frame] - here) ** 2).sum(axis=1)
    nearest = rows[np.argsort(away, kind="stable")[:_NEIGHBOURS]]
    model = fit_similarity(trajectories.xy[nearest, frame], trajectories.xy[nearest, frame + 1])
    return None if model is None else apply(model, here[None])[0] - here


def _length(vector: FloatArray) -> float:
    return float(np.hypot(vector[0], vector[1]))
