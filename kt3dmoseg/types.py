"""Central types: trajectories, labels, clips.

All are frozen; their arrays are read-only and are checked once, on construction. Pixel coordinates
are (x right, y down) with (0, 0) at the centre of the top-left pixel; frames count from 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError, optional
from kt3dmoseg.registry import strict

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes

FloatArray: TypeAlias = npt.NDArray[np.float64]
Float32Array: TypeAlias = npt.NDArray[np.float32]
IntArray: TypeAlias = npt.NDArray[np.int64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
ByteArray: TypeAlias = npt.NDArray[np.uint8]

_UNLABELLED = 0
_MAX_SIDE = 1 << 20
_MAX_INT = np.iinfo(np.int64).max
_BLOCK = 1 << 20


def frozen(values: npt.ArrayLike, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Return a read-only array of `dtype`, copied unless it is one already; refuse what would wrap around."""
    given = np.asarray(values)
    if given.dtype.kind == "c":
        raise InvalidValueError("array", expected="real numbers", found=f"{given.dtype}")
    if dtype == np.int64 and given.dtype == np.uint64 and given.size and given.max() > _MAX_INT:
        raise InvalidValueError("whole numbers", expected=f"at most {_MAX_INT}", found=_brief(given))
    if np.ma.is_masked(values):
        fix = "fill what is masked; a point that is not visible has NaN"
        raise InvalidValueError("array", expected="no masked values", found=_brief(given), fix=fix)
    if dtype == np.bool_ and given.dtype != dtype and not np.isin(given, (0, 1)).all():
        raise InvalidValueError("array", expected="True or False", found=_brief(given))
    same = given.dtype == dtype and not given.flags.writeable and given.base is None
    try:
        array = given if same else np.array(given, dtype=dtype, order="C")
    except (TypeError, ValueError):
        raise InvalidValueError("array", expected="numbers", found=f"{values!r:.60}") from None
    if dtype == np.int64 and (
        given.dtype.kind == "b" or (given.dtype.kind == "f" and (array != given).any())
    ):
        raise InvalidValueError("array", expected="whole numbers", found=_brief(given))
    array.flags.writeable = False
    return array


class Value:
    """A frozen dataclass of arrays and mappings."""

    def __reduce__(self) -> tuple[object, ...]:
        """Rebuild through the constructor: pickling alone would make the arrays writable."""
        kind = next(c for c in type(self).__mro__ if "__dataclass_fields__" in vars(c))
        values = (getattr(self, item.name) for item in fields(kind))
        return kind, tuple(dict(v) if isinstance(v, Mapping) else v for v in values)

    def _set(self, **values: object) -> None:
        vars(self).update(values)


