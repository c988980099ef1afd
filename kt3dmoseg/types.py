"""Central types: trajectories, labels, clips.

All are frozen; their arrays are read-only and are checked once, on construction. Pixel coordinates
are (x right, y down) with (0, 0) at the centre of the top-left pixel; frames count from 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.arrays import brief, check_presence, frozen, image_size, per_frame
from kt3dmoseg.errors import InvalidValueError

FloatArray: TypeAlias = npt.NDArray[np.float64]
Float32Array: TypeAlias = npt.NDArray[np.float32]
IntArray: TypeAlias = npt.NDArray[np.int64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
ByteArray: TypeAlias = npt.NDArray[np.uint8]

_UNLABELLED = 0


@dataclass(frozen=True, eq=False)
class Trajectories:
    """N point trajectories over F frames.

    Parameters
    ----------
    xy : (N, F, 2) float64
        Positions in pixels; NaN exactly where `visible` is False.
    visible : (N, F) bool
        Whether the trajectory exists in the frame. A trajectory may be visible nowhere.
    track_id : (N,) int64, optional
        Unique identities, kept by `select`; by default 0..N-1.
    image_size : (W, H) or None
        Width and height of the frames in pixels, when known.

    Raises
    ------
    InvalidValueError
        When shapes disagree, ids repeat, `xy` is not finite exactly where visible, or the image has no size.
    """

    xy: FloatArray
    visible: BoolArray
    track_id: IntArray = None  # type: ignore[assignment]  # filled in __post_init__
    image_size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        xy = frozen(self.xy, np.float64)
        visible = frozen(self.visible, np.bool_)
        if xy.ndim != 3 or xy.shape[2] != 2:
            raise InvalidValueError("xy", expected="shape (N, F, 2)", found=f"{xy.shape}")
        if visible.shape != xy.shape[:2]:
            raise InvalidValueError("visible", expected=f"shape {xy.shape[:2]}", found=f"{visible.shape}")
        ids = np.arange(len(xy)) if self.track_id is None else self.track_id
        track_id = frozen(ids, np.int64)
        if track_id.shape != (len(xy),) or len(np.unique(track_id)) != len(xy):
            raise InvalidValueError(
                "track_id", expected=f"{len(xy)} unique ids", found=f"shape {track_id.shape}"
            )
        check_presence(xy, visible)
        object.__setattr__(self, "xy", xy)
        object.__setattr__(self, "visible", visible)
        object.__setattr__(self, "track_id", track_id)
        if self.image_size is not None:
            object.__setattr__(self, "image_size", image_size(self.image_size))

    def __reduce__(self) -> tuple[object, ...]:
        """Rebuild through the constructor: pickling alone would make the arrays writable."""
        return Trajectories, (self.xy, self.visible, self.track_id, self.image_size)

    def __repr__(self) -> str:
        """Say how many there are; the arrays would fill the screen."""
        return f"Trajectories({len(self)} over {self.n_frames} frames)"

    def __len__(self) -> int:
        """Return the number of trajectories."""
        return len(self.xy)

    @property
    def n_frames(self) -> int:
        """Number of frames F."""
        return int(self.xy.shape[1])

    @property
    def lengths(self) -> IntArray:
        """Number of visible frames of each trajectory, (N,) int64."""
        return np.asarray(self.visible.sum(axis=1), dtype=np.int64)

    def pair(self, i: int, j: int) -> tuple[IntArray, FloatArray, FloatArray]:
        """Correspondences between two frames.

        Parameters
        ----------
        i, j : int
            Frame indices.

        Returns
        -------
        rows : (P,) int64
            Rows of the trajectories visible in both frames, ascending.
        x1, x2 : (P, 2) float64
            Their positions in frame `i` and in frame `j`.
        """
        rows = np.flatnonzero(self.visible[:, i] & self.visible[:, j])
        return rows, self.xy[rows, i], self.xy[rows, j]

    def at(self, frame: int) -> tuple[IntArray, FloatArray]:
        """Return rows (P,) of the trajectories visible in a frame, ascending, and their positions (P, 2)."""
        rows = np.flatnonzero(self.visible[:, frame])
        return rows, self.xy[rows, frame]

    def block(self, first: int, last: int) -> tuple[FloatArray, BoolArray]:
        """Return positions (n, F, 2) and visibility (n, F) of the rows from `first` to before `last`."""
        return self.xy[first:last], self.visible[first:last]

    def select(self, rows: npt.ArrayLike) -> Trajectories:
        """Return the trajectories at `rows` (indices or boolean mask), ids kept."""
        index = np.asarray(rows)
        return Trajectories(self.xy[index], self.visible[index], self.track_id[index], self.image_size)


@dataclass(frozen=True, eq=False)
class Labels:
    """Motion labels.

    Parameters
    ----------
    label : (N,) int64
        0 = unlabelled or outlier; 1, 2, ... = motions. Numbers need not be contiguous.
    background : int or None
        The label of the static scene, when known.
    names : mapping of int to str
        What each motion is called; may be empty.
    """

    label: IntArray
    background: int | None = None
    names: Mapping[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        raw = np.asarray(self.label)
        if raw.ndim != 1:
            raise InvalidValueError("label", expected="a vector (N,)", found=f"shape {raw.shape}")
        if raw.size and not (np.issubdtype(raw.dtype, np.integer) and raw.min() >= _UNLABELLED):
            raise InvalidValueError("label", expected="integers >= 0", found=brief(raw))
        object.__setattr__(self, "label", frozen(raw, np.int64))
        object.__setattr__(self, "names", MappingProxyType(dict(self.names)))
        if self.background is not None:
            object.__setattr__(self, "background", int(frozen(self.background, np.int64)))

    def __repr__(self) -> str:
        """Say how many there are; the array would fill the screen."""
        return f"Labels({len(self)} of {self.n_motions} motions)"

    def __len__(self) -> int:
        """Return the number of labels."""
        return len(self.label)

    def __reduce__(self) -> tuple[object, ...]:
        """Rebuild through the constructor: a read-only mapping view does not pickle."""
        return Labels, (self.label, self.background, dict(self.names))

    @property
    def motions(self) -> IntArray:
        """The distinct labels other than 0, ascending."""
        found = np.unique(self.label)
        return found[found > _UNLABELLED]

    @property
    def n_motions(self) -> int:
        """Number of distinct labels other than 0."""
        return len(self.motions)


@dataclass(frozen=True, eq=False)
class Camera:
    """The camera that filmed a clip.

    Parameters
    ----------
    name : str
        For instance ``"image_00"``.
    K : (3, 3) float64 or None
        Matrix that maps normalised to pixel coordinates (intrinsics; in Hopkins155 files the
        matrix with which the benchmark normalised its coordinates).
    """

    name: str = ""
    K: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.K is None:
            return
        matrix = frozen(self.K, np.float64)
        if matrix.shape != (3, 3):
            raise InvalidValueError("camera.K", expected="shape (3, 3)", found=f"{matrix.shape}")
        object.__setattr__(self, "K", matrix)

    def __reduce__(self) -> tuple[object, ...]:
        """Rebuild through the constructor: pickling alone would make the matrix writable."""
        return Camera, (self.name, self.K)


@dataclass(frozen=True, eq=False)
class Clip:
    """One sequence: dense trajectories, the evaluated ones among them, and their labels.

    Parameters
    ----------
    name : str
        Name of the clip, for instance ``"Seq005_Clip01"``.
    dense : Trajectories
        All trajectories.
    evaluated : (n,) int64
        Rows of `dense` that are scored, in the order of `labels`.
    labels : Labels
        Motion labels of the evaluated rows; all 0 when the clip is not labelled.
    frame_numbers : (F,) int64, optional
        Numbers of the frames in their source; by default 0..F-1.
    timestamps : (F,) float64 or None
        Seconds, when known.
    camera : Camera or None
        Camera, when known.
    provenance : mapping of str to JSON-able values
        Where the clip comes from: sources' sha256, options, versions.
    """

    name: str
    dense: Trajectories
    evaluated: IntArray
    labels: Labels
    frame_numbers: IntArray = None  # type: ignore[assignment]  # filled in __post_init__
    timestamps: FloatArray | None = None
    camera: Camera | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rows = frozen(self.evaluated, np.int64)
        n, frames = len(self.dense), self.dense.n_frames
        if rows.ndim != 1 or (rows.size and (rows.min() < 0 or rows.max() >= n)):
            raise InvalidValueError("evaluated", expected=f"rows in 0..{n - 1}", found=brief(rows))
        if len(np.unique(rows)) != len(rows):
            raise InvalidValueError("evaluated", expected="unique rows", found="a row given twice")
        if len(self.labels) != len(rows):
            raise InvalidValueError(
                "labels", expected=f"{len(rows)} (one per evaluated row)", found=f"{len(self.labels)}"
            )
        numbers = np.arange(frames) if self.frame_numbers is None else self.frame_numbers
        object.__setattr__(self, "evaluated", rows)
        object.__setattr__(self, "frame_numbers", per_frame(numbers, np.int64, frames, "frame_numbers"))
        if self.timestamps is not None:
            seconds = per_frame(self.timestamps, np.float64, frames, "timestamps")
            object.__setattr__(self, "timestamps", seconds)
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    def __repr__(self) -> str:
        """Say in one line what the clip holds."""
        return (
            f"Clip({self.name!r}: {self.n_frames} frames, {len(self.dense)} trajectories, "
            f"{len(self.evaluated)} evaluated, {self.n_motions} motions)"
        )

    def __reduce__(self) -> tuple[object, ...]:
        """Rebuild through the constructor: a read-only mapping view does not pickle."""
        fields = (self.name, self.dense, self.evaluated, self.labels, self.frame_numbers)
        return Clip, (*fields, self.timestamps, self.camera, dict(self.provenance))

    @property
    def n_frames(self) -> int:
        """Number of frames F."""
        return self.dense.n_frames

    @property
    def n_motions(self) -> int:
        """Number of labelled motions among the evaluated trajectories."""
        return self.labels.n_motions

    @property
    def evaluated_trajectories(self) -> Trajectories:
        """The evaluated trajectories, in the order of `labels`."""
        return self.dense.select(self.evaluated)

    def with_labels(self, labels: Labels) -> Clip:
        """Return the same clip with other labels of the evaluated rows."""
        return replace(self, labels=labels)

    def without_labels(self) -> Clip:
        """Return the same clip as a method may see it: every label 0."""
        return replace(self, labels=Labels(np.zeros(len(self.evaluated), dtype=np.int64)))
