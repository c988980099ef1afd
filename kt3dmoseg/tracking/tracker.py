"""Dense point trajectories from frames, in one pass that holds two frames and one pair of flows.

They are kept in memory proportional to their points; those to evaluate are chosen by `subsample_background`.
"""

from __future__ import annotations

import dataclasses
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sized
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from kt3dmoseg import __version__
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.flow import Flow, backend_identity, check_frame, flow_pair
from kt3dmoseg.flow import create as create_flow
from kt3dmoseg.frames import FrameSource, one_source
from kt3dmoseg.io.images import Colour, read_frame
from kt3dmoseg.matching import stem
from kt3dmoseg.options import from_mapping
from kt3dmoseg.tracking import TrackOptions
from kt3dmoseg.tracking.linking import inside, new_seeds, step
from kt3dmoseg.tracking.point_trackers import PointTracker, create_tracker, follow
from kt3dmoseg.types import (
    BoolArray,
    ByteArray,
    Clip,
    FloatArray,
    IntArray,
    Labels,
    Trajectories,
    frozen,
)

if TYPE_CHECKING:
    from kt3dmoseg.tracking.appearance import Appearance

Progress: TypeAlias = Callable[[int, int | None], None]
Frames: TypeAlias = "str | os.PathLike[str] | Iterable[ByteArray | str | os.PathLike[str]]"


def track(
    frames: Frames,
    flow: str | Flow = "dis",
    seeds: npt.ArrayLike | None = None,
    *,
    tracker: str | PointTracker = "",
    colour: Colour = "refuse",
    cache: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    **options: Any,  # noqa: ANN401
) -> Trajectories:
    """Dense point trajectories of a clip (Sundaram, Brox, Keutzer, ECCV 2010).

    Points start on a grid where the frame has structure, follow the flow, and stop at the frame's
    border, where forward and backward flow disagree, at motion boundaries and, as an option, where they
    no longer look like their start. With `anchor`, what the start looked like corrects every step. New
    trajectories start in the uncovered cells of every frame; those shorter than `min_length` are dropped.

    Parameters
    ----------
    frames : path-like, or iterable of arrays or of path-likes
        A folder of images, or a video; or gray frames (H, W) uint8, as an array (F, H, W) has, or the paths
        of images.
        An array whose last dimension is by far the shortest, or with 3 or 4 rows, may be (H, W, F) or one
        picture in colour and is refused: give ``list(frames)``. An iterator
        is consumed one frame at a time, so a clip of any length needs only the memory of two frames,
        one pair of flow fields, and its trajectories.
    flow : str or Flow
        A name of `kt3dmoseg.flow.list`, or a backend.
    seeds : (S, 3) array-like, optional
        x, y, frame: track exactly these points instead of seeding the grid. Row k of the result is
        seed k; nothing is dropped.
    tracker : str or PointTracker, optional
        Follows the points instead of optical flow (`kt3dmoseg.tracking.point_trackers`); of the options it
        takes those of starts and `min_length`. The frames are all in memory.
    colour : {"refuse", "luma"}
        What to do with images in colour, see `kt3dmoseg.io.images.read_frame`; of videos the luma is taken.
    cache : path-like, optional
        Folder in which flow fields are kept and looked up by content.
    progress : callable, optional
        Called with (frames done, frames in all or None) after each frame.
    **options
        Fields of `TrackOptions`.

    Returns
    -------
    Trajectories
        In the order of their start: by frame, then row by row over the grid.

    Raises
    ------
    InvalidValueError
        For fewer than two frames, frames of different sizes, a bad seed or option value.
    UnknownNameError
        For an unknown flow or option.
    """
    settings = from_mapping(TrackOptions, options, where="track")
    items = one_source(frames).frames(colour) if isinstance(frames, (str, os.PathLike)) else frames
    _check_axes(frames)
    total, report = len(items) if isinstance(items, Sized) else None, progress or (lambda done, total: None)
    chosen = _checked(seeds)
    if tracker:
        pictures = list(_gray_frames(items, colour))
        _reject_beyond(chosen, len(pictures), pictures[0].shape)
        return follow(create_tracker(tracker), pictures, chosen, settings, report)
    backend = create_flow(flow) if isinstance(flow, str) else flow
    looks = _appearance(settings) if settings.appearance or settings.anchor else None
    ids, xy, count = np.zeros(0, dtype=np.int64), np.zeros((0, 2)), 0
    seen: list[tuple[IntArray, FloatArray]] = []
    before: ByteArray | None = None
    for frame in _gray_frames(items, colour):
        if looks:
            looks.look_at(frame)
        if before is not None:
            forward, backward = flow_pair(backend, before, frame, cache)
            target, alive = step(xy, forward, backward, settings)
            if looks:
                target, alive = looks.follow(forward, xy, target, alive)
            ids, xy = ids[alive], target[alive]
        if chosen is None:
            new = new_seeds(frame, xy, settings)
            rows = np.arange(count, count + len(new))
        else:
            rows, new = _starting(chosen, len(seen), frame.shape)
        if looks:
            looks.add(new)
        count += len(new)
        ids, xy = np.concatenate([ids, rows]), np.concatenate([xy, new])
        seen.append((ids, xy))
        before = frame
        report(len(seen), total)
    _reject_beyond(chosen, len(seen), frame.shape)
    least = settings.min_length if chosen is None else 0
    return RunTrajectories(seen, count, least, (frame.shape[1], frame.shape[0]))


