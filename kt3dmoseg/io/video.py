"""Pictures in sequence: written as PNGs, a video or an animation; a video read."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from kt3dmoseg.errors import InputFileError, InvalidValueError, MissingDependencyError
from kt3dmoseg.files import atomic_path, write_bytes
from kt3dmoseg.io.images import quiet_opencv
from kt3dmoseg.types import ByteArray

_VIDEO = {".mp4": "mp4v", ".avi": "MJPG"}
_ANIMATION = (".gif", ".apng", ".webp")
VIDEO_SUFFIXES = (".avi", ".mkv", ".mov", ".mp4", ".mpg", ".webm")
MOVING_SUFFIXES = (*_VIDEO, *_ANIMATION)
# FFmpeg's AV_LOG_QUIET, which OpenCV reads once: a damaged video is our one line to tell.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


@contextmanager
def open_video(path: str | os.PathLike[str]) -> Iterator[cv2.VideoCapture]:
    """Open a video for reading; whether that worked, its ``isOpened`` tells."""
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

    A video of an odd height or width has its last row or column twice: the codecs need even sizes.

    Parameters
    ----------
    path : path
        ``.mp4``, ``.avi`` (one picture in memory at a time), ``.gif``, ``.apng`` or ``.webp``.
    pictures : iterable of (H, W, 3) uint8
        RGB.
    rate : float
        Pictures per second.

    Raises
    ------
    InvalidValueError
        For another suffix.
    InputFileError
        When the file cannot be written.
    MissingDependencyError
        When this OpenCV cannot write animations (before 4.12).
    """
    suffix = Path(path).suffix.lower()
    if suffix in _VIDEO:
        _write_video(path, pictures, rate, suffix)
    elif suffix in _ANIMATION:
        _write_animation(path, pictures, rate, suffix)
    else:
        known = ", ".join(MOVING_SUFFIXES)
        raise InvalidValueError(os.fspath(path), expected=f"a suffix of {known}", found=repr(suffix))


def _write_video(
    path: str | os.PathLike[str], pictures: Iterable[ByteArray], rate: float, suffix: str
) -> None:
    with _named(path, suffix) as temporary, quiet_opencv():
        writer, count = None, 0
        for picture in map(_even, pictures):
            if writer is None:
                size = picture.shape[1], picture.shape[0]
                writer = cv2.VideoWriter(os.fspath(temporary), _four_letters(_VIDEO[suffix]), rate, size)
                if not writer.isOpened():
                    raise InputFileError(f"{os.fspath(path)}: OpenCV cannot write this video", fix="try .avi")
            writer.write(np.ascontiguousarray(picture[..., ::-1]))
            count += 1
        if writer is not None:
            writer.release()
        _check_video(temporary, count, path)


def _even(picture: ByteArray) -> ByteArray:
    """Repeat the last row or column of an odd size: these codecs would drop it (4:2:0 chroma)."""
    height, width = picture.shape[:2]
    return np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def _check_video(written: Path, count: int, path: str | os.PathLike[str]) -> None:
    """Read a video back: OpenCV does not tell when the disk is full."""
    found = 0
    with open_video(written) as video:
        while video.grab():
            found += 1
    if found < count:
        raise InputFileError(
            f"{os.fspath(path)}: cannot write", found=f"{found} of {count} pictures", fix="is the disk full?"
        )


def _write_animation(
    path: str | os.PathLike[str], pictures: Iterable[ByteArray], rate: float, suffix: str
) -> None:
    if not hasattr(cv2, "imencodeanimation"):
        raise MissingDependencyError(
            f"{os.fspath(path)}: this OpenCV writes no animations",
            found=f"opencv {cv2.__version__}",
            fix="install opencv-python-headless>=4.12, or write .mp4",
        )
    animation = cv2.Animation()
    animation.frames = [np.ascontiguousarray(picture[..., ::-1]) for picture in pictures]
    animation.durations = [round(1000 / rate)] * len(animation.frames)
    with quiet_opencv():
        encoded, content = cv2.imencodeanimation(".png" if suffix == ".apng" else suffix, animation)
    if not encoded:
        raise InputFileError(f"{os.fspath(path)}: OpenCV cannot write it", fix="write .mp4")
    write_bytes(path, content.tobytes())


@contextmanager
def _named(path: str | os.PathLike[str], suffix: str) -> Iterator[Path]:
    """Give an atomic temporary path that ends in `suffix`: OpenCV's encoders go by the name."""
    with atomic_path(path) as temporary:
        named = temporary.with_name(temporary.name + suffix)
        try:
            yield named
            os.replace(named, temporary)
        finally:
            named.unlink(missing_ok=True)


def _four_letters(code: str) -> int:
    return int.from_bytes(code.encode(), "little")
