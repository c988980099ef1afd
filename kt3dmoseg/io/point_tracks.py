"""Tracks of point trackers and their benchmarks in ``.npz``: one table of layouts, read and written by it.

Which layout a file has is known from the names of its arrays (F frames, N tracks):

* ``cotracker``: `pred_tracks` (F, N, 2) and `pred_visibility` (F, N) or (F, N, 1). As `tracks` and
  `visibility`, both orders of axes are in use; how points move shows which one it is.
* ``tapir`` (BootsTAPIR, TAPNext): `tracks` (N, F, 2) and `visibles` (N, F), or the logits `occlusion` and
  `expected_dist`, by which a point is visible when (1 - p(occluded)) (1 - p(inexact)) > 1/2 (Doersch et al.,
  ICCV 2023).
* ``tap-vid``: `points` (N, F, 2) as fractions of width and height, `occluded`, and `video` (F, H, W, C),
  (F, C, H, W) or (F, H, W), with whose first pictures the points are compared, or `image_size`.
* ``kubric``: `target_points` (N, F, 2), `occluded`.
* ``pointodyssey``: `trajs_2d` (F, N, 2), `visibs` (or `visibilities`), `valids`.
* ``tapvid-3d``: `tracks_XYZ` (F, N, 3) in metres, `visibility`, `fx_fy_cx_cy`; projected, never written.

All but TAP-Vid's are pixels, and a first axis of one video may precede the others. CoTracker, PointOdyssey
and the projection have whole numbers at pixel centres, as we have; TAPIR, TAP-Vid and Kubric count from the
outer corner of the image.
"""

import math
import os
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import PathLike
from kt3dmoseg.io import npz
from kt3dmoseg.io.fields import CLEAR, NEEDED, NUMBERS, Fields, bends, check_axes, clip_from, foreign_clip
from kt3dmoseg.types import BoolArray, Clip, FloatArray, Trajectories

write = npz.write
_CHANNELS = {1, 3, 4}
_OUTSIDE = 0.05  # a tracker may follow a point a little over the border
# Points are compared with pictures where so many move so far, in so many bytes of the first pictures.
_PICTURES, _ENOUGH, _MOVED, _SAME = 1 << 25, 20, 2.0, 0.1
# Over few frames, the share of the change at standing points: up to 0.62 for the released clips (0.67 over
# all), and 0.98 or more for the same scaled by 2 or played backwards. Chosen on every other clip.
_NEAR, _STANDING = 8, 0.9
_NEAREST = 1e-3  # metres before the camera; what is nearer is not projected


class Layout(NamedTuple):
    """One layout: its arrays, the order of their axes, ``NF`` or ``FN``, and where pixels count from."""

    name: str
    tracks: str
    seen: str  # probabilities or flags; of points hidden, not seen, with `hidden`
    order: str = "NF"
    corner: float = 0.0
    hidden: bool = False
    others: tuple[str, ...] = ()


LAYOUTS = (
    Layout("cotracker", "pred_tracks", "pred_visibility", "FN"),
    Layout("tapir", "tracks", "visibles", corner=0.5),
    Layout("tapir", "tracks", "occlusion", corner=0.5, others=("expected_dist",)),
    Layout("cotracker", "tracks", "visibility", "?"),
    Layout("tap-vid", "points", "occluded", corner=0.5, hidden=True, others=("video",)),
    Layout("tap-vid", "points", "occluded", corner=0.5, hidden=True, others=("image_size",)),
    Layout("kubric", "target_points", "occluded", corner=0.5, hidden=True),
    Layout("pointodyssey", "trajs_2d", "visibs", "FN"),
    Layout("pointodyssey", "trajs_2d", "visibilities", "FN"),
    Layout("tapvid-3d", "tracks_XYZ", "visibility", "FN", others=("fx_fy_cx_cy",)),
)
WRITTEN = tuple(dict.fromkeys(layout.name for layout in LAYOUTS if layout.name != "tapvid-3d"))


def read(path: PathLike) -> Clip:
    """Read a clip, or the tracks of a tracker; see `kt3dmoseg.io.load` for the errors."""
    fields = Fields(f"{os.fspath(path)}: ", npz.read_npz(path, {"video", "images_jpeg_bytes"}))
    if set(fields) >= NEEDED:
        return clip_from(fields)
    layout = _layout(fields, os.fspath(path))
    tracks = _tapvid(fields, path) if layout.name == "tap-vid" else _pixels(layout, fields)
    return foreign_clip(path, layout.name, tracks)


