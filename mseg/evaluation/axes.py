"""What makes a trajectory hard: one pure function per property, and the bins of reports."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kt3dmoseg.types import BoolArray, Clip, FloatArray, IntArray, Labels, Trajectories
from mseg.evaluation.protocol import bin_titles
from mseg.geometry.hartley import normalise

GAP = 5  # frames over which motion is measured, as in the synthetic benchmark
_FLAT = 1.0  # px: a scene that a homography explains to within this has no measurable epipolar lines
_FITS = 4  # of a frame pair, each without what the one before left far off
_FEWEST = 12  # static trajectories that fix the geometry of a frame pair; eight are minimal


@dataclass(frozen=True)
class TrackAxis:
    """A property of trajectories, with its bins."""

    name: str
    title: str  # with its unit
    definition: str  # for the reader of a report
    # Of a clip and its image size (W, H): the values of the evaluated trajectories, (n,); NaN = not known.
    values: Callable[[Clip, tuple[int, int]], FloatArray]
    bounds: tuple[float, ...]  # where one bin ends and the next begins
    titles: tuple[str, ...]  # of the bins, one more than bounds; then comes that of NaN

    def bins(self, clip: Clip, size: tuple[int, int]) -> IntArray:
        """Bin of each evaluated trajectory, (n,): 0, 1, ...; ``len(titles)`` = not known."""
        values = self.values(clip, size)
        found = np.searchsorted(self.bounds, np.nan_to_num(values), side="right")
        return np.where(np.isnan(values), len(self.titles), found)


def motion_sizes(labels: Labels) -> FloatArray:
    """Count trajectories with the same true label, (n,); NaN without a label."""
    sizes = np.bincount(labels.label, minlength=1).astype(np.float64)
    sizes[0] = np.nan
    return sizes[labels.label]


def speeds(tracks: Trajectories) -> FloatArray:
    """Median distance between positions in consecutive frames, px (N,); NaN where there are no two."""
    return _median(np.linalg.norm(np.diff(tracks.xy, axis=1), axis=2))


def thirds(tracks: Trajectories, size: tuple[int, int]) -> FloatArray:
    """Ninth of an image of W x H pixels that holds the mean position, (N,): 0 top left, 1 top centre, ...

    NaN where a trajectory is visible in no frame. Pixels count from the centre of the top-left one.
    """
    seen = tracks.visible.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(tracks.visible[..., None], tracks.xy, 0.0).sum(axis=1) / seen[:, None]
    column, row = np.clip((3 * (mean + 0.5) / np.asarray(size)) // 1, 0, 2).T
    return np.asarray(3 * row + column, dtype=np.float64)


def from_epipolar_lines(tracks: Trajectories, static: BoolArray, gap: int = GAP) -> FloatArray:
    """Distance from the epipolar lines of the static scene after `gap` frames, px: the median over time.

    A rigid scene leaves each point a line in the other frame: x2 lies on F x1. How far a trajectory that is
    not of the static scene (n,) leaves it is all that two views reveal of its motion; near 0 it moves along
    the line. Where a homography explains the static scene (the camera rests or only turns, or the scene is
    a plane) no line can be measured, and the distance is that from where the homography takes the point. NaN
    where fewer than 12 static trajectories are visible together with it in two such frames. (N,) float64.
    """
    gap = min(gap, tracks.n_frames - 1)
    found = np.full((len(tracks), max(0, tracks.n_frames - gap)), np.nan)
    for first in range(found.shape[1] if gap else 0):
        rows, x1, x2 = tracks.pair(first, first + gap)
        still = static[rows]
        if still.sum() >= _FEWEST:
            found[rows, first] = _off_lines(x1, x2, still)
    return _median(found)


def _off_lines(x1: FloatArray, x2: FloatArray, still: BoolArray) -> FloatArray:
    """Measure one frame pair, (P,); what fits the static scene is fitted again without its outliers."""
    off = np.zeros(len(x1))
    for distance in (_off_homography, _off_epipolar):
        near = still
        for _ in range(_FITS):
            off = distance(x1, x2, near)
            near = still & (off <= 3 * np.median(off[still]) + 1e-9)
        if np.median(off[still]) < _FLAT:
            break
    return off


def _off_homography(x1: FloatArray, x2: FloatArray, still: BoolArray) -> FloatArray:
    (a, t1), (b, t2) = _normalised(x1, still), _normalised(x2, still)
    zero = np.zeros_like(a)
    design = np.concatenate([np.hstack([a, zero, -b[:, :1] * a]), np.hstack([zero, a, -b[:, 1:2] * a])])
    h = np.linalg.inv(t2) @ _null(design[np.tile(still, 2)]) @ t1
    mapped = np.column_stack([x1, np.ones(len(x1))]) @ h.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - x2, axis=1))


def _off_epipolar(x1: FloatArray, x2: FloatArray, still: BoolArray) -> FloatArray:
    # Hartley, "In defense of the eight-point algorithm", TPAMI 1997.
    (a, t1), (b, t2) = _normalised(x1, still), _normalised(x2, still)
    design = (b[:, :, None] * a[:, None, :]).reshape(len(a), 9)
    u, s, v = np.linalg.svd(_null(design[still]))
    lines = np.column_stack([x1, np.ones(len(x1))]) @ (t2.T @ (u[:, :2] * s[:2]) @ v[:2] @ t1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        algebraic = np.abs((lines[:, :2] * x2).sum(axis=1) + lines[:, 2])
        return np.asarray(algebraic / np.linalg.norm(lines[:, :2], axis=1))


def _normalised(x: FloatArray, still: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Homogeneous points (P, 3) in Hartley's coordinates of the static ones, and the similarity (3, 3)."""
    _, similarity = normalise(x[still])
    return np.column_stack([x, np.ones(len(x))]) @ similarity.T, similarity


