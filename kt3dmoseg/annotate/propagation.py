"""Regions in every frame: exact on key frames, following the image motion between them.

The rule. A key frame holds until the next key frame; the first one also holds before itself. So an
object *enters* by an "outside" key frame followed by a visible one, *leaves* by an "outside" one,
and is *occluded* from one key frame to the next. Between two visible key frames the region is
carried forwards from the earlier and backwards from the later one, frame by frame, by a robust
similarity fitted to the image motion inside it; the two are blended in proportion to the
distance in time. Outside the outermost key frames there is only one side to come from. A step with too few
correspondences takes the straight step between the two key frames, else the step before it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.annotate.geometry import area, arrays, blend, median, resample, signed_distance, size
from kt3dmoseg.annotate.model import BACKGROUND, REJECT, Annotation, KeyFrame, Motion, Visibility
from kt3dmoseg.types import BoolArray, FloatArray, Trajectories

ComplexArray: TypeAlias = npt.NDArray[np.complex128]

# A region that grows or shrinks by more than this factor in one frame was fitted to something else.
_MAX_GROWTH = 1.35
# Correspondences below which a similarity is not worth fitting: it has four unknowns.
_ENOUGH = 4
_ROUNDS = 12
# Residuals smaller than this many pixels are tracking noise, not another motion.
_NOISE = 0.3
# Strength of the prior "no turn, no growth", in square pixels of spread: a few close points show
# the translation of a region but not its scale.
_PRIOR = 100.0
# Changes of the model below this no longer matter.
_STILL = 1e-5
# What makes a carried region doubtful: see `weak_frames`. A match this many pixels away moves otherwise.
_FEW = 8
_OTHERWISE = 3.0
_MAJORITY = 0.6
_LARGE_ERROR = 1.0
_JUMP = 1.2
_SCENE = (BACKGROUND, REJECT)
# Two to three seeds of the tracker beside a region, in pixels.
_AROUND = 20.0
# Deeper than this, in pixels, a vote of `label_tracks` weighs fully.
_CLAIM = 2.0
_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Region:
    """One object in one frame: the visibility that holds there, and polygons (P, 2) in pixels.

    None when outside, or occluded somewhere unknown. `key`: whether the region is of this very frame.
    """

    visibility: Visibility
    polygons: tuple[FloatArray, ...] = ()
    key: bool = False


def propagate(annotation: Annotation, motion: TrackMotion | None = None) -> dict[int, list[Region]]:
    """Return the regions of every object, by its id, one per frame of the clip.

    Without `motion` regions are interpolated in straight lines.
    """
    frames, objects = annotation.n_frames, annotation.objects
    return {item.id: propagate_keys(item.key_frames, frames, motion, item.motion) for item in objects}


def propagate_keys(
    keys: Sequence[KeyFrame], n_frames: int, motion: TrackMotion | None, number: Motion = 1
) -> list[Region]:
    """Return the region in every frame of an object of a motion with these key frames; see `propagate`."""
    if number in _SCENE and isinstance(motion, TrackMotion):
        motion = replace(motion, around=_AROUND)
    before = _carry(keys[0], 0, None, motion)[1:]
    regions = [Region(keys[0].visibility, tuple(polygons)) for polygons in reversed(before)]
    for key, after in zip(keys, (*keys[1:], None), strict=True):
        regions.append(Region(key.visibility, tuple(arrays(key.polygons)), key=True))
        between = _between(key, after, n_frames, motion)
        regions += [Region(key.visibility, tuple(polygons)) for polygons in between]
    return regions


def weak_frames(regions: Sequence[Region], motion: TrackMotion) -> list[str]:
    """Return, per frame, why the region carried to it is in doubt, or "" where it is not.

    In doubt is a visible region between key frames that follows fewer than 8 trajectories, or less than 60 %
    of those inside it, or with a median error over 1 px; or whose area changes by a fifth in one frame.
    """
    out, carried = [], False
    for frame, region in enumerate(regions):
        carried |= region.key
        other = frame - 1 if carried else frame + 1
        weak = region.visibility == "visible" and not region.key and region.polygons
        out.append(_doubt(regions[other], region, motion.matches, other, frame) if weak else "")
    return out


def overlaps(
    annotation: Annotation, regions: Mapping[int, Sequence[Region]], weak: Mapping[int, Sequence[str]]
) -> dict[int, list[str]]:
    """Return `weak` (`weak_frames`), and where an object overlaps another motion, with nothing in front."""
    out = {number: list(reasons) for number, reasons in weak.items()}
    moving = [item for item in annotation.objects if item.motion not in _SCENE]
    front = [regions[item.id] for item in annotation.objects if item.motion in _SCENE]
    pairs = [pair for pair in combinations(moving, 2) if pair[0].motion != pair[1].motion]
    for (one, other), frame in product(pairs, range(annotation.n_frames)):
        a, b = regions[one.id][frame], regions[other.id][frame]
        covers = [polygon for item in front for polygon in item[frame].polygons]
        if a.visibility == b.visibility == "visible" and any(
            ((signed_distance(edge, theirs, 0.0) > _CLAIM) & (signed_distance(edge, covers, 0.0) < 0)).any()
            for own, theirs in ((a.polygons, b.polygons), (b.polygons, a.polygons))
            for edge in (resample(polygon, 72) for polygon in own)
        ):
            out[other.id][frame] = f"overlaps {one.name}"
    return out


def _doubt(before: Region, here: Region, matches: Callable[..., Any], i: int, j: int) -> str:
    if not before.polygons:
        return "nothing to follow"
    x1, x2 = matches(before.polygons, i, j)
    if len(x1) < _FEW:
        return f"follows {len(x1)} trajectories"
    error = np.hypot(*(apply(_fit(x1, x2), x1) - x2).T)
    inliers = error < _OTHERWISE
    if inliers.mean() < _MAJORITY:
        return f"{len(x1) - inliers.sum()} of {len(x1)} trajectories move otherwise"
    if np.median(error[inliers]) > _LARGE_ERROR:
        return f"error {np.median(error[inliers]):.1f} px"
    growth = size(here.polygons) / max(1.0, size(before.polygons))
    return "" if 1 / _JUMP < growth < _JUMP else f"area changes by {abs(growth - 1):.0%}"


@dataclass(frozen=True, eq=False)
class TrackMotion:
    """The image motion of the trajectories inside the region; if these are few, also `around` it (pixels)."""

    trajectories: Trajectories
    around: float = 0.0

    def matches(self, region: Sequence[FloatArray], i: int, j: int) -> tuple[FloatArray, FloatArray]:
        """Trajectories inside the region in frame `i` that are visible in `j`: positions (n, 2) in both."""
        _, x1, x2 = self.trajectories.pair(i, j)
        kept = signed_distance(x1, region, reach=0.0) >= 0
        if kept.sum() < _ENOUGH and self.around:
            kept = signed_distance(x1, region, reach=self.around) >= -self.around
        return x1[kept], x2[kept]


def fit_similarities(x1: FloatArray, x2: FloatArray, known: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Fit similarities ``x2 = A x1 + t``, A a scaled rotation, to B sets of points (B, n, 2), robustly.

    Iteratively reweighted least squares with Tukey's biweight (Beaton and Tukey 1974), started at
    the median displacement, so that up to nearly half of the points may follow another motion. `known`
    (B, n) are the points that count. Returns ``[A | t]`` (B, 2, 3), and whether there were 4 or more (B,).
    """
    z1, z2 = x1[..., 0] + 1j * x1[..., 1], x2[..., 0] + 1j * x2[..., 1]
    shift = _median((x2 - x1)[..., 0], known) + 1j * _median((x2 - x1)[..., 1], known)
    a, t = np.ones(len(x1), dtype=np.complex128), shift
    ok = known.sum(axis=1) >= _ENOUGH
    live = ok.copy()
    for _ in range(_ROUNDS):
        residual = np.abs(z2 - a[:, None] * z1 - t[:, None])
        # 1.4826 * MAD estimates the standard deviation; 4.685 gives 95 % efficiency (Huber 1981).
        cut = 4.685 * np.maximum(_NOISE, 1.4826 * _median(residual, known))[:, None]
        weight = np.where(known & (residual < cut), (1 - (residual / cut) ** 2) ** 2, 0.0)
        live &= np.count_nonzero(weight, axis=1) >= _ENOUGH
        new_a, new_t = _weighted_similarity(z1, z2, weight)
        new_a, new_t = np.where(live, new_a, a), np.where(live, new_t, t)
        still = np.abs(new_a - a).max(initial=0.0) < _STILL and np.abs(new_t - t).max(initial=0.0) < _STILL
        a, t = new_a, new_t
        if still:
            break
    models = np.stack([np.stack([a.real, -a.imag, t.real], -1), np.stack([a.imag, a.real, t.imag], -1)], 1)
    return models, ok