def tracks_from(arrays: Mapping[str, npt.NDArray[Any]], where: str) -> Trajectories:
    """Return the trajectories of arrays in a layout of pixels, by their names; `where` begins messages."""
    fields = Fields(f"{where}: ", arrays)
    return _pixels(_layout(fields, where), fields)


def _layout(fields: Fields, where: str) -> Layout:
    for layout in LAYOUTS:
        if set(fields) >= {layout.tracks, layout.seen, *layout.others}:
            return layout
    raise FileFormatError(
        where,
        expected=f"the arrays {', '.join(sorted(NEEDED))} of a clip",
        found=", ".join(sorted(fields)) or "none",
        fix=f"the arrays of {', '.join(dict.fromkeys(layout.name for layout in LAYOUTS))} are read too",
    )


def write_layout(clip: Clip, path: PathLike, name: str) -> None:
    """Write all trajectories of a clip as a tracker would, in one of `WRITTEN`; equal clips give equal bytes.

    Where a point is not visible it has its last visible position, or its first one. Labels, which rows are
    evaluated, ids and the rest have no room.

    Raises
    ------
    InvalidValueError
        For another layout or suffix, and for TAP-Vid when the size of the frames is not known.
    """
    if name not in WRITTEN or not os.fspath(path).endswith(".npz"):
        found = f"{name!r} in {os.fspath(path)}"
        raise InvalidValueError("layout", expected=f"{', '.join(WRITTEN)}, in a .npz", found=found)
    layout = next(each for each in LAYOUTS if each.name == name)
    visible, size = clip.dense.visible, clip.dense.image_size
    xy, seen = _filled(clip.dense.xy, visible) + layout.corner, visible != layout.hidden
    arrays: dict[str, npt.NDArray[Any]] = {layout.tracks: xy, layout.seen: seen}
    if layout.order == "FN":
        arrays = {key: values.swapaxes(0, 1) for key, values in arrays.items()}
    if name == "cotracker":
        arrays = {key: values[None] for key, values in arrays.items()}
    if name == "tap-vid":
        if size is None:
            fix = "build it from its frames, or write another layout"
            raise InvalidValueError(
                f"{clip.name}: image_size", expected="that of the frames", found="none", fix=fix
            )
        arrays |= {"points": xy / size, "image_size": np.array(size)}
    npz.write_npz(path, arrays)


def _filled(xy: FloatArray, visible: BoolArray) -> FloatArray:
    """Give points (N, F, 2) that are not visible the last visible position, else the first; 0 if none."""
    if not visible.shape[1]:
        return xy
    frames = np.arange(visible.shape[1])
    last = np.maximum.accumulate(np.where(visible, frames, -1), axis=1)
    chosen = np.where(last >= 0, last, visible.argmax(axis=1)[:, None])
    return np.nan_to_num(np.take_along_axis(xy, chosen[..., None], axis=1))


def _pixels(layout: Layout, fields: Fields) -> Trajectories:
    dimensions = 3 if layout.name == "tapvid-3d" else 2
    points = _without_batch(fields, layout.tracks, dimensions)
    visible = _visible(layout, fields, points.shape[:2])
    if layout.name == "tapvid-3d":
        points, visible = _projected(fields, points, visible)
    xy = points.astype(np.float64) - layout.corner
    if layout.order == "FN" or (layout.order == "?" and _frames_first(layout.tracks, xy, visible)):
        xy, visible = xy.swapaxes(0, 1), visible.T
    check_axes(layout.tracks, xy, visible)
    return Trajectories(np.where(visible[..., None], xy, np.nan), visible)


def _without_batch(fields: Fields, name: str, dimensions: int) -> npt.NDArray[Any]:
    """Return positions with two axes and so many dimensions; a batch of one video is taken apart."""
    given = fields.array(name)
    points = given[0] if given.ndim == 4 and len(given) == 1 else given
    if points.ndim != 3 or points.shape[2] != dimensions:
        expected = f"frames and tracks x {dimensions}, or a batch of one such video"
        raise fields.error(name, expected, f"shape {given.shape}")
    return points