def _null(design: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.svd(design.T @ design)[2][-1].reshape(3, 3))


def _median(values: FloatArray) -> FloatArray:
    """Median of each row without its NaN, (N,); NaN where there is nothing else."""
    with warnings.catch_warnings(action="ignore"):  # for rows of NaN
        return np.asarray(np.nanmedian(values, axis=1))


def _from_lines(clip: Clip, _: tuple[int, int]) -> FloatArray:
    labels = clip.labels  # where they do not name the static scene, it is the largest motion
    static = labels.label == (labels.background or int(np.bincount(labels.label)[1:].argmax() + 1))
    return np.where(static, -1.0, from_epipolar_lines(clip.evaluated_trajectories, static))


def _bins(*bounds: float) -> tuple[tuple[float, ...], tuple[str, ...]]:
    return bounds, bin_titles(bounds)


_ROWS, _COLUMNS = ("top", "middle", "bottom"), ("left", "centre", "right")
_NINTHS = tuple(range(1, 9)), tuple(f"{row} {column}" for row in _ROWS for column in _COLUMNS)
_LINE = (0.0, 0.5, 2, 8), ("static scene", *_bins(0.5, 2, 8)[1])
_ABOUT_LINE = (
    "Distance from the epipolar line that the static scene leaves the point. What moves along that line, at "
    "a small distance, looks static in any two frames. Where the camera rests or only turns: distance from "
    "where the static scene would be."
)
AXES = (
    TrackAxis(
        *("size", "size of the motion, trajectories"),
        "Number of evaluated trajectories that have the same true motion.",
        lambda clip, _: motion_sizes(clip.labels),
        *_bins(20, 50, 100, 200),
    ),
    TrackAxis(
        *("length", "length of the track, frames"),
        "Number of frames in which the trajectory is visible.",
        lambda clip, _: clip.evaluated_trajectories.lengths.astype(np.float64),
        *_bins(5, 10, 15, 20),
    ),
    TrackAxis(
        *("speed", "speed in the image, px per frame"),
        "Median distance between the positions in two consecutive frames.",
        lambda clip, _: speeds(clip.evaluated_trajectories),
        *_bins(0.5, 2, 4, 8, 16),
    ),
    TrackAxis("line", f"off the epipolar line in {GAP} frames, px", _ABOUT_LINE, _from_lines, *_LINE),
    TrackAxis(
        *("position", "position in the image"),
        "Ninth of the image in which the trajectory's mean position lies.",
        lambda clip, size: thirds(clip.evaluated_trajectories, size),
        *_NINTHS,
    ),
)
