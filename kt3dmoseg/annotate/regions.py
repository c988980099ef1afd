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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kt3dmoseg.annotate.model import Annotation, KeyFrame, Visibility
from kt3dmoseg.annotate.motion import ImageMotion, NoMotion, apply, fit_similarity
from kt3dmoseg.annotate.polygons import area, arrays, blend
from kt3dmoseg.types import FloatArray

# A region that grows or shrinks by more than this factor in one frame was fitted to something else.
_MAX_GROWTH = 1.35


@dataclass(frozen=True, eq=False)
class Region:
    """One object in one frame.

    Parameters
    ----------
    visibility : {"visible", "occluded", "outside"}
        As the key frame says that holds there.
    polygons : tuple of (P, 2) float64
        The region in pixels; empty when outside, or occluded at an unknown place.
    key : bool
        Whether a person drew it in this very frame.
    """

    visibility: Visibility
    polygons: tuple[FloatArray, ...] = ()
    key: bool = False


def propagate(annotation: Annotation, motion: ImageMotion | None = None) -> dict[int, list[Region]]:
    """Return every object's region in every frame.

    Parameters
    ----------
    annotation : Annotation
        The key frames.
    motion : ImageMotion, optional
        `TrackMotion` or `FlowMotion`; without it regions are interpolated in straight lines.

    Returns
    -------
    dict of int to list of Region
        Object id to its regions, one per frame of the clip.
    """
    image = motion or NoMotion()
    return {
        item.id: propagate_keys(item.key_frames, annotation.n_frames, image) for item in annotation.objects
    }


def propagate_keys(keys: Sequence[KeyFrame], n_frames: int, motion: ImageMotion) -> list[Region]:
    """Return the region in every frame of an object with these key frames; see `propagate`."""
    regions: list[Region] = []
    first = keys[0]
    if first.frame:
        carried = _carry(first, 0, None, motion)
        regions += [Region(first.visibility, tuple(polygons)) for polygons in reversed(carried[1:])]
    for key, after in zip(keys, (*keys[1:], None), strict=True):
        regions.append(Region(key.visibility, tuple(arrays(key.polygons)), key=True))
        end = after.frame if after else n_frames
        regions += [Region(key.visibility, tuple(polygons)) for polygons in _between(key, after, end, motion)]
    return regions


def _between(key: KeyFrame, after: KeyFrame | None, end: int, motion: ImageMotion) -> list[list[FloatArray]]:
    """Polygons of the frames strictly between `key` and `end`."""
    span = end - key.frame
    if span <= 1:
        return []
    if not key.polygons:
        return [[] for _ in range(span - 1)]
    both = after is not None and after.visibility == key.visibility and bool(after.polygons)
    target = after if both else None
    forward = _carry(key, end if both else end - 1, target, motion)
    if target is None:
        return forward[1:]
    backward = _carry(target, key.frame, key, motion)[::-1]
    return [blend(forward[k], backward[k], k / span) for k in range(1, span)]


def _carry(key: KeyFrame, stop: int, target: KeyFrame | None, motion: ImageMotion) -> list[list[FloatArray]]:
    # What hides an occluded object is not the object: its motion must not carry the region along.
    image = motion if key.visibility == "visible" else NoMotion()
    straight = None if target is None else _straight_step(key, target)
    return _chain(arrays(key.polygons), key.frame, stop, image, straight)


def _chain(
    polygons: Sequence[FloatArray],
    start: int,
    stop: int,
    motion: ImageMotion,
    straight: FloatArray | None,
) -> list[list[FloatArray]]:
    direction = 1 if stop >= start else -1
    chain = [list(polygons)]
    last = np.eye(2, 3)
    for frame in range(start, stop, direction):
        step = _step(chain[-1], frame, frame + direction, motion)
        if step is None:
            step = straight if straight is not None else _translation(last, chain[-1])
        chain.append([apply(step, polygon) for polygon in chain[-1]])
        last = step
    return chain


def _step(region: Sequence[FloatArray], i: int, j: int, motion: ImageMotion) -> FloatArray | None:
    if not region:
        return None
    model = fit_similarity(*motion.matches(region, i, j))
    if model is None:
        return None
    growth = float(np.hypot(model[0, 0], model[1, 0]))
    return model if 1 / _MAX_GROWTH <= growth <= _MAX_GROWTH else None


def _straight_step(key: KeyFrame, target: KeyFrame) -> FloatArray:
    """One of equal translations that lead from the one centre to the other."""
    gap = _centre(arrays(target.polygons)) - _centre(arrays(key.polygons))
    return np.column_stack([np.eye(2), gap / abs(target.frame - key.frame)])


def _translation(model: FloatArray, region: Sequence[FloatArray]) -> FloatArray:
    """Keep of `model` only the shift of the region's centre, not its turn and growth."""
    if not region:
        return model
    centre = _centre(region)
    return np.column_stack([np.eye(2), apply(model, centre[None])[0] - centre])


def _centre(polygons: Sequence[FloatArray]) -> FloatArray:
    weights = np.array([abs(area(polygon)) + 1.0 for polygon in polygons])
    centres = np.array([polygon.mean(axis=0) for polygon in polygons])
    return np.asarray((weights[:, None] * centres).sum(axis=0) / weights.sum())
