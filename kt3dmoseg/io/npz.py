"""NumPy files: arrays read without pickles and without trusting a size; clips and point tracks in .npz.

docs/formats.md lists the arrays of a clip, for those who have no HDF5. CoTracker: `pred_tracks`
(1, F, N, 2) pixels with integers at pixel centres, `pred_visibility` (1, F, N) or (1, F, N, 1). TAP-Vid:
`points` (N, F, 2) as fractions of width and height from the outer corner of the image, `occluded` (N, F),
and `video` (F, H, W, C), (F, C, H, W) or (F, H, W), of which only the size is read.
"""

from __future__ import annotations

import io
import math
import os
from collections.abc import Container, Mapping
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.files import SafeZip, ZipLimits, read_bytes, write_bytes, zip_bytes
from kt3dmoseg.io.fields import Fields, clip_from, clip_of_tracks, clip_values
from kt3dmoseg.types import BoolArray, Clip, Trajectories

# Kind and shape of the arrays of a clip, those that it may lack, and its texts.
_ARRAYS: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "xy": ("f", (None, None, None)),
    "visible": ("b", (None, None)),
    "track_id": ("iu", (None,)),
    "evaluated": ("iu", (None,)),
    "label": ("iu", (None,)),
    "frame_numbers": ("iu", (None,)),
    "image_size": ("iu", (2,)),
    "background": ("iu", ()),
    "timestamps": ("f", (None,)),
    "K": ("f", (3, 3)),
}
_OPTIONAL = {"image_size", "background", "timestamps", "K"}
_TEXTS = ("label_names", "camera_name", "provenance")
KEYS = {"name", *_ARRAYS} - _OPTIONAL
COTRACKER_KEYS = {"pred_tracks", "pred_visibility"}
TAPVID_KEYS = {"points", "occluded", "video"}
_CHANNELS = (1, 3, 4)
_OUTSIDE = 0.05  # a tracker may follow a point a little over the border
_FRACTION = 1.5  # a clip whose every coordinate is smaller is not in pixels
_FREE = 1 << 24
# A video of TAP-Vid may be large; it is not read.
_LIMITS = ZipLimits(256, 1 << 32, 1 << 40, ratio=1100, free_bytes=_FREE)
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
_MAX_HEADER = 10_000


def read_npy(path: str | os.PathLike[str]) -> npt.NDArray[Any]:
    """Read a .npy file of numbers or texts; raises as `read_npz`."""
    content = read_bytes(path, _LIMITS.file_bytes)
    return read_array(io.BytesIO(content), len(content), os.fspath(path))


def read_npz(
    path: str | os.PathLike[str], names: Container[str] | None = None
) -> dict[str, npt.NDArray[Any]]:
    """Read the arrays of a .npz file; of `names`, when given, those that are there.

    FileFormatError when it is damaged, holds Python objects, or declares a wrong size.
    """
    where = os.fspath(path)
    with SafeZip(path, _LIMITS, where, lambda file: names is None or _name(file) in names) as archive:
        out = {}
        for file, size in archive.sizes.items():
            with archive.open(file) as stream:
                out[_name(file)] = read_array(stream, size, f"{where}: {_name(file)}")
        return out