def _appearance(settings: TrackOptions) -> Appearance:
    from kt3dmoseg.tracking.appearance import Appearance  # numba, half a second that few options need

    return Appearance(settings)


def _check_axes(frames: Frames) -> None:
    if isinstance(frames, np.ndarray) and frames.ndim == 3:
        rows, columns, last = frames.shape
        if last < min(rows, columns / 2) or rows in (3, 4):  # perhaps the channels of one picture
            fix = "of (H, W, F) give np.moveaxis(frames, -1, 0); of such narrow or few frames list(frames)"
            raise InvalidValueError("frames", expected="(F, H, W)", found=f"{frames.shape}", fix=fix)


def track_clip(
    frames: str | os.PathLike[str] | FrameSource,
    flow: str | Flow = "dis",
    *,
    tracker: str | PointTracker = "",
    colour: Colour = "refuse",
    cache: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    **options: Any,  # noqa: ANN401
) -> Clip:
    """Track the frames of one clip: every trajectory is evaluated and none labelled.

    Parameters
    ----------
    frames : path-like or FrameSource
        A folder of numbered frames, a video, a KITTI raw root with one clip, or a part of these, as
        `kt3dmoseg.frames.choose_sources` gives; the clip takes its name.
    flow, tracker, colour, cache, progress, **options
        As in `kt3dmoseg.track`.

    Returns
    -------
    Clip
        Its provenance holds what the frames are with their sha256, every option and the versions.

    Raises
    ------
    InputFileError, FileFormatError
        For frames that cannot be read.
    InvalidValueError, UnknownNameError
        As `kt3dmoseg.track`, and for several clips.
    """
    settings = from_mapping(TrackOptions, options, where="track")
    if tracker:
        chosen: dict[str, Any] = {"tracker": create_tracker(tracker)}
        about: dict[str, Any] = {"tracker": backend_identity(chosen["tracker"])}
    else:
        backend = create_flow(flow) if isinstance(flow, str) else flow
        chosen, about = {"flow": backend, "cache": cache}, {"flow": type(backend).__name__}
        about["flow_options"] = dataclasses.asdict(backend) if dataclasses.is_dataclass(backend) else {}
    source = one_source(frames) if isinstance(frames, (str, os.PathLike)) else frames
    info, numbers = source.inspect(), source.numbers()
    report = None if progress is None else lambda done, _: progress(done, len(numbers))
    shown = dataclasses.asdict(settings)
    dense = track(source.frames(colour), progress=report, **chosen, **shown)
    return Clip(
        name=source.name,
        dense=dense,
        evaluated=np.arange(len(dense)),
        labels=Labels(np.zeros(len(dense), dtype=np.int64)),
        frame_numbers=np.array(numbers),
        timestamps=info.timestamps,
        camera=info.camera,
        provenance={
            "source": info.description,
            **about,
            "track_options": shown,
            "versions": {"kt3dmoseg": __version__, "numpy": np.__version__, "opencv": cv2.__version__},
        },
    )


class _Order:
    """Refuses paths in the order of their letters: frame1, frame10, frame2."""

    last: Path | None = None
    direction = 0

    def check(self, path: Path) -> None:
        last, self.last = self.last, path
        if last is None or last.parent != path.parent:
            return
        now, before = ([int(n) for n in re.findall(r"\d+", stem(p.name))] for p in (path, last))
        turn = (now > before) - (now < before)
        self.direction = self.direction or turn
        if turn not in (0, self.direction):
            found, fix = f"{last.name} before {path.name}", "sort them by number, or give their folder"
            raise InvalidValueError("frames", expected="frames in their order", found=found, fix=fix)


def _gray_frames(items: Iterable[ByteArray | str | os.PathLike[str]], colour: Colour) -> Iterator[ByteArray]:
    first: tuple[int, ...] | None = None
    number, order = 0, _Order()
    for number, item in enumerate(items, start=1):
        name, frame = f"frame {number - 1}", item
        if isinstance(frame, (str, os.PathLike)):
            name = os.fspath(frame)
            order.check(Path(name))
            frame = read_frame(Path(name), colour)
        check_frame(name, frame, first)
        first = frame.shape
        yield frame
    if number < 2:
        raise InvalidValueError("frames", expected="at least 2 frames", found=str(number))


