"""NumPy files: arrays read without pickles and without trusting a size; clips and point tracks in .npz.

docs/formats.md lists the arrays of a clip, for those who have no HDF5. CoTracker: `pred_tracks`
(1, F, N, 2) pixels with integers at pixel centres, `pred_visibility` (1, F, N) or (1, F, N, 1). TAP-Vid:
`points` (N, F, 2) as fractions of width and height from the outer corner of the image, `occluded` (N, F),
and `video` (F, H, W, C), (F, C, H, W) or (F, H, W), with whose first pictures the points are compared.
"""

from __future__ import annotations

import io
import math
import os
from collections.abc import Container, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.files import SafeZip, ZipLimits, write_bytes, zip_bytes
from kt3dmoseg.io.fields import NEEDED, NUMBERS, Fields, check_axes, clip_from, clip_values, foreign_clip
from kt3dmoseg.types import BoolArray, Clip, FloatArray, Trajectories

_CHANNELS = {1, 3, 4}
_OUTSIDE = 0.05  # a tracker may follow a point a little over the border
_FREE = 1 << 24
# The video of TAP-Vid is compared at so many points that move so far, in so many bytes of its first pictures.
_PICTURES, _ENOUGH, _MOVED, _SAME = 1 << 25, 20, 2.0, 0.25
# A video of TAP-Vid may be large; most of it is not read.
_LIMITS = ZipLimits(256, 1 << 32, 1 << 40, ratio=1100, free_bytes=_FREE)
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
_MAX_HEADER = 10_000


def read_npz(
    path: str | os.PathLike[str], shapes: Container[str] = (), rows: int = 0
) -> dict[str, npt.NDArray[Any]]:
    """Read the arrays of a .npz file; FileFormatError when it is damaged, or one is refused by `read_npy`.

    Of those named in `shapes` only shape and type are read: their values are zeros, which take no memory;
    with `rows`, their first rows.
    """
    where, out = os.fspath(path), {}
    with SafeZip(path, _LIMITS, where) as archive:
        for file, size in archive.sizes.items():
            name = file.removesuffix(".npy")
            with archive.open(file) as stream:
                out[name] = read_npy(stream, size, f"{where}: {name}", rows if name in shapes else None)
    return out


def is_lone_array(path: Path) -> bool:
    """Whether a file is a .npz of a single array."""
    with SafeZip(path, _LIMITS, f"{path}", faults=[]) as archive:
        return len(archive.sizes) == 1


def read_npy(stream: IO[bytes], size: int, where: str, rows: int | None = None) -> npt.NDArray[Any]:
    """Read a .npy of numbers or texts from a stream of at most `size` bytes, or its first rows only.

    Of 0 rows, or of a file in Fortran's order, there are shape and type, and zeros.

    FileFormatError when it is damaged, holds Python objects, or declares a wrong size.
    """
    try:
        read_header = _HEADERS[np.lib.format.read_magic(stream)]
        shape, fortran, dtype = read_header(stream, max_header_size=_MAX_HEADER)
    except Exception as error:  # a header is a Python literal: numpy raises anything on a damaged one
        found = f"damage: {str(error)[:200]}"
        raise FileFormatError(where, expected="an intact .npy of version 1 or 2", found=found) from None
    if dtype.kind not in "biufcSU" or dtype.hasobject:
        fix = "objects need pickle, which is never read"
        raise FileFormatError(where, expected="numbers or texts", found=f"{dtype!s:.80}", fix=fix)
    if min(shape, default=0) < 0 or (0 in shape and math.prod(n or 1 for n in shape) > _FREE):
        expected = f"dimensions >= 0, in an empty array at most {_FREE} elements"
        raise FileFormatError(where, expected=expected, found=f"{shape!r:.80}")
    if rows == 0 or (rows and fortran):
        return np.broadcast_to(np.zeros((), dtype), shape)
    shape = (min(rows, shape[0]), *shape[1:]) if rows else shape
    needed = math.prod(shape) * dtype.itemsize
    content = stream.read(needed) if needed <= size else b""
    if len(content) != needed:
        found = f"{len(content)}" if needed <= size else f"at most {size}"
        raise FileFormatError(where, expected=f"{needed} bytes for {shape}", found=found)
    return np.frombuffer(content, dtype).reshape(shape, order="F" if fortran else "C").copy()


def write_npz(path: str | os.PathLike[str], arrays: Mapping[str, npt.ArrayLike]) -> None:
    """Write a compressed .npz atomically; equal arrays give equal bytes."""
    write_bytes(path, zip_bytes({f"{name}.npy": npy_bytes(np.asarray(a)) for name, a in arrays.items()}))


def npy_bytes(array: npt.NDArray[Any]) -> bytes:
    """Return the content of a .npy file."""
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def write(clip: Clip, path: str | os.PathLike[str]) -> None:
    """Write a clip; the same clip gives the same bytes."""
    write_npz(
        path, {"name": clip.name, "xy": clip.dense.xy, "visible": clip.dense.visible} | clip_values(clip)
    )


