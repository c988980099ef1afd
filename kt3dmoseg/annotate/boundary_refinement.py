"""Trajectories along an outline: their motion decides which side they belong to.

Optical flow is smooth over a few pixels, so a trajectory a little outside an outline often rides on
the object, and one a little inside sometimes on what lies behind. Where the drawing is not clear, the
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
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from kt3dmoseg.annotate.geometry import signed_distance
from kt3dmoseg.annotate.model import BACKGROUND, REJECT, AnnotatedObject, Motion
from kt3dmoseg.annotate.propagation import Region, fit_similarities
from kt3dmoseg.types import BoolArray, FloatArray, IntArray, Trajectories

if TYPE_CHECKING:
    from kt3dmoseg.annotate.labelling import LabelRule

_NEIGHBOURS = 16
_MIN_STEPS = 3


def decide_by_motion(
    trajectories: Trajectories,
    objects: Sequence[AnnotatedObject],
    depths: Mapping[int, FloatArray],
    rule: LabelRule,
) -> dict[int, Motion]:
    """Return row to motion (0 = background) of the trajectories that the rule decides.

    `depths` are those of `region_depths`, per object, with a reach of at least `halo`.
    """
    behind = trajectories.visible.copy()
    with np.errstate(invalid="ignore"):
        for depth in depths.values():
            behind &= depth < -rule.halo
    decided: dict[int, Motion] = {}
    for item in objects:
        if item.motion in (BACKGROUND, REJECT):
            continue
        depth = np.where(depths[item.id] < -rule.halo, -np.inf, depths[item.id])
        clear = np.nan_to_num(depth, nan=-np.inf) > rule.margin
        rows = _along(depth, rule.halo, rule.margin)
        errors = np.array(
            [_errors(trajectories, rows, clear, behind, f) for f in range(trajectories.n_frames - 1)]
        ).reshape(trajectories.n_frames - 1, len(rows), 3)
        for k, row in enumerate(rows.tolist()):
            with_object = _winner(errors[~np.isnan(errors[:, k, 0]), k], rule.ratio, rule.least_gap)
            if with_object is not None:
                decided[row] = item.motion if with_object else BACKGROUND
    return decided


def region_depths(trajectories: Trajectories, regions: Sequence[Region], reach: float) -> FloatArray:
    """Signed distance (N, F) to the outline, positive inside; -inf beyond `reach`, NaN where unseen."""
    depth = np.where(trajectories.visible, -np.inf, np.nan)
    for frame, region in enumerate(regions):
        rows = np.flatnonzero(trajectories.visible[:, frame])
        depth[rows, frame] = signed_distance(trajectories.xy[rows, frame], region.polygons, reach)
    return depth


def _along(depth: FloatArray, halo: float, margin: float) -> IntArray:
    """Rows that keep to the outline: within `halo` outside and about as near inside, in most frames."""
    seen = ~np.isnan(depth)
    with np.errstate(invalid="ignore"):
        close = (depth >= -halo) & (depth <= 2 * margin)
    return np.flatnonzero((close.sum(axis=1) * 2 > seen.sum(axis=1)) & seen.any(axis=1))


def _winner(errors: FloatArray, ratio: float, least_gap: float) -> bool | None:
    """Whether a row moves with the object, with the background (False), or neither is clear (None)."""
    if len(errors) < _MIN_STEPS:
        return None
    of_object, of_background, gap = np.median(errors, axis=0)
    if gap < least_gap:
        return None
    if of_object * ratio <= of_background:
        return True
    return False if of_background * ratio <= of_object else None


def _errors(
    trajectories: Trajectories, rows: IntArray, clear: BoolArray, behind: BoolArray, frame: int
) -> FloatArray:
    """Errors (n, 3) of one step: of the object's prediction, of the background's, and their difference."""
    out = np.full((len(rows), 3), np.nan)
    both = trajectories.visible[:, frame] & trajectories.visible[:, frame + 1]
    here = np.flatnonzero(both[rows])
    if not len(here):
        return out
    asked = rows[here]
    step = trajectories.xy[asked, frame + 1] - trajectories.xy[asked, frame]
    of_object, object_ok = _predict(trajectories, clear[:, frame] & both, asked, frame)
    of_background, background_ok = _predict(trajectories, behind[:, frame] & both, asked, frame)
    known = object_ok & background_ok
    vectors = (step - of_object, step - of_background, of_object - of_background)
    out[here[known]] = np.stack([np.hypot(*vector[known].T) for vector in vectors], axis=1)
    return out


def _predict(
    trajectories: Trajectories, usable: BoolArray, rows: IntArray, frame: int
) -> tuple[FloatArray, BoolArray]:
    """Displacements (n, 2) at the rows from the nearest usable others, and where there are enough (n,)."""
    others = np.flatnonzero(usable)
    here = trajectories.xy[rows, frame]
    if not len(others):
        return np.zeros_like(here), np.zeros(len(rows), dtype=np.bool_)
    count = min(_NEIGHBOURS + 1, len(others))
    _, nearest = cKDTree(trajectories.xy[others, frame]).query(here, k=range(1, count + 1))
    found = others[nearest]
    known = found != rows[:, None]
    # One more than needed, because a row may find itself.
    known &= np.cumsum(known, axis=1) <= _NEIGHBOURS
    models, ok = fit_similarities(trajectories.xy[found, frame], trajectories.xy[found, frame + 1], known)
    return (models[:, :, :2] @ here[..., None])[..., 0] + models[:, :, 2] - here, ok
