"""From an annotation to a motion label per trajectory.

The rule. In every frame where a trajectory is visible it casts one vote. Let d be its distance to
the boundary of the nearest region, positive inside; the vote weighs ``min(1, |d| / 2)``, so
that near a boundary, where neither the drawing nor the tracker can be trusted, it weighs little.
Inside regions of one motion it votes for that motion; outside of all regions for the background. A static
region (motion 0) lies in front of moving ones and a rejected one in front of all. Inside two regions of
different motions, or in the region of an occluded object, it abstains. The trajectory gets the motion
with at least 3/4 of its votes, when they weigh at least 1; otherwise it stays
unlabelled, with the reason.

Along an outline, motion then decides where it is clear: optical flow is smooth over a few pixels, so a
trajectory a little outside often rides on the object, and one a little inside sometimes on what lies behind.
A trajectory that keeps within 8 pixels of the outline of one region in most of its frames is compared,
step by step, with two predictions of its displacement: a similarity fitted to the clear trajectories of that
object around it (inside by more than 2), and one fitted to those of the background around it
(outside by more than 8). The side whose median error is smaller by a factor of 1.5 wins. Where the
two predictions differ by less than 0.4 pixels, or one side has too few clear trajectories, the
outline decides.

A mark overrules all else for the trajectories that it encloses.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
from scipy.spatial import cKDTree

from kt3dmoseg.annotate.geometry import arrays, signed_distance
from kt3dmoseg.annotate.model import BACKGROUND, REJECT, AnnotatedObject, Annotation, Motion
from kt3dmoseg.annotate.propagation import Region, TrackMotion, fit_similarities, propagate
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import BoolArray, FloatArray, IntArray, Labels, Trajectories

Reason: TypeAlias = Literal["labelled", "unseen", "short", "conflict", "rejected"]
REASONS: tuple[str, ...] = get_args(Reason)
_LABELLED, _UNSEEN, _SHORT, _CONFLICT, _REJECTED = range(len(REASONS))
# The rule: pixels, but for the share of the votes, their weight and the factor.
_MARGIN, _HALO, _LEAST_GAP = 2.0, 8.0, 0.4
_MIN_SHARE, _MIN_VOTES, _RATIO = 0.75, 1.0, 1.5
_NEIGHBOURS = 16
_MIN_STEPS = 3


@dataclass(frozen=True, eq=False)
class LabelledTracks:
    """Labels (1 = background, m + 1 = motion m, 0 = unlabelled), and the reasons (N,) for them, of `REASONS`.

    `votes` (N, K) are the weights of the votes per candidate: 0, motions..., "reject".
    """

    labels: Labels
    reason: IntArray
    votes: FloatArray
    candidates: tuple[Motion, ...]

    def rows(self, reason: Reason) -> IntArray:
        """Rows of the trajectories with that outcome, ascending."""
        return np.flatnonzero(self.reason == REASONS.index(reason))

    def counts(self) -> dict[str, int]:
        """Return the number of trajectories per outcome."""
        return {name: int((self.reason == k).sum()) for k, name in enumerate(REASONS)}


def label_tracks(trajectories: Trajectories, annotation: Annotation) -> Labels:
    """Label any trajectories of a clip by its annotation.

    Parameters
    ----------
    trajectories : Trajectories
        Of the annotated clip, by whatever tracker.
    annotation : Annotation
        The objects of the clip.

    Returns
    -------
    Labels
        1 = background, m + 1 = motion m, 0 = unlabelled: rejected, in conflict, or too short.

    Raises
    ------
    InvalidValueError
        When trajectories and annotation have different numbers of frames or image sizes.
    """
    return label_tracks_detailed(trajectories, annotation).labels


def label_tracks_detailed(
    trajectories: Trajectories,
    annotation: Annotation,
    *,
    regions: Mapping[int, list[Region]] | None = None,
) -> LabelledTracks:
    """Label trajectories, with reasons, as `label_tracks`; `regions` of `propagate`, when they are known."""
    _check_clip(trajectories, annotation)
    if regions is None:
        regions = propagate(annotation, TrackMotion(trajectories))
    # Signed distance (N, F) to each object's outline, positive inside; -inf far off, NaN where unseen.
    depths = {item.id: np.where(trajectories.visible, -np.inf, np.nan) for item in annotation.objects}
    candidates: tuple[Motion, ...] = (BACKGROUND, *annotation.motions, REJECT)
    votes = np.zeros((len(trajectories), len(candidates)))
    contested = np.zeros(len(trajectories), dtype=np.bool_)
    for frame in range(trajectories.n_frames):
        rows, xy = trajectories.at(frame)
        depth = np.full((len(rows), len(candidates)), -np.inf)
        hidden = np.zeros(len(rows), dtype=np.bool_)
        for item in annotation.objects:
            region, column = regions[item.id][frame], candidates.index(item.motion)
            inner = signed_distance(xy, region.polygons, _HALO)
            depths[item.id][rows, frame] = inner
            if region.visibility == "occluded":
                hidden |= inner > 0
            else:
                depth[:, column] = np.maximum(depth[:, column], inner)
        weight, torn = _votes(depth, hidden)
        votes[rows] += weight
        contested[rows] |= torn
    choice, reason = _decide(votes, contested, trajectories.lengths > 0)
    for rows, motion_there in _decide_by_motion(trajectories, annotation.objects, depths):
        choice[rows], reason[rows] = candidates.index(motion_there), _LABELLED
    for mark in annotation.marks:
        rows, xy = trajectories.at(mark.frame)
        held = rows[signed_distance(xy, arrays([mark.polygon]), reach=0.0) >= 0]
        choice[held] = candidates.index(mark.motion)
        reason[held] = _REJECTED if mark.motion == REJECT else _LABELLED
    number = np.array([0 if motion == REJECT else motion + 1 for motion in candidates], dtype=np.int64)
    names = {BACKGROUND + 1: "background"}
    for m in annotation.motions:
        names[m + 1] = " + ".join(o.name for o in annotation.objects if o.motion == m) or f"motion {m}"
    labels = Labels(np.where(reason == _LABELLED, number[choice], 0), BACKGROUND + 1, names)
    return LabelledTracks(labels, reason, votes, candidates)


def _votes(depth: FloatArray, hidden: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Weights (n, K) of votes in one frame, and where two motions claim a point (n,), from depths (n, K)."""
    static, moving, rejected = depth[:, 0], depth[:, 1:-1], depth[:, -1]
    outside = -np.maximum(moving.max(axis=1, initial=-np.inf), rejected)
    background = np.maximum(np.minimum(static, -rejected), outside)
    uncovered = np.minimum(moving, -np.maximum(static, rejected)[:, None])
    weight = np.clip(np.column_stack([background, uncovered, rejected]) / _MARGIN, 0.0, 1.0)
    torn = (uncovered > 0).sum(axis=1) > 1
    weight[hidden | torn] = 0.0
    return np.asarray(weight), np.asarray(torn)


