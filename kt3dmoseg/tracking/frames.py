"""Frames of a clip, one at a time, from whatever holds them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sized
from pathlib import Path
from typing import TypeAlias

import numpy as np

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.io.images import frame_paths, read_frame
from kt3dmoseg.types import ByteArray

FrameSource: TypeAlias = "str | os.PathLike[str] | Iterable[ByteArray | str | os.PathLike[str]]"


def open_frames(frames: FrameSource) -> tuple[Iterator[ByteArray], int | None]:
    """Give gray frames one after the other, never more than one in memory.

    Parameters
    ----------
    frames : path-like, or iterable of arrays or of path-likes
        A folder of images; or gray frames (H, W) uint8, or the paths of images, in order.

    Returns
    -------
    stream : iterator of (H, W) uint8
        The frames; raises `InvalidValueError` at the first that is no gray frame or differs in size.
    total : int or None
        How many there are; None for an iterator that cannot tell.

    Raises
    ------
    InputFileError, FileFormatError
        For a folder or image that cannot be read.
    """
    items = frame_paths(Path(frames)) if isinstance(frames, (str, os.PathLike)) else frames
    total = len(items) if isinstance(items, Sized) else None
    return _checked(items), total


def _checked(items: Iterable[ByteArray | str | os.PathLike[str]]) -> Iterator[ByteArray]:
    first: tuple[int, ...] | None = None
    for number, item in enumerate(items):
        name, frame = f"frame {number}", item
        if isinstance(frame, (str, os.PathLike)):
            name, frame = os.fspath(frame), read_frame(Path(frame))
        if not isinstance(frame, np.ndarray) or frame.ndim != 2 or frame.dtype != np.uint8:
            found = f"{getattr(frame, 'dtype', type(frame).__name__)} of shape {np.shape(frame)}"
            raise InvalidValueError(name, expected="a gray frame, (H, W) uint8", found=found)
        first = first or frame.shape
        if frame.shape != first:
            raise InvalidValueError(
                name,
                expected=f"{first[1]}x{first[0]} pixels like the first frame",
                found=f"{frame.shape[1]}x{frame.shape[0]}",
                fix="give frames of one size",
            )
        yield frame