def read(path: str | os.PathLike[str]) -> Clip:
    """Read a clip, the output of CoTracker or a video of TAP-Vid; see `kt3dmoseg.io.load` for the errors."""
    fields = Fields(f"{os.fspath(path)}: ", read_npz(path, {"video"}))
    names = set(fields)
    if names >= {"pred_tracks", "pred_visibility"}:
        return foreign_clip(path, "cotracker", _cotracker(fields))
    if names >= {"points", "occluded", "video"}:
        return foreign_clip(path, "tap-vid", _tapvid(fields, path))
    if names >= NEEDED:
        return clip_from(fields)
    raise FileFormatError(
        os.fspath(path),
        expected=f"the arrays {', '.join(sorted(NEEDED))} of a clip",
        found=", ".join(sorted(names)) or "none",
        fix="the arrays of CoTracker and of TAP-Vid (points, occluded, video) are read too",
    )


def _cotracker(fields: Fields) -> Trajectories:
    tracks = fields.array("pred_tracks", (1, None, None, 2))
    seen = fields.array("pred_visibility")
    if seen.shape not in (tracks.shape[:3], (*tracks.shape[:3], 1)):
        raise fields.error("pred_visibility", f"shape {tracks.shape[:3]}", f"{seen.shape}")
    if not ((seen >= 0) & (seen <= 1)).all():
        raise fields.error("pred_visibility", "0 to 1", f"{seen.min():g} to {seen.max():g}")
    visible = seen.reshape(tracks.shape[1:3]).T > 0.5
    xy = tracks[0].swapaxes(0, 1).astype(np.float64)
    check_axes("pred_tracks", xy, visible)
    return Trajectories(np.where(visible[..., None], xy, np.nan), visible)


def _tapvid(fields: Fields, path: str | os.PathLike[str]) -> Trajectories:
    points, video = fields.array("points", (None, None, 2)), fields["video"].shape
    visible = ~fields.flags("occluded", points.shape[:2])
    if len(video) not in (3, 4) or video[0] != points.shape[1]:
        fix = "swap tracks and frames of points and occluded" if video[:1] == points.shape[:1] else ""
        expected = f"{points.shape[1]} frames (F, H, W, C), as points (N, F, 2) have"
        raise fields.error("video", expected, f"video of shape {video}, points {points.shape}", fix)
    channels = [axis for axis in (1, 3) if len(video) == 4 and video[axis] in _CHANNELS]
    if (len(channels) != 1) if len(video) == 4 else (video[0] in _CHANNELS - {1}):  # one picture's channels?
        expected, fix = "(F, H, W, C) or (F, C, H, W), C = 1, 3 or 4", "of gray frames give video[..., None]"
        raise fields.error("video", expected, f"shape {video}", fix)
    height, width = (n for axis, n in enumerate(video) if axis not in (0, *channels))
    low, high = points[visible].min(initial=0), points[visible].max(initial=0)
    if low < -_OUTSIDE or high > 1 + _OUTSIDE:
        fix = "of pixels, add 0.5 and divide by width and height"
        raise fields.error("points", "fractions of width and height, 0 to 1", f"{low:g} to {high:g}", fix)
    xy = points.astype(np.float64) * (width, height) - 0.5
    check_axes("points", xy, visible)
    count = _PICTURES // max(1, math.prod(video[1:]) * fields["video"].itemsize)
    if min(count, video[0]) > 1 and fields["video"].dtype.kind in NUMBERS:
        pictures = read_npz(path, {"video"}, count)["video"]
        _check_on_video(fields, xy, visible, pictures[[0, -1]].mean(axis=tuple(channels)), len(pictures) - 1)
    return Trajectories(np.where(visible[..., None], xy, np.nan), visible, image_size=(width, height))


def _check_on_video(
    fields: Fields, xy: FloatArray, visible: BoolArray, pictures: npt.NDArray[Any], n: int
) -> None:
    """Refuse points that keep their brightness from picture 0 to picture n, (2, H, W), only as (y, x)."""
    size = np.array(pictures.shape[1:])
    moved = visible[:, 0] & visible[:, n] & (np.abs(xy[:, n] - xy[:, 0]).max(axis=1) > _MOVED)
    places, change = (xy[moved][:, [0, n]] + 0.5) / size[::-1], []
    if len(places) < _ENOUGH:
        return
    for order in (places[..., ::-1], places):  # of brightness, as a share of that between other points
        (y0, y1), (x0, x1) = (order * size).clip(0, size - 1).astype(np.int64).T
        before, after = pictures[0, y0, x0], pictures[1, y1, x1]
        apart = np.abs(np.roll(after, len(after) // 2) - before).mean()
        change.append(np.abs(after - before).mean() / max(apart, 1e-9))
    if change[0] > 2 * max(change[1], _SAME):
        found, fix = "points that follow the video only as (y, x)", "give points[..., ::-1]"
        raise fields.error("points", "(x, y), x to the right", found, fix)