def apply(model: FloatArray, points: FloatArray) -> FloatArray:
    """Map (n, 2) points by a (2, 3) model."""
    return np.asarray(points @ model[:, :2].T + model[:, 2])


def _weighted_similarity(
    z1: ComplexArray, z2: ComplexArray, weight: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Regularised least squares in complex numbers: ``z2 - m2 = a (z1 - m1)`` with a near 1."""
    total = np.maximum(weight.sum(axis=1), _TINY)
    m1, m2 = (weight * z1).sum(axis=1) / total, (weight * z2).sum(axis=1) / total
    d1, d2 = z1 - m1[:, None], z2 - m2[:, None]
    spread = (weight * np.abs(d1) ** 2).sum(axis=1)
    a = ((weight * np.conj(d1) * d2).sum(axis=1) + _PRIOR) / (spread + _PRIOR)
    return a, m2 - a * m1


def _median(values: FloatArray, known: BoolArray) -> FloatArray:
    """Median of the known values of each row; 0 in a row without any."""
    return np.nan_to_num(median(np.where(known, values, np.nan), 1))


def _between(
    key: KeyFrame, after: KeyFrame | None, n_frames: int, motion: TrackMotion | None
) -> list[list[FloatArray]]:
    """Polygons of the frames strictly between a key frame and the next one, or the end."""
    end = n_frames if after is None else after.frame
    span = end - key.frame
    if (
        after is None
        or after.visibility != key.visibility
        or not (key.polygons and after.polygons)
        or span < 2
    ):
        return _carry(key, end - 1, None, motion)[1:]
    forward, backward = _carry(key, end, after, motion), _carry(after, key.frame, key, motion)[::-1]
    return [blend(forward[k], backward[k], k / span) for k in range(1, span)]


def _carry(
    key: KeyFrame, stop: int, target: KeyFrame | None, motion: TrackMotion | None
) -> list[list[FloatArray]]:
    """Polygons of the frames from `key` to `stop`, in that order; straight steps lead to `target`."""
    # What hides an occluded object is not the object: its motion must not carry the region along.
    image = motion if key.visibility == "visible" else None
    if target is not None and isinstance(image, TrackMotion):  # the straight step to it is better known
        image = replace(image, around=0.0)
    chain = [arrays(key.polygons)]
    direction = 1 if stop >= key.frame else -1
    last = np.eye(2, 3)
    for frame in range(key.frame, stop, direction):
        step = _step(chain[-1], frame, frame + direction, image)
        if step is None and target is not None:
            gap = _centre(arrays(target.polygons)) - _centre(chain[0])
            step = np.column_stack([np.eye(2), gap / abs(target.frame - key.frame)])
        elif step is None and chain[-1]:
            # Of the step before, only the shift of the centre: not its turn and growth.
            centre = _centre(chain[-1])
            step = np.column_stack([np.eye(2), apply(last, centre[None])[0] - centre])
        last = last if step is None else step
        chain.append([apply(last, polygon) for polygon in chain[-1]])
    return chain


def _step(region: Sequence[FloatArray], i: int, j: int, motion: TrackMotion | None) -> FloatArray | None:
    if motion is None or not region:
        return None
    x1, x2 = motion.matches(region, i, j)
    if len(x1) < _ENOUGH:
        return None
    model = _fit(x1, x2)
    return model if 1 / _MAX_GROWTH <= np.hypot(model[0, 0], model[1, 0]) <= _MAX_GROWTH else None


def _fit(x1: FloatArray, x2: FloatArray) -> FloatArray:
    models, _ = fit_similarities(x1[None], x2[None], np.ones((1, len(x1)), dtype=np.bool_))
    return np.asarray(models[0])


def _centre(polygons: Sequence[FloatArray]) -> FloatArray:
    weights = [abs(area(polygon)) + 1.0 for polygon in polygons]
    return np.average([polygon.mean(axis=0) for polygon in polygons], axis=0, weights=weights)