def _decide(votes: FloatArray, contested: BoolArray, seen: BoolArray) -> tuple[IntArray, IntArray]:
    """Winner (N,) as a column, and reason (N,)."""
    choice = np.argmax(votes, axis=1)
    total = votes.sum(axis=1)
    won = votes.max(axis=1) >= _MIN_SHARE * total
    reason = np.where(won, _LABELLED, _CONFLICT)
    reason[won & (choice == votes.shape[1] - 1)] = _REJECTED
    few = (total < _MIN_VOTES) | (total == 0)
    reason[few] = np.where(contested[few], _CONFLICT, _SHORT)
    reason[~seen] = _UNSEEN
    return choice.astype(np.int64), reason.astype(np.int64)


def _check_clip(trajectories: Trajectories, annotation: Annotation) -> None:
    where = f"trajectories of {annotation.clip}"
    if trajectories.n_frames != annotation.n_frames:
        expected = f"{annotation.n_frames} frames, as the annotation has"
        raise InvalidValueError(where, expected=expected, found=f"{trajectories.n_frames}")
    if trajectories.image_size not in (None, annotation.image_size):
        expected = f"image size {annotation.image_size}, as the annotation has"
        raise InvalidValueError(where, expected=expected, found=f"{trajectories.image_size}")


def _decide_by_motion(
    trajectories: Trajectories,
    objects: Sequence[AnnotatedObject],
    depths: Mapping[int, FloatArray],
) -> Iterator[tuple[IntArray, Motion]]:
    """Yield rows of the trajectories that the rule decides, and their motion (0 = background)."""
    steps = range(trajectories.n_frames - 1)
    with np.errstate(invalid="ignore"):
        behind = trajectories.visible & np.all([depth < -_HALO for depth in depths.values()], axis=0)
    for item in objects:
        depth = depths[item.id]
        with np.errstate(invalid="ignore"):
            clear = depth > _MARGIN
            # Along the outline: at most 8 pixels outside and about as near inside, in most frames.
            close = (depth >= -_HALO) & (depth <= 2 * _MARGIN)
        rows = np.flatnonzero(2 * close.sum(axis=1) > trajectories.lengths)
        if item.motion in (BACKGROUND, REJECT) or not len(rows) or not steps:
            continue
        errors = np.stack([_errors(trajectories, rows, clear, behind, frame) for frame in steps])
        errors[np.isnan(errors).any(axis=2)] = np.nan
        known = np.isfinite(errors[..., 0]).sum(axis=0) >= _MIN_STEPS
        of_object, of_background, gap = np.nanmedian(errors[:, known], axis=0).T
        clear = gap >= _LEAST_GAP
        yield rows[known][clear & (of_background * _RATIO <= of_object)], BACKGROUND
        yield rows[known][clear & (of_object * _RATIO <= of_background)], item.motion


