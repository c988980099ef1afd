"""Labels of some trajectories spread to all others, and from trajectories to the pixels of a frame."""

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from kt3dmoseg.types import ByteArray, FloatArray, IntArray, Trajectories

# Frames over which motion is compared; what lives shorter is compared over fewer, at last by position alone.
_GAPS = (3, 1, 0)
# A pixel per frame of motion counts as much as this many pixels of distance.
_MOTION = 20.0
_NEIGHBOURS = 2
_NEAR = 2.0  # pixels: neighbours that are nearer count alike
_BLUR = 3.0  # sigma, in pixels, of what is too fine to be an edge


def spread_labels(tracks: Trajectories, rows: IntArray, labels: IntArray) -> IntArray:
    """Label all N trajectories, (N,) int64, by the labels (n,) of some rows (n,), which are kept.

    In every frame the two labelled ones vote that are nearest in position and motion. What shares no frame
    with any joins the largest motion. Memory grows linearly with N.
    """
    if not len(rows):
        return np.zeros(len(tracks), dtype=np.int64)
    values, group, sizes = np.unique(labels, return_inverse=True, return_counts=True)
    known = np.full(len(tracks), -1)
    known[rows] = group
    votes = np.zeros((len(tracks), len(values)), dtype=np.float32)
    for gap in _GAPS:
        asked = (known < 0) & ~votes.any(axis=1)
        for frame in range(tracks.n_frames - gap if asked.any() else 0):
            (here, start), (there, end) = tracks.at(frame), tracks.at(frame + gap)
            row, first, last = np.intersect1d(here, there, assume_unique=True, return_indices=True)
            motion = (end[last] - start[first]) * (_MOTION / max(gap, 1))
            place = np.hstack([start[first], motion])
            _vote(votes, row[asked[row]], place[asked[row]], known[row], place)
    votes[~votes.any(axis=1), np.where(values > 0, sizes, 0).argmax()] = 1
    return np.asarray(values[np.where(known >= 0, known, votes.argmax(axis=1))], dtype=np.int64)


def _vote(
    votes: npt.NDArray[np.float32], row: IntArray, place: FloatArray, group: IntArray, places: FloatArray
) -> None:
    """Add for the rows (R,) at a place (R, 4) the votes of those at places (P, 4) with a group (P,) >= 0."""
    voters = np.flatnonzero(group >= 0)
    if len(voters) and len(row):
        nearest = range(1, min(_NEIGHBOURS, len(voters)) + 1)
        distance, at = cKDTree(places[voters]).query(place, k=[*nearest])
        np.add.at(votes, (row[:, None], group[voters][at]), 1 / (distance**2 + _NEAR**2))


def dense_mask(picture: ByteArray, xy: FloatArray, labels: IntArray) -> ByteArray:
    """Spread the labels (P,) 1..255 of points (P, 2) in a frame to its pixels, (H, W); 0 if there are none.

    They grow over the picture, (H, W) or (H, W, 3), where it changes least first (watershed, Meyer 1992).
    """
    height, width = picture.shape[:2]
    square = np.ones((3, 3), dtype=np.uint8)
    mask = np.zeros((height, width), dtype=np.uint8)
    x, y = np.rint(xy).astype(np.int64).clip(0, (width - 1, height - 1)).T
    mask[y, x] = labels
    if len(labels):
        mask = np.where(mask > 0, mask, cv2.dilate(mask, square)).astype(np.uint8)
        smooth = cv2.GaussianBlur(picture, (0, 0), _BLUR)
        colours = smooth if smooth.ndim == 3 else cv2.merge([smooth] * 3)
        grown = cv2.watershed(colours, mask.astype(np.int32))
        mask = np.maximum(grown, 0).astype(np.uint8)  # -1 along the borders of labels and of the frame
    while len(labels) and not mask.all():
        mask = np.where(mask > 0, mask, cv2.dilate(mask, square)).astype(np.uint8)
    return mask