def _checked(seeds: npt.ArrayLike | None) -> FloatArray | None:
    if seeds is None:
        return None
    out = frozen(seeds, np.float64)
    if out.ndim != 2 or out.shape[1] != 3:
        raise InvalidValueError("seeds", expected="shape (S, 3): x, y, frame", found=f"{out.shape}")
    whole = np.isfinite(out).all(axis=1) & (out[:, 2] == np.trunc(out[:, 2]))
    _reject(out, ~whole | (out[:, 2] < 0), "finite x, y and a whole frame number >= 0")
    return out


def _starting(seeds: FloatArray, number: int, shape: tuple[int, ...]) -> tuple[IntArray, FloatArray]:
    _reject_beyond(seeds, math.inf, shape)
    now = seeds[:, 2] == number
    return np.flatnonzero(now), seeds[now, :2]


def _reject_beyond(seeds: FloatArray | None, count: float, shape: tuple[int, ...]) -> None:
    if seeds is not None:
        outside = ~inside(seeds[:, :2], shape)
        _reject(seeds, outside, f"a point in the {shape[1]}x{shape[0]} frame")
        _reject(seeds, seeds[:, 2] >= count, f"a frame number below {count}, the number of frames")


def _reject(seeds: FloatArray, bad: BoolArray, expected: str) -> None:
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise InvalidValueError(f"seed {row}", expected=expected, found=str(seeds[row].tolist()))


class RunTrajectories(Trajectories):
    """Trajectories that are visible in one run of frames each, kept as these runs.

    `xy` and `visible` are laid out on first use: over a long clip nearly all of (N, F, 2) is NaN. `frames`
    holds per frame the identities (L,) int64, below `count`, and positions (L, 2) float64 of what is
    visible; trajectories that are visible in fewer than `min_length` frames are dropped.
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
        self._set(track_id=frozen(np.arange(len(self._start)), np.int64), image_size=image_size)

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
        xy, _ = self.block(0, len(self))
        xy.flags.writeable = False  # in place: it may be large
        return xy

    @cached_property
    def visible(self) -> BoolArray:
        """Whether each exists in each frame, (N, F)."""
        return frozen(~np.isnan(self.xy[..., 0]), np.bool_)

    def block(self, first: int, last: int) -> tuple[FloatArray, BoolArray]:
        """Positions and visibility of some rows; see `Trajectories.block`."""
        return self._laid_out(np.arange(len(self))[first:last])

    def at(self, frame: int) -> tuple[IntArray, FloatArray]:
        """Rows and positions in one frame; see `Trajectories.at`."""
        frame = range(self.n_frames)[frame]
        rows = np.flatnonzero((self._start <= frame) & (frame < self._start + self._lengths))
        return rows, self._points[self._offset[rows] + frame - self._start[rows]]

    def select(self, rows: npt.ArrayLike) -> Trajectories:
        """Return the trajectories at `rows` (indices or boolean mask), ids kept."""
        index = np.arange(len(self))[np.asarray(rows)]
        return Trajectories(*self._laid_out(index), self.track_id[index], self.image_size)

    def _laid_out(self, rows: IntArray) -> tuple[FloatArray, BoolArray]:
        length = self._lengths[rows]
        row = np.repeat(np.arange(len(rows)), length)
        step = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
        xy = np.full((len(rows), self._n_frames, 2), np.nan)
        xy[row, self._start[rows][row] + step] = self._points[self._offset[rows][row] + step]
        return xy, np.isfinite(xy[..., 0])


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
        When the fraction is not in [0, 1], or labels are given without the background label.
    """
    if not 0 <= fraction <= 1:
        raise InvalidValueError("fraction", expected="a number from 0 to 1", found=str(fraction))
    if labels.background is None and labels.n_motions:
        expected = "the label of the static scene"
        raise InvalidValueError("labels.background", expected=expected, found="none", fix="set it")
    motions, size = np.unique(labels.label, return_counts=True)
    large = np.isin(labels.label, motions[size >= smallest])
    foreground = np.flatnonzero(large & (labels.label != 0) & (labels.label != labels.background))
    background = np.flatnonzero((labels.label != 0) & (labels.label == labels.background))
    count = max(round(fraction * len(background)), int(fraction > 0 and len(background) > 0))
    drawn = rng.integers(0, max(1, len(background)), size=count)
    return np.sort(np.concatenate([foreground, background[np.unique(drawn)]])).astype(np.int64)
