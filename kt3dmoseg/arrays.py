"""Arrays that the central types hold: read-only, of one type, checked in little memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError

_BLOCK = 1 << 20
_MAX_SIDE = 1 << 20
_MAX_INT = np.iinfo(np.int64).max


def frozen(values: npt.ArrayLike, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Return a read-only array of `dtype`, copied unless it is one already; refuse what would wrap around."""
    given = np.asarray(values)
    if dtype == np.int64 and given.dtype == np.uint64 and given.size and given.max() > _MAX_INT:
        raise InvalidValueError("whole numbers", expected=f"at most {_MAX_INT}", found=brief(given))
    same = given.dtype == dtype and not given.flags.writeable and given.base is None
    array = given if same else np.array(given, dtype=dtype, order="C")
    array.flags.writeable = False
    return array


def per_frame(values: npt.ArrayLike, dtype: npt.DTypeLike, frames: int, name: str) -> npt.NDArray[Any]:
    """Return a read-only array (F,); refuse another shape."""
    array = frozen(values, dtype)
    if array.shape != (frames,):
        raise InvalidValueError(name, expected=f"shape ({frames},)", found=f"{array.shape}")
    return array


def image_size(size: npt.ArrayLike) -> tuple[int, int]:
    """Return width and height of frames as whole numbers; refuse what is none."""
    values = np.asarray(size)
    fine = values.shape == (2,) and values.dtype.kind in "iuf"
    if not fine or not ((values >= 1) & (values <= _MAX_SIDE) & (values == np.floor(values))).all():
        raise InvalidValueError(
            "image_size", expected=f"(width, height), 1..{_MAX_SIDE}", found=f"{size!r:.80}"
        )
    return int(values[0]), int(values[1])


def check_presence(xy: npt.NDArray[np.float64], visible: npt.NDArray[np.bool_]) -> None:
    """Refuse positions (N, F, 2) that are not finite exactly where visible (N, F), and NaN elsewhere."""
    rows = max(1, _BLOCK // max(1, xy.shape[1]))  # by blocks: a long clip leaves no room for masks of it all
    for first in range(0, len(xy), rows):
        part, seen = xy[first : first + rows], visible[first : first + rows]
        wrong = np.where(seen, ~np.isfinite(part).all(axis=2), ~np.isnan(part).all(axis=2))
        if wrong.any():
            row, frame = np.argwhere(wrong)[0]
            raise InvalidValueError(
                f"xy of trajectory {first + row} in frame {frame}",
                expected="finite" if seen[row, frame] else "NaN (not visible)",
                found=str(part[row, frame].tolist()),
            )


def brief(array: npt.NDArray[Any]) -> str:
    """Describe an array in a few words."""
    if not array.size:
        return f"{array.dtype} of shape {array.shape}"
    return f"{array.dtype} of shape {array.shape}, values {array.min()}..{array.max()}"
