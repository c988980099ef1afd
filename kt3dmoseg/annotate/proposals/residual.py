"""Independent motion as residual against the dominant motion.

The static scene of a moving camera obeys one epipolar geometry: its points move along lines through the
epipole, all away from it or all towards it. A trajectory moves by itself when it leaves its line, or moves
the other way. What moves along its line in the same direction as the scene is not found: that needs a person.
"""

from __future__ import annotations

import cv2
import numpy as np

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.neighbours import groups
from kt3dmoseg.types import BoolArray, FloatArray, IntArray, Trajectories

_GAP = 4
_FEWEST = 8
# Pixels off the epipolar line, over `_GAP` frames, that the tracker's error does not explain.
_TOLERANCE = 1.2
_AT_REST = 0.3
_SHARE = 0.6


def moving_groups(tracks: Trajectories) -> IntArray:
    """Labels (N,): 1 for what moves as the scene does, 2, 3, ... for groups that do not.

    InvalidValueError when there are too few trajectories to know the scene's motion.
    """
    votes, seen = np.zeros((2, len(tracks)))
    gap = min(_GAP, tracks.n_frames - 1)
    for frame in range(tracks.n_frames - gap):
        rows, x1, x2 = tracks.pair(frame, frame + gap)
        if len(rows) >= 2 * _FEWEST:
            votes[rows] += _independent(x1, x2)
            seen[rows] += 1
    if not seen.any():
        expected = f"{2 * _FEWEST} trajectories over {gap} frames"
        raise InvalidValueError("residual", expected=expected, found="fewer")
    rows = np.flatnonzero(votes > _SHARE * seen)
    label = np.ones(len(tracks), dtype=np.int64)
    label[rows] = 0
    for number, group in enumerate(groups(tracks, rows), start=2):
        label[group] = number
    return label


def _independent(x1: FloatArray, x2: FloatArray) -> BoolArray:
    moved = np.hypot(*(x2 - x1).T)
    if np.median(moved) < _AT_REST:  # a camera at rest has no epipolar geometry
        return np.asarray(moved > _TOLERANCE)
    try:
        fundamental, _ = cv2.findFundamentalMat(x1, x2, cv2.USAC_MAGSAC, 0.5, 0.999, 2000)
    except cv2.error:  # an assertion of OpenCV 5 where no sample gives a model
        fundamental = None
    if fundamental is None or np.shape(fundamental) != (3, 3):
        return np.zeros(len(x1), dtype=np.bool_)
    matrix = np.asarray(fundamental, dtype=np.float64)
    return np.asarray((_off_line(x1, x2, matrix) > _TOLERANCE) | (_against_flow(x1, x2, matrix) > _TOLERANCE))


def _off_line(x1: FloatArray, x2: FloatArray, fundamental: FloatArray) -> FloatArray:
    """Sampson distance in pixels (Hartley and Zisserman 2004, equation 11.9)."""
    h1, h2 = (np.column_stack([x, np.ones(len(x))]) for x in (x1, x2))
    line2, line1 = h1 @ fundamental.T, h2 @ fundamental
    scale = np.linalg.norm(np.hstack([line1[:, :2], line2[:, :2]]), axis=1)
    return np.asarray(np.abs((h2 * line2).sum(axis=1)) / np.maximum(scale, 1e-12))


def _against_flow(x1: FloatArray, x2: FloatArray, fundamental: FloatArray) -> FloatArray:
    """Pixels by which points move towards the epipole while the scene moves away, or the other way."""
    x, y, w = np.linalg.svd(fundamental)[2][-1]
    away = x1 - np.array([x, y]) / w if abs(w) >= 1e-9 else np.zeros_like(x1)
    outward = ((x2 - x1) * away).sum(axis=1) / np.maximum(np.hypot(*away.T), 1.0)
    return np.asarray(-outward * np.median(np.sign(outward)))