@strict
@dataclass(frozen=True, eq=False)
class Trajectories(Value):
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
            found = f"shape {track_id.shape}"
            raise InvalidValueError("track_id", expected=f"{len(xy)} unique ids", found=found)
        _check_presence(xy, visible)
        size = None if self.image_size is None else _image_size(self.image_size)
        self._set(xy=xy, visible=visible, track_id=track_id, image_size=size)

    def __repr__(self) -> str:
        return f"Trajectories({len(self)} over {self.n_frames} frames)"

    def _repr_html_(self) -> str:
        from kt3dmoseg.draw.display import html_table

        lengths, size = self.lengths, self.image_size
        facts = [
            ("frames", str(self.n_frames)),
            ("image size", f"{size[0]} x {size[1]} pixels" if size else "unknown"),
            ("median length", f"{np.median(lengths):g} frames" if len(lengths) else ""),
            ("visible in every frame", str(int((lengths == self.n_frames).sum()))),
        ]
        return html_table(repr(self), ("", ""), facts)

    def __len__(self) -> int:
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
        """Return rows (P,) of the trajectories visible in two frames, and their positions in each, (P, 2)."""
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

    def plot(
        self, frame: int | None = None, *, picture: npt.ArrayLike | None = None, ax: Axes | None = None
    ) -> Axes:
        """Plot the trajectories with matplotlib, coloured by the number of frames they live.

        Parameters
        ----------
        frame : int or None
            Index of a frame, shown with trails of 8 frames; None = the whole trajectories.
        picture : (H, W) or (H, W, 3) array, optional
            Drawn below.
        ax : matplotlib.axes.Axes, optional
            Where to plot; by default a new figure.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        InvalidValueError
            When there is no such frame, or the picture has another size than the frames.
        MissingDependencyError
            Without matplotlib, the extra ``plot``.
        """
        from kt3dmoseg.draw.display import plot_painting
        from kt3dmoseg.draw.painting import by_length

        return plot_painting(by_length(self), frame, picture=picture, ax=ax)

    def to_dataframe(self) -> pd.DataFrame:
        """Give one row per visible position: `track` (its id), `frame` (index), `x` and `y` in pixels."""
        import pandas as pd

        row, frame = np.nonzero(self.visible)
        x, y = self.xy[row, frame].T
        return pd.DataFrame({"track": self.track_id[row], "frame": frame, "x": x, "y": y})

    def to_xarray(self) -> xr.Dataset:
        """Give `x` and `y` over `track` (its id) and `frame` (index), in pixels, NaN where invisible.

        Raises `MissingDependencyError` without xarray, the extra ``xarray``.
        """
        dataset = optional("xarray", "to_xarray needs", "xarray").Dataset
        axes, unit = ("track", "frame"), {"units": "pixels"}
        values = {name: (axes, self.xy[..., k], unit) for k, name in enumerate("xy")}
        size = {"image_size": self.image_size} if self.image_size else {}
        made: xr.Dataset = dataset(values, {"track": self.track_id, "frame": np.arange(self.n_frames)}, size)
        return made