def _visible(layout: Layout, fields: Fields, shape: tuple[int, ...]) -> BoolArray:
    if layout.seen == "occlusion":
        hidden, inexact = (_like(fields, name, shape) for name in ("occlusion", "expected_dist"))
        with np.errstate(over="ignore"):
            return np.asarray((1 + np.exp(hidden)) * (1 + np.exp(inexact)) < 2)
    seen = _like(fields, layout.seen, shape)
    if not ((seen >= 0) & (seen <= 1)).all():
        raise fields.error(layout.seen, "0 to 1", f"{seen.min():g} to {seen.max():g}")
    visible = (seen > 0.5) != layout.hidden
    return np.asarray(visible & (_like(fields, "valids", shape) > 0.5) if "valids" in fields else visible)


def _like(fields: Fields, name: str, shape: tuple[int, ...]) -> FloatArray:
    """Return an array of one number per position, whose axes of size one at both ends do not count."""
    values = fields.array(name)
    if values.shape not in (shape, (1, *shape), (*shape, 1), (1, *shape, 1)):
        raise fields.error(name, f"shape {shape}", f"{values.shape}")
    return values.reshape(shape).astype(np.float64)


def _projected(fields: Fields, points: npt.NDArray[Any], visible: BoolArray) -> tuple[FloatArray, BoolArray]:
    fx, fy, cx, cy = fields.array("fx_fy_cx_cy", (4,)).astype(np.float64)
    front = np.isfinite(points).all(axis=2) & (points[..., 2] > _NEAREST)
    with np.errstate(all="ignore"):
        xy = points[..., :2] / points[..., 2:] * (fx, fy) + (cx, cy)
    return xy, visible & front


def _frames_first(name: str, xy: FloatArray, visible: BoolArray) -> bool:
    """Whether the first axis is time: a path bends less in time than from track to track.

    Of two frames or tracks, a point stays closer to itself than it is to the others; one is a track.
    """
    if 1 in xy.shape[:2]:
        return bool(xy.shape[1] == 1)
    first, second = bends(xy, visible)
    if 2 in xy.shape[:2]:
        first, second = (_apart(*turned) for turned in ((xy, visible), (xy.swapaxes(0, 1), visible.T)))
    if not max(first, second) > CLEAR * min(first, second):
        found = f"points {first:.3g} px apart along the first axis, {second:.3g} px along the second"
        fix = "name them pred_tracks and pred_visibility (F, N), or tracks and visibles (N, F)"
        raise InvalidValueError(name, expected="axes that show in how points move", found=found, fix=fix)
    return second > first


