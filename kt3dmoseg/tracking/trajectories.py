"""Growing trajectories in memory proportional to their points, and the choice of those to evaluate."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import BoolArray, FloatArray, IntArray, Labels, Trajectories, frozen


class RunTrajectories(Trajectories):
    """Trajectories that are visible in one run of frames each, kept as these runs.

    `xy` and `visible` are laid out when they are first asked for: over a long clip nearly all of (N, F, 2)
    is NaN.

    Parameters
    ----------
    frames : list of (ids, xy)
        Per frame the identities (L,) int64, below `count`, and positions (L, 2) float64 of what is visible.
    count : int
        Number of identities.
    min_length : int
        Trajectories that are visible in fewer frames are dropped.
    image_size : (W, H)
        Size of the frames in pixels.
    """

    def __init__(
        self,
        frames: list[tuple[IntArray, FloatArray]],
        count: int,
        min_length: int,
        image_size: tuple[int, int],
    ) -> None:
        ids = np.concatenate([ids for ids, _ in frames])
        length = np.bincount(ids, minlength=count)
        kept = length >= min_length
        start = np.zeros(count, dtype=np.int64)
        for frame in reversed(range(len(frames))):
            start[frames[frame][0]] = frame
        order = np.argsort(ids, kind="stable")  # by trajectory, then by frame
        order = order[kept[ids[order]]]
        self._start, self._lengths, self._n_frames = start[kept], length[kept], len(frames)
        self._points = np.concatenate([xy for _, xy in frames])[order]
        self._offset = np.cumsum(self._lengths) - self._lengths
        object.__setattr__(self, "track_id", frozen(np.arange(len(self._start)), np.int64))
        object.__setattr__(self, "image_size", image_size)

    def __len__(self) -> int:
        """Return the number of trajectories."""
        return len(self._start)

    @property
    def n_frames(self) -> int:
        """Number of frames F."""
        return self._n_frames

    @property
    def lengths(self) -> IntArray:
        """Number of visible frames of each trajectory, (N,) int64."""
        return self._lengths.copy()

    @cached_property
    def xy(self) -> FloatArray:
        """Positions (N, F, 2), NaN where invisible."""
        return self._dense[0]

    @cached_property
    def visible(self) -> BoolArray:
        """Whether each exists in each frame, (N, F)."""
        return self._dense[1]

    def block(self, first: int, last: int) -> tuple[FloatArray, BoolArray]:
        """Positions and visibility of some rows; see `Trajectories.block`."""
        return self._laid_out(np.arange(first, min(last, len(self))))

    def at(self, frame: int) -> tuple[IntArray, FloatArray]:
        """Rows and positions in one frame; see `Trajectories.at`."""
        rows = np.flatnonzero((self._start <= frame) & (frame < self._start + self._lengths))
        return rows, self._points[self._offset[rows] + frame - self._start[rows]]

    def select(self, rows: npt.ArrayLike) -> Trajectories:
        """Return the trajectories at `rows` (indices or boolean mask), ids kept."""
        index = np.arange(len(self))[np.asarray(rows)]
        return Trajectories(*self._laid_out(index), self.track_id[index], self.image_size)

    @cached_property
    def _dense(self) -> tuple[FloatArray, BoolArray]:
        xy, visible = self._laid_out(np.arange(len(self)))
        xy.flags.writeable = visible.flags.writeable = False
        return xy, visible

    def _laid_out(self, rows: IntArray) -> tuple[FloatArray, BoolArray]:
        length = self._lengths[rows]
        row = np.repeat(np.arange(len(rows)), length)
        step = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
        xy = np.full((len(rows), self._n_frames, 2), np.nan)
        xy[row, self._start[rows][row] + step] = self._points[self._offset[rows][row] + step]
        visible = np.zeros(xy.shape[:2], dtype=np.bool_)
        visible[row, self._start[rows][row] + step] = True
        return xy, visible


def subsample_background(
    labels: Labels, rng: np.random.Generator, fraction: float = 0.1, smallest: int = 1
) -> IntArray:
    """Choose the trajectories that are evaluated.

    Every labelled foreground trajectory is kept, of motions that have `smallest` of them. Of the B
    background trajectories, round(fraction * B) are drawn uniformly *with* replacement and duplicates
    are dropped, so at the default about 9.5 % of them are kept: this is the rule that the 2018 release
    is consistent with (its kept share is 9.65 % pooled, independent of a trajectory's length and
    position). Unlabelled trajectories (label 0) are never evaluated.

    Parameters
    ----------
    labels : Labels
        Labels of all dense trajectories, with `background` set.
    rng : numpy.random.Generator
        Source of the draw; the same state gives the same rows.
    fraction : float
        Share of the background that is drawn, 0 to 1; a background that exists keeps at least one
        trajectory as long as the fraction is not 0.
    smallest : int
        Moving objects with fewer trajectories are not evaluated, neither as a motion nor as background.

    Returns
    -------
    (n,) int64
        Rows of the dense trajectories, ascending.

    Raises
    ------
    InvalidValueError
        When the fraction is not in [0, 1], or labels are given without saying which is the background.
    """
    if not 0 <= fraction <= 1:
        raise InvalidValueError("fraction", expected="a number from 0 to 1", found=str(fraction))
    if labels.background is None and labels.n_motions:
        raise InvalidValueError(
            "labels.background", expected="the label of the static scene", found="none", fix="set it"
        )
    motions, size = np.unique(labels.label, return_counts=True)
    large = np.isin(labels.label, motions[size >= smallest])
    foreground = np.flatnonzero(large & (labels.label != 0) & (labels.label != labels.background))
    background = np.flatnonzero((labels.label != 0) & (labels.label == labels.background))
    count = round(fraction * len(background))
    if fraction > 0 and len(background):
        count = max(1, count)
    drawn = rng.integers(0, max(1, len(background)), size=count)
    rows = np.concatenate([foreground, background[np.unique(drawn)]])
    return np.sort(rows).astype(np.int64)
