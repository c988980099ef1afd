"""Pictures in sequence: written as PNGs, a video or an animation; a video read."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.files import atomic_path, write_bytes
from kt3dmoseg.io.images import quiet_opencv
from kt3dmoseg.types import ByteArray

_VIDEO = {".mp4": "mp4v", ".avi": "MJPG"}
_ANIMATION = {".gif": "GIF", ".apng": "PNG", ".webp": "WEBP"}
VIDEO_SUFFIXES = (".avi", ".mkv", ".mov", ".mp4", ".mpg", ".webm")
MOVING_SUFFIXES = (*_VIDEO, *_ANIMATION)
# FFmpeg's AV_LOG_QUIET, which OpenCV reads once: a damaged video is reported in one line of ours.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


@contextmanager
def open_video(path: str | os.PathLike[str]) -> Iterator[cv2.VideoCapture]:
    """Open a video for reading; its ``isOpened`` reports whether that worked."""
    with quiet_opencv():
        # OpenCV's other readers write to standard error what they do not understand.
        video = cv2.VideoCapture(os.fspath(path), cv2.CAP_FFMPEG)
    try:
        yield video
    finally:
        video.release()


def write_png(path: str | os.PathLike[str], picture: ByteArray) -> None:
    """Write one (H, W, 3) RGB or (H, W) gray picture atomically."""
    stored = picture[..., ::-1] if picture.ndim == 3 else picture
    write_bytes(path, bytes(cv2.imencode(".png", np.ascontiguousarray(stored))[1]))


def write_moving(path: str | os.PathLike[str], pictures: Iterable[ByteArray], rate: float) -> None:
    """Write (H, W, 3) RGB pictures of one size as a video or animation, by the path's suffix.

    Videos are ``.mp4`` and ``.avi`` (one picture in memory at a time; of an odd height or width the last row
    or column is repeated, as the codecs need even sizes), animations ``.gif``, ``.apng`` and ``.webp``.
    `rate` is in pictures per second. InvalidValueError for another suffix, InputFileError when the file
    cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix in _VIDEO:
        _write_video(path, pictures, rate, suffix)
    elif suffix in _ANIMATION:
        images, buffer = [Image.fromarray(picture) for picture in pictures], io.BytesIO()
        if not images:
            raise InputFileError(f"{os.fspath(path)}: there are no pictures to write")
        options = {"duration": round(1000 / rate), "loop": 0, "lossless": True}
        images[0].save(buffer, _ANIMATION[suffix], save_all=True, append_images=images[1:], **options)
        write_bytes(path, buffer.getvalue())
    else:
        known = ", ".join(MOVING_SUFFIXES)
        raise InvalidValueError(os.fspath(path), expected=f"a suffix of {known}", found=repr(suffix))


def _write_video(
    path: str | os.PathLike[str], pictures: Iterable[ByteArray], rate: float, suffix: str
) -> None:
    with atomic_path(path) as temporary, quiet_opencv():
        named = temporary.with_name(temporary.name + suffix)  # OpenCV goes by the name
        try:
            count = _encode(named, pictures, rate, os.fspath(path))
            with open_video(named) as video:  # read back: OpenCV does not report a full disk
                found = sum(1 for _ in iter(video.grab, False))
            if found < count:
                found_text = f"{found} of {count} pictures"
                raise InputFileError(f"{path}: cannot write", found=found_text, fix="is the disk full?")
            os.replace(named, temporary)
        finally:
            named.unlink(missing_ok=True)


def _encode(named: Path, pictures: Iterable[ByteArray], rate: float, where: str) -> int:
    writer, count = None, 0
    for picture in pictures:
        # The last row or column of an odd size is repeated: these codecs would drop it (4:2:0 chroma).
        height, width = picture.shape[:2]
        even = np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        if writer is None:
            code = cv2.VideoWriter.fourcc(*_VIDEO[named.suffix])
            writer = cv2.VideoWriter(os.fspath(named), code, rate, even.shape[1::-1])
            if not writer.isOpened():
                raise InputFileError(f"{where}: OpenCV cannot write this video", fix="try .avi")
        writer.write(np.ascontiguousarray(even[..., ::-1]))
        count += 1
    if writer is not None:
        writer.release()
    return count
