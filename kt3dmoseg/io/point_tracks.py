"""Point tracks of learned trackers in .npz: CoTracker's and TAP-Vid's arrays.

CoTracker: `pred_tracks` (1, F, N, 2) pixels with integers at pixel centres, `pred_visibility`
(1, F, N) or (1, F, N, 1). TAP-Vid: `points` (N, F, 2) as fractions of width and height from the outer
corner of the image, `occluded` (N, F), and `video` (F, H, W, C), of which only the size is read.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.files import sha256_file
from kt3dmoseg.io.npy import npz_shapes, read_npz
from kt3dmoseg.io.text import clip_name
from kt3dmoseg.types import BoolArray, Clip, FloatArray, Labels, Trajectories

COTRACKER_KEYS = {"pred_tracks", "pred_visibility"}
TAPVID_KEYS = {"points", "occluded", "video"}


def read_cotracker(path: str | os.PathLike[str]) -> Clip:
    """Read CoTracker's output for one video."""
    arrays = _numbers(path, COTRACKER_KEYS)
    tracks = arrays["pred_tracks"]
    if tracks.ndim != 4 or tracks.shape[0] != 1 or tracks.shape[3] != 2:
        raise _wrong(path, "pred_tracks", "shape (1, F, N, 2)", tracks)
    seen = arrays["pred_visibility"]
    if seen.shape not in (tracks.shape[:3], (*tracks.shape[:3], 1)):
        raise _wrong(path, "pred_visibility", f"shape {tracks.shape[:3]}", seen)
    visible = seen.reshape(tracks.shape[1:3]).T > 0.5
    return _clip(path, "cotracker", np.swapaxes(tracks[0], 0, 1), visible, None)


def read_tapvid(path: str | os.PathLike[str]) -> Clip:
    """Read a video of TAP-Vid."""
    video = npz_shapes(path)["video"]
    arrays = _numbers(path, {"points", "occluded"})
    points, occluded = arrays["points"], arrays["occluded"]
    if points.ndim != 3 or points.shape[2] != 2:
        raise _wrong(path, "points", "shape (N, F, 2)", points)
    if occluded.shape != points.shape[:2]:
        raise _wrong(path, "occluded", f"shape {points.shape[:2]}", occluded)
    if len(video) != 4 or video[0] != points.shape[1]:
        found = f"video of shape {video}"
        raise FileFormatError(
            f"{os.fspath(path)}: video", expected=f"{points.shape[1]} frames, (F, H, W, C)", found=found
        )
    height, width = video[1:3]
    pixels = points.astype(np.float64) * (width, height) - 0.5
    return _clip(path, "tap-vid", pixels, occluded == 0, (width, height))


def _numbers(path: str | os.PathLike[str], names: set[str]) -> dict[str, npt.NDArray[Any]]:
    arrays = read_npz(path, names)
    for name, array in arrays.items():
        if array.dtype.kind not in "buif":
            place = f"{os.fspath(path)}: {name}"
            raise FileFormatError(place, expected="numbers", found=f"{array.dtype}")
    return arrays


def _clip(
    path: str | os.PathLike[str],
    format: str,
    xy: npt.NDArray[Any],
    visible: BoolArray,
    image_size: tuple[int, int] | None,
) -> Clip:
    place: FloatArray = np.where(visible[..., None], xy.astype(np.float64), np.nan)
    n = len(place)
    return Clip(
        name=clip_name(path),
        dense=Trajectories(place, visible, image_size=image_size),
        evaluated=np.arange(n),
        labels=Labels(np.zeros(n, dtype=np.int64)),
        provenance={
            "format": format,
            "source": os.path.basename(path),  # noqa: PTH119  # a path in, a str out
            "sha256": sha256_file(path),
        },
    )


def _wrong(
    path: str | os.PathLike[str], name: str, expected: str, array: npt.NDArray[Any]
) -> FileFormatError:
    return FileFormatError(f"{os.fspath(path)}: {name}", expected=expected, found=f"{array.shape}")
