"""Independent motion as residual against the dominant motion.

The static scene of a moving camera obeys one epipolar geometry: its points move along lines through the
epipole, all away from it or all towards it. A trajectory moves by itself when it leaves its line, or moves
the other way. What moves along its line in the same direction as the scene is not found: that needs a person.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from kt3dmoseg.annotate.proposals import Request
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import BoolArray, FloatArray, IntArray, Labels, Trajectories

_GAP = 4
_FEWEST = 8
# Pixels off the epipolar line, over `_GAP` frames, that the tracker's error does not explain.
_TOLERANCE = 1.2
_AT_REST = 0.3
_SHARE = 0.6
# Trajectories of one object have neighbours on it within this many pixels, and differ in their steps over
# `_ALIKE_GAP` frames by less than one pixel and this share.
_REACH = 26.0
_SAME_MOTION = 0.25
_ALIKE_GAP = 2
_SMALLEST_GROUP = 12


def propose(request: Request) -> Labels:
    """Label groups of trajectories that move by themselves; see `kt3dmoseg.annotate.proposals`."""
    return Labels(moving_groups(request.trajectories), background=1)


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
    return _grouped(tracks, np.flatnonzero(votes > _SHARE * seen))


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


def _grouped(tracks: Trajectories, rows: IntArray) -> IntArray:
    """Labels (N,): 1 for all but the rows; 2, 3, ... for groups of near rows that move alike, else 0."""
    label = np.ones(len(tracks), dtype=np.int64)
    label[rows] = 0
    pairs = _neighbours(tracks, rows)
    alike = pairs[_alike(tracks, pairs)]
    links = coo_array((np.ones(len(alike)), alike.T), shape=(len(tracks), len(tracks)))
    group = connected_components(links, directed=False)[1][rows]
    names, sizes = np.unique(group, return_counts=True)
    large = [k for k in np.argsort(-sizes, kind="stable") if sizes[k] >= _SMALLEST_GROUP]
    for number, k in enumerate(large, start=2):
        label[rows[group == names[k]]] = number
    return label


def _neighbours(tracks: Trajectories, rows: IntArray) -> IntArray:
    """Pairs (P, 2) of the rows that come near each other in some frame."""
    found = [np.zeros((0, 2), dtype=np.int64)]
    for frame in range(tracks.n_frames):
        here = rows[tracks.visible[rows, frame]]
        if len(here) > 1:
            near = cKDTree(tracks.xy[here, frame]).query_pairs(_REACH, output_type="ndarray")
            found.append(here[near])
    return np.unique(np.concatenate(found), axis=0)


def _alike(tracks: Trajectories, pairs: IntArray) -> BoolArray:
    """Whether the two of each pair move alike in most of the frames that show both, (P,)."""
    gap = min(_ALIKE_GAP, tracks.n_frames - 1)
    step = tracks.xy[:, gap:] - tracks.xy[:, : tracks.n_frames - gap]
    a, b = step[pairs[:, 0]], step[pairs[:, 1]]
    apart = np.linalg.norm(a - b, axis=2)
    with np.errstate(invalid="ignore"):
        alike = (apart <= 1.0 + _SAME_MOTION * np.linalg.norm(a, axis=2)).sum(axis=1)
    return np.asarray(alike >= np.maximum(_SHARE * np.isfinite(apart).sum(axis=1), 1))