def npz_shapes(path: str | os.PathLike[str]) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the arrays of a .npz file; only their headers are read."""
    where, out = os.fspath(path), {}
    with SafeZip(path, _LIMITS, where) as archive:
        for file in archive.sizes:
            with archive.open(file) as stream:
                out[_name(file)] = _header(stream, f"{where}: {_name(file)}")[0]
    return out


def write_npz(path: str | os.PathLike[str], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
    """Write a compressed .npz atomically; equal arrays give equal bytes."""
    write_bytes(path, zip_bytes({f"{name}.npy": npy_bytes(np.asarray(a)) for name, a in arrays.items()}))


def npy_bytes(array: npt.NDArray[Any]) -> bytes:
    """Return the content of a .npy file."""
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def read_array(stream: IO[bytes], size: int, where: str) -> npt.NDArray[Any]:
    """Read one array in the npy format from a stream of at most `size` bytes; raises as `read_npy`."""
    shape, fortran, dtype = _header(stream, where)
    needed = math.prod(shape) * dtype.itemsize
    content = stream.read(needed) if needed <= size else b""
    if len(content) != needed:
        found = f"{len(content)}" if needed <= size else f"at most {size}"
        raise FileFormatError(where, expected=f"{needed} bytes for {shape}", found=found)
    return np.frombuffer(content, dtype).reshape(shape, order="F" if fortran else "C").copy()


def _header(stream: IO[bytes], where: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
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
    return shape, fortran, dtype


def _name(file: str) -> str:
    return file.removesuffix(".npy")


def write(clip: Clip, path: str | os.PathLike[str]) -> None:
    """Write a clip; the same clip gives the same bytes."""
    first = {"name": clip.name, "xy": clip.dense.xy, "visible": clip.dense.visible}
    write_npz(path, {name: np.asarray(value) for name, value in (first | clip_values(clip)).items()})


def read(path: str | os.PathLike[str]) -> Clip:
    """Read a clip, the output of CoTracker or a video of TAP-Vid; see `kt3dmoseg.io.load` for the errors."""
    shapes = npz_shapes(path)
    if set(shapes) >= COTRACKER_KEYS:
        return _cotracker(path)
    if set(shapes) >= TAPVID_KEYS:
        return _tapvid(path, shapes["video"])
    if set(shapes) >= KEYS:
        return _clip(path)
    raise FileFormatError(
        os.fspath(path),
        expected=f"the arrays {', '.join(sorted(KEYS))} of a clip",
        found=", ".join(sorted(shapes)) or "none",
        fix="the arrays of CoTracker and of TAP-Vid (points, occluded, video) are read too",
    )


def _clip(path: str | os.PathLike[str]) -> Clip:
    prefix = f"{os.fspath(path)}: "
    fields = Fields(prefix, read_npz(path))
    arrays = {
        name: fields.array(name, shape, kinds)
        for name, (kinds, shape) in _ARRAYS.items()
        if name not in _OPTIONAL or name in fields
    }
    texts = {name: fields.text(name) for name in ("name", *(name for name in _TEXTS if name in fields))}
    return clip_from(arrays | texts, prefix)


def _cotracker(path: str | os.PathLike[str]) -> Clip:
    fields = Fields(f"{os.fspath(path)}: ", read_npz(path, COTRACKER_KEYS))
    tracks = fields.array("pred_tracks", (1, None, None, 2))
    seen = fields.array("pred_visibility")
    if seen.shape not in (tracks.shape[:3], (*tracks.shape[:3], 1)):
        raise fields.error("pred_visibility", f"shape {tracks.shape[:3]}", f"{seen.shape}")
    if not ((seen >= 0) & (seen <= 1)).all():
        raise fields.error("pred_visibility", "0 to 1", f"{seen.min():g} to {seen.max():g}")
    visible = seen.reshape(tracks.shape[1:3]).T > 0.5
    xy = np.swapaxes(tracks[0], 0, 1)
    if visible.any() and (farthest := np.abs(xy[visible]).max()) <= _FRACTION:
        fix = "multiply fractions by width and height, and subtract 0.5"
        raise fields.error("pred_tracks", "pixels", f"at most {farthest:g}", fix)
    return _tracks(path, "cotracker", xy, visible)


def _tapvid(path: str | os.PathLike[str], video: tuple[int, ...]) -> Clip:
    fields = Fields(f"{os.fspath(path)}: ", read_npz(path, TAPVID_KEYS - {"video"}))
    points = fields.array("points", (None, None, 2))
    occluded = fields.array("occluded", points.shape[:2])
    if len(video) not in (3, 4) or video[0] != points.shape[1]:
        fix = "swap tracks and frames of points and occluded" if video[:1] == points.shape[:1] else ""
        expected = f"{points.shape[1]} frames (F, H, W, C), as points (N, F, 2) have"
        raise fields.error("video", expected, f"video of shape {video}, points {points.shape}", fix)
    if len(video) == 4 and not {video[1], video[3]} & {*_CHANNELS}:
        raise fields.error("video", "1, 3 or 4 channels, (F, H, W, C) or (F, C, H, W)", f"shape {video}")
    channels_first = len(video) == 4 and video[3] not in _CHANNELS
    height, width = video[2:4] if channels_first else video[1:3]
    if not np.isin(occluded, (0, 1)).all():
        raise fields.error("occluded", "0 or 1", f"{occluded.min():g} to {occluded.max():g}")
    seen = points[occluded == 0]
    low, high = (seen.min(), seen.max()) if seen.size else (0, 0)
    if low < -_OUTSIDE or high > 1 + _OUTSIDE:
        fix = "of pixels, add 0.5 and divide by width and height"
        raise fields.error("points", "fractions of width and height, 0 to 1", f"{low:g} to {high:g}", fix)
    pixels = points.astype(np.float64) * (width, height) - 0.5
    return _tracks(path, "tap-vid", pixels, occluded == 0, (width, height))


def _tracks(
    path: str | os.PathLike[str],
    format: str,
    xy: npt.NDArray[Any],
    visible: BoolArray,
    size: tuple[int, int] | None = None,
) -> Clip:
    positions = np.where(visible[..., None], xy.astype(np.float64), np.nan)
    return clip_of_tracks(path, format, Trajectories(positions, visible, image_size=size))