@strict
@dataclass(frozen=True, eq=False)
class Labels(Value):
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
            raise InvalidValueError("label", expected="integers >= 0", found=_brief(raw))
        if np.ndim(self.background):  # type: ignore[arg-type]
            raise InvalidValueError("background", expected="a label", found=f"{self.background!r:.60}")
        background = None if self.background is None else int(frozen(self.background, np.int64))
        for key, name in self.names.items():
            number = isinstance(key, (int, np.integer)) and not isinstance(key, bool) and abs(key) < 10**18
            if not (number and isinstance(name, str)):
                raise InvalidValueError("names", expected="{label: name}", found=f"{ {key: name}!r:.60}")
        names = MappingProxyType({int(key): name for key, name in self.names.items()})
        self._set(label=frozen(self.label, np.int64), names=names, background=background)

    def __repr__(self) -> str:
        return f"Labels({len(self)} of {self.n_motions} motions)"

    def __len__(self) -> int:
        return len(self.label)

    @property
    def motions(self) -> IntArray:
        """The distinct labels other than 0, ascending."""
        found = np.unique(self.label)
        return found[found > _UNLABELLED]

    @property
    def n_motions(self) -> int:
        """Number of distinct labels other than 0."""
        return len(self.motions)

    def _repr_html_(self) -> str:
        from kt3dmoseg.draw.display import labels_html

        return labels_html(repr(self), self)

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Plot the number of trajectories of every motion with matplotlib; see `Trajectories.plot`."""
        from kt3dmoseg.draw.display import plot_labels

        return plot_labels(self, ax=ax)

    def to_dataframe(self) -> pd.DataFrame:
        """Give one row per label, in order: `label` and `name`, empty where the motion has none."""
        import pandas as pd

        names = [self.names.get(label, "") for label in self.label.tolist()]
        return pd.DataFrame({"label": self.label, "name": pd.Series(names, dtype=object)})


@strict
@dataclass(frozen=True, eq=False)
class Camera(Value):
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
        self._set(K=matrix)


@strict
@dataclass(frozen=True, eq=False)
class Clip(Value):
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
            raise InvalidValueError("evaluated", expected=f"rows in 0..{n - 1}", found=_brief(rows))
        if len(np.unique(rows)) != len(rows):
            raise InvalidValueError("evaluated", expected="unique rows", found="a row given twice")
        if len(self.labels) != len(rows):
            expected = f"{len(rows)} (one per evaluated row)"
            raise InvalidValueError("labels", expected=expected, found=f"{len(self.labels)}")
        numbers = np.arange(frames) if self.frame_numbers is None else self.frame_numbers
        values = {"frame_numbers": frozen(numbers, np.int64)}
        if self.timestamps is not None:
            values["timestamps"] = frozen(self.timestamps, np.float64)
        for name, array in values.items():
            if array.shape != (frames,):
                raise InvalidValueError(name, expected=f"shape ({frames},)", found=f"{array.shape}")
        if len(np.unique(values["frame_numbers"])) != frames:
            found = _brief(values["frame_numbers"])
            raise InvalidValueError("frame_numbers", expected="each number once", found=found)
        self._set(evaluated=rows, provenance=MappingProxyType(dict(self.provenance)), **values)

    def __repr__(self) -> str:
        return (
            f"Clip({self.name!r}: {self.n_frames} frames, {len(self.dense)} trajectories, "
            f"{len(self.evaluated)} evaluated, {self.n_motions} motions)"
        )

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

    def _repr_html_(self) -> str:
        from kt3dmoseg.draw.display import clip_html

        return clip_html(self)

    def plot(
        self, frame: int | None = None, *, picture: npt.ArrayLike | None = None, ax: Axes | None = None
    ) -> Axes:
        """Plot the evaluated trajectories, coloured by their labels; see `Trajectories.plot`."""
        from kt3dmoseg.draw.display import plot_painting
        from kt3dmoseg.draw.painting import by_label

        return plot_painting(by_label(self), frame, title=self.name, picture=picture, ax=ax)

    def to_dataframe(self) -> pd.DataFrame:
        """Give one row per visible position of the evaluated trajectories.

        The columns are those of `Trajectories.to_dataframe`, then `frame_number`, and `label` and `name` of
        the motion.
        """
        table = self.evaluated_trajectories.to_dataframe()
        motions = self.labels.to_dataframe().set_index(self.dense.track_id[self.evaluated])
        table["frame_number"] = self.frame_numbers[table["frame"]]
        return table.join(motions, on="track")


def _image_size(size: npt.ArrayLike) -> tuple[int, int]:
    """Return width and height of frames as whole numbers; refuse what is none."""
    values = np.asarray(size)
    fine = values.shape == (2,) and values.dtype.kind in "iuf"
    if not fine or not ((values >= 1) & (values <= _MAX_SIDE) & (values == np.floor(values))).all():
        raise InvalidValueError(
            "image_size", expected=f"(width, height), 1..{_MAX_SIDE}", found=f"{size!r:.80}"
        )
    return int(values[0]), int(values[1])


def _check_presence(xy: npt.NDArray[np.float64], visible: npt.NDArray[np.bool_]) -> None:
    """Refuse positions (N, F, 2) that are not finite exactly where visible (N, F), and NaN elsewhere."""
    rows = max(1, _BLOCK // max(1, xy.shape[1]))  # by blocks: a long clip leaves no room for masks of it all
    for first in range(0, len(xy), rows):
        part, seen = xy[first : first + rows], visible[first : first + rows]
        wrong = np.where(seen, ~np.isfinite(part).all(axis=2), ~np.isnan(part).all(axis=2))
        if wrong.any():
            row, frame = np.argwhere(wrong)[0]
            where, found = f"xy of trajectory {first + row} in frame {frame}", str(part[row, frame].tolist())
            expected = "finite" if seen[row, frame] else "NaN (not visible)"
            raise InvalidValueError(where, expected=expected, found=found)


def _brief(array: npt.NDArray[Any]) -> str:
    """Describe an array in a few words."""
    if not array.size or array.dtype.kind not in "biuf":
        return f"{array.dtype} of shape {array.shape}"
    return f"{array.dtype} of shape {array.shape}, values {array.min()}..{array.max()}"
