"""Regions around the trajectories of each label."""

from __future__ import annotations

import cv2
import numpy as np

from kt3dmoseg.annotate.formats.masks import polygons_of
from kt3dmoseg.annotate.model import AnnotatedObject, KeyFrame, Polygon
from kt3dmoseg.types import BoolArray, ByteArray, FloatArray, Labels, Trajectories

# Seeds lie 8 pixels apart where there is texture; smooth parts of a car leave gaps of some 30 pixels.
_REACH = 16
_SHRINK = 13
_FEWEST = 8
_EVERY = 4


def objects_from_labels(trajectories: Trajectories, labels: Labels) -> list[AnnotatedObject]:
    """Outline the trajectories of every label but the background.

    Parameters
    ----------
    trajectories : Trajectories
        Of the clip, with image size.
    labels : Labels
        One per trajectory; 0 is left out, `background` (by default 1) too.

    Returns
    -------
    list of AnnotatedObject
        The one with the most trajectories first; key frames on every 4th frame and where
        visibility changes. Labels with fewer than 8 trajectories in every frame are left out.
    """
    background = labels.background or 1
    motions = [int(m) for m in labels.motions if m != background]
    motions.sort(key=lambda m: -int((labels.label == m).sum()))
    objects: list[AnnotatedObject] = []
    for motion in motions:
        keys = _key_frames(trajectories, labels.label == motion)
        if any(key.polygons for key in keys):
            number = len(objects) + 1
            name = labels.names.get(motion, f"proposal {number}")
            objects.append(AnnotatedObject(number, name, "other", number, keys))
    return objects


def outline(points: FloatArray, image_size: tuple[int, int]) -> list[Polygon]:
    """Outline the union of discs around points, shrunk back: a hull that follows concave shapes."""
    width, height = image_size
    canvas = np.zeros((height + 2 * _REACH, width + 2 * _REACH), dtype=np.uint8)
    for x, y in np.rint(points).astype(int) + _REACH:
        cv2.circle(canvas, (int(x), int(y)), _REACH, 1, -1)
    inner = cv2.erode(canvas, _disc(_SHRINK))[_REACH:-_REACH, _REACH:-_REACH].astype(np.bool_)
    return polygons_of(_largest_parts(inner), tolerance=1.0)


def _key_frames(trajectories: Trajectories, member: BoolArray) -> tuple[KeyFrame, ...]:
    assert trajectories.image_size is not None
    keys: list[KeyFrame] = []
    counts = (trajectories.visible & member[:, None]).sum(axis=0)
    for frame, count in enumerate(counts):
        if count < _FEWEST:
            if not keys or keys[-1].visibility != "outside":
                keys.append(KeyFrame(frame, "outside"))
            continue
        last = frame + 1 == len(counts) or counts[frame + 1] < _FEWEST
        if not keys or keys[-1].visibility == "outside" or last or frame - keys[-1].frame >= _EVERY:
            rows = member & trajectories.visible[:, frame]
            polygons = outline(trajectories.xy[rows, frame], trajectories.image_size)
            if polygons:
                keys.append(KeyFrame(frame, "visible", tuple(polygons)))
    return tuple(keys) or (KeyFrame(0, "outside"),)


def _largest_parts(mask: BoolArray) -> BoolArray:
    """Drop parts smaller than a tenth of the largest: single stray trajectories."""
    count, parts, statistics, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    if count < 2:
        return mask
    sizes = statistics[:, cv2.CC_STAT_AREA].copy()
    sizes[0] = 0
    kept = sizes >= 0.1 * sizes.max()
    kept[0] = False
    return np.asarray(kept[parts])


def _disc(radius: int) -> ByteArray:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)))
