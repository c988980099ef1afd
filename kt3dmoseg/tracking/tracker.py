"""Dense point trajectories from frames, in one pass that holds two frames and one pair of flows."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.flow import Flow, FlowCache, flow_pair
from kt3dmoseg.flow import create as create_flow
from kt3dmoseg.options import from_mapping
from kt3dmoseg.tracking.appearance import Appearance
from kt3dmoseg.tracking.frames import FrameSource, open_frames
from kt3dmoseg.tracking.linking import inside, step
from kt3dmoseg.tracking.options import TrackOptions
from kt3dmoseg.tracking.seeding import new_seeds
from kt3dmoseg.tracking.store import TrackStore
from kt3dmoseg.types import ByteArray, Float32Array, FloatArray, IntArray, Trajectories

Progress: TypeAlias = Callable[[int, int | None], None]


def track(
    frames: FrameSource,
    flow: str | Flow = "dis",
    seeds: npt.ArrayLike | None = None,
    *,
    cache: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    **options: Any,  # noqa: ANN401
) -> Trajectories:
    """Dense point trajectories of a clip (Sundaram, Brox, Keutzer, ECCV 2010).

    Points start on a grid where the frame has structure, follow the flow, and stop at the frame's
    border, where forward and backward flow disagree, at motion boundaries and, if asked for, where they
    no longer look like their start. With `anchor`, what the start looked like corrects every step. Cells
    that are left uncovered start anew in every frame; trajectories shorter than `min_length` are dropped.

    Parameters
    ----------
    frames : path-like, or iterable of arrays or of path-likes
        A folder of images; or gray frames (H, W) uint8, or the paths of images. An iterator is
        consumed one frame at a time, so a clip of any length needs only the memory of two frames,
        one pair of flow fields, and its trajectories.
    flow : str or Flow
        A name of `kt3dmoseg.flow.list`, or a backend.
    seeds : (S, 3) array-like, optional
        x, y, frame: track exactly these points instead of seeding the grid. Row k of the result is
        seed k; nothing is dropped.
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
    backend = create_flow(flow) if isinstance(flow, str) else flow
    store = None if cache is None else FlowCache(Path(cache))
    starts = _Grid(settings) if seeds is None else _Given(seeds)
    stream, total = open_frames(frames)
    run = _Run(starts, settings)
    before: ByteArray | None = None
    done = 0
    for frame in stream:
        run.see(frame)
        if before is not None:
            run.advance(*flow_pair(backend, before, frame, store))
        run.start(frame)
        before, done = frame, done + 1
        if progress is not None:
            progress(done, total)
    if before is None or done < 2:
        raise InvalidValueError("frames", expected="at least 2 frames", found=str(done))
    starts.check_end(done)
    height, width = before.shape
    return run.positions.finish(starts.count, settings.min_length if seeds is None else 0, (width, height))


class _Run:
    """The live trajectories while frames go by."""

    def __init__(self, starts: _Starts, options: TrackOptions) -> None:
        self.starts, self.options, self.positions = starts, options, TrackStore()
        self.ids: IntArray = np.zeros(0, dtype=np.int64)
        self.xy: FloatArray = np.zeros((0, 2))
        self.looks = Appearance(options) if options.appearance or options.anchor else None

    def see(self, frame: ByteArray) -> None:
        if self.looks is not None:
            self.looks.see(frame)

    def advance(self, forward: Float32Array, backward: Float32Array) -> None:
        target, alive = step(self.xy, forward, backward, self.options)
        before, self.ids, self.xy = self.xy[alive], self.ids[alive], target[alive]
        if self.looks is not None:
            self.looks.keep(alive)
            self.xy, alike = self.looks.follow(forward, before, self.xy)
            self.looks.keep(alike)
            self.ids, self.xy = self.ids[alike], self.xy[alike]

    def start(self, frame: ByteArray) -> None:
        ids, xy = self.starts.next(frame, self.xy)
        if self.looks is not None:
            self.looks.add(xy)
        self.ids, self.xy = np.concatenate([self.ids, ids]), np.concatenate([self.xy, xy])
        self.positions.append(self.ids, self.xy)


class _Starts(Protocol):
    """Where trajectories start; `count` of them so far."""

    count: int

    def next(self, frame: ByteArray, live: FloatArray) -> tuple[IntArray, FloatArray]: ...

    def check_end(self, frames: int) -> None: ...


class _Grid:
    def __init__(self, options: TrackOptions) -> None:
        self.options, self.count = options, 0

    def next(self, frame: ByteArray, live: FloatArray) -> tuple[IntArray, FloatArray]:
        xy = new_seeds(frame, live, self.options)
        ids = np.arange(self.count, self.count + len(xy))
        self.count += len(xy)
        return ids, xy

    def check_end(self, frames: int) -> None:
        """Grid seeds start in whatever frames there are."""


class _Given:
    def __init__(self, seeds: npt.ArrayLike) -> None:
        self.seeds = np.asarray(seeds, dtype=np.float64)
        if self.seeds.ndim != 2 or self.seeds.shape[1] != 3:
            raise InvalidValueError(
                "seeds", expected="shape (S, 3): x, y, frame", found=f"{self.seeds.shape}"
            )
        whole = np.isfinite(self.seeds).all(axis=1) & (self.seeds[:, 2] == np.trunc(self.seeds[:, 2]))
        self._refuse(~whole | (self.seeds[:, 2] < 0), "finite x, y and a whole frame number >= 0")
        self.count, self._frame = len(self.seeds), 0

    def next(self, frame: ByteArray, live: FloatArray) -> tuple[IntArray, FloatArray]:
        now = self.seeds[:, 2] == self._frame
        height, width = frame.shape
        self._refuse(now & ~inside(self.seeds[:, :2], frame.shape), f"a point in the {width}x{height} frame")
        self._frame += 1
        ids = np.flatnonzero(now)
        return ids, self.seeds[ids, :2]

    def check_end(self, frames: int) -> None:
        self._refuse(self.seeds[:, 2] >= frames, f"a frame number below {frames}, the number of frames")

    def _refuse(self, bad: npt.NDArray[np.bool_], expected: str) -> None:
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            raise InvalidValueError(f"seed {row}", expected=expected, found=str(self.seeds[row].tolist()))