def _errors(
    trajectories: Trajectories, rows: IntArray, clear: BoolArray, behind: BoolArray, frame: int
) -> FloatArray:
    """Errors (n, 3) of one step: of the object's prediction, of the background's, and their difference."""
    both = trajectories.visible[:, frame] & trajectories.visible[:, frame + 1]
    step = trajectories.xy[rows, frame + 1] - trajectories.xy[rows, frame]
    of_object = _predict(trajectories, clear[:, frame] & both, rows, frame)
    of_background = _predict(trajectories, behind[:, frame] & both, rows, frame)
    vectors = (step - of_object, step - of_background, of_object - of_background)
    return np.stack([np.hypot(*vector.T) for vector in vectors], axis=1)


def _predict(trajectories: Trajectories, usable: BoolArray, rows: IntArray, frame: int) -> FloatArray:
    """Displacements (n, 2) at the rows from the nearest usable others; NaN where these are too few."""
    out, others = np.full((len(rows), 2), np.nan), np.flatnonzero(usable)
    seen = np.flatnonzero(trajectories.visible[rows, frame])
    if not len(others) or not len(seen):
        return out
    here, count = trajectories.xy[rows[seen], frame], min(_NEIGHBOURS + 1, len(others))
    _, nearest = cKDTree(trajectories.xy[others, frame]).query(here, k=range(1, count + 1))
    found = others[nearest]
    known = found != rows[seen, None]
    # One more than needed, because a row may find itself.
    known &= np.cumsum(known, axis=1) <= _NEIGHBOURS
    models, ok = fit_similarities(trajectories.xy[found, frame], trajectories.xy[found, frame + 1], known)
    out[seen[ok]] = ((models[:, :, :2] @ here[..., None])[..., 0] + models[:, :, 2] - here)[ok]
    return out