def _apart(xy: FloatArray, visible: BoolArray) -> float:
    """Median distance of positions over half of the first axis; 0 without any."""
    half = max(1, len(xy) // 2)
    moved = (xy[half:] - xy[:-half])[visible[half:] & visible[:-half]]
    return float(np.median(np.hypot(*moved.T))) if len(moved) else 0.0


def _tapvid(fields: Fields, path: PathLike) -> Trajectories:
    points = fields.array("points", (None, None, 2))
    visible = ~fields.flags("occluded", points.shape[:2])
    size, channels = _size_of_video(fields, points.shape) if "video" in fields else (None, ())
    width, height = size or fields.integers("image_size", 2, low=1).tolist()
    low, high = points[visible].min(initial=0), points[visible].max(initial=0)
    if low < -_OUTSIDE or high > 1 + _OUTSIDE:
        fix = "of pixels, add 0.5 and divide by width and height"
        raise fields.error("points", "fractions of width and height, 0 to 1", f"{low:g} to {high:g}", fix)
    xy = points.astype(np.float64) * (width, height) - 0.5
    check_axes("points", xy, visible)
    tracks = Trajectories(np.where(visible[..., None], xy, np.nan), visible, image_size=(width, height))
    if size is not None and fields["video"].dtype.kind in NUMBERS:
        video = fields["video"]
        count = min(_PICTURES // max(1, math.prod(video.shape[1:]) * video.itemsize), len(video))
        if count > 1:
            pictures = npz.read_npz(path, {"video"}, count)["video"]
            check_on_pictures("points", tracks, pictures[[0, -1]].mean(axis=channels), len(pictures) - 1)
    return tracks


def _size_of_video(fields: Fields, points: tuple[int, ...]) -> tuple[tuple[int, int], tuple[int, ...]]:
    """Return width and height of the pictures of TAP-Vid's `video`, and its axis of channels, if any."""
    video = fields["video"].shape
    if len(video) not in (3, 4) or video[0] != points[1]:
        fix = "swap tracks and frames of points and occluded" if video[:1] == points[:1] else ""
        expected = f"{points[1]} frames (F, H, W, C), as points (N, F, 2) have"
        raise fields.error("video", expected, f"video of shape {video}, points {points}", fix)
    channels = tuple(axis for axis in (1, 3) if len(video) == 4 and video[axis] in _CHANNELS)
    if (len(channels) != 1) if len(video) == 4 else (video[0] in _CHANNELS - {1}):  # one picture's channels?
        expected, fix = "(F, H, W, C) or (F, C, H, W), C = 1, 3 or 4", "of gray frames give video[..., None]"
        raise fields.error("video", expected, f"shape {video}", fix)
    height, width = (n for axis, n in enumerate(video) if axis not in (0, *channels))
    return (width, height), channels


def check_on_pictures(where: str, tracks: Trajectories, pictures: npt.NDArray[Any], last: int) -> None:
    """Refuse tracks that keep their brightness from picture 0 to picture `last`, (2, H, W), only otherwise.

    That is with x and y exchanged, or scaled from the smaller pictures that trackers work on; of pictures
    that are near, also those that keep it no better than points that stand still.
    """
    size = np.array(pictures.shape[2:0:-1])
    _, before, after = tracks.pair(0, last)
    moved = np.abs(after - before).max(axis=1, initial=0) > _MOVED
    places = np.stack([before, after])[:, moved]
    if places.shape[1] < _ENOUGH:
        return
    readings = _readings(places, size)
    # Those that follow first: a reading may be better only because its points lie where the picture is even.
    lost, best, words = min((not _follows(o, pictures), _change(o, pictures), words) for words, o in readings)
    worse = _change(places, pictures) > CLEAR * max(best, _SAME)
    if worse and not lost:
        only = "as (y, x)" if "::" in words else f"when scaled by {words}"
        fix = "give points[..., ::-1]" if "::" in words else f"multiply them by {words}"
        found = f"points that follow the frames only {only}"
        raise InvalidValueError(where, expected="(x, y), x to the right, in pixels", found=found, fix=fix)
    if (worse or last <= _NEAR) and not _follows(places, pictures):
        found, fix = (
            "points that follow them no better than standing ones",
            "give those of these frames, in order",
        )
        expected = "points that follow the frames, in pixels of {}x{}".format(*size)
        raise InvalidValueError(where, expected=expected, found=found, fix=fix)


def _readings(places: FloatArray, size: npt.NDArray[Any]) -> Iterator[tuple[str, FloatArray]]:
    """Give other ways to read places (2, P, 2): their words, and what the places then are."""
    turned = places[..., ::-1]
    yield from (("..., ::-1", turned), ("..., ::-1", (turned + 0.5) / size[::-1] * size - 0.5))
    for raster in ((256, 256), (512, 384), (512, 512)):
        if (places.max(axis=(0, 1)) < raster).all() and (size > np.array(raster) * 1.1).any():
            yield "({:.4g}, {:.4g})".format(*(size / raster)), (places + 0.5) * (size / raster) - 0.5


def _follows(places: FloatArray, pictures: npt.NDArray[Any]) -> bool:
    """Whether places (2, P, 2) keep their brightness better than points that stand still."""
    standing = np.stack([places[0], places[0]])
    return _change(places, pictures) <= _STANDING * max(_change(standing, pictures), _SAME)


def _change(places: FloatArray, pictures: npt.NDArray[Any]) -> float:
    """Mean change of brightness of places (2, P, 2), as a share of that between different places."""
    rounded = np.rint(places).clip(0, np.array(pictures.shape[2:0:-1]) - 1).astype(np.int64)
    before, after = (picture[y, x] for picture, (x, y) in zip(pictures, rounded.swapaxes(1, 2), strict=True))
    apart = np.abs(np.roll(after, len(after) // 2) - before).mean()
    return float(np.abs(after - before).mean() / max(apart, 1e-9))
