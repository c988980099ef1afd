"""Frames on disk: numbered pictures of one folder, read as 8-bit gray."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.io import jpeg, png
from kt3dmoseg.types import ByteArray

Colour: TypeAlias = Literal["refuse", "luma"]

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".tif", ".tiff", ".webp")
_NUMBER = re.compile(r"(\d{1,18})\D*$")
_MAX_FILE = 1 << 28
_MIN_FRAMES = 2
_SILENT = 0  # OpenCV's LOG_LEVEL_SILENT


def frame_paths(folder: str | os.PathLike[str]) -> list[Path]:
    """List the frames of a folder in the order of their numbers.

    Parameters
    ----------
    folder : path
        Holds two or more pictures whose names end in consecutive numbers, for instance
        ``000001.png`` or ``0000000107.png``.

    Raises
    ------
    InputFileError
        When the folder is missing, empty or holds a single frame.
    FileFormatError
        When a name has no number, a number is missing or given twice.
    """
    root = Path(folder)
    if not root.is_dir():
        found = "a file" if root.exists() else "no such folder"
        raise InputFileError(f"{root}", expected="a folder of frames", found=found)
    pictures = numbered_pictures(root)
    if len(pictures) < _MIN_FRAMES:
        raise InputFileError(
            f"{root}",
            expected="at least two numbered frames (000001.png, 000002.png, ...)",
            found=f"only {next(iter(pictures.values())).name}" if pictures else "no pictures",
            fix="give the folder that holds the frames of one clip",
        )
    _check_consecutive(root, list(pictures))
    return list(pictures.values())


def has_pictures(folder: Path) -> bool:
    """Whether a path is a folder with pictures in it."""
    return folder.is_dir() and any(entry.suffix.lower() in IMAGE_SUFFIXES for entry in folder.iterdir())


def numbered_pictures(folder: Path) -> dict[int, Path]:
    """Return the pictures of a folder by number, in order; there may be gaps.

    Raises
    ------
    FileFormatError
        When a name has no number, or a number is given twice.
    """
    out: dict[int, Path] = {}
    for file in sorted(folder.iterdir()):
        if file.suffix.lower() not in IMAGE_SUFFIXES or not file.is_file():
            continue
        number = frame_number(file)
        if number in out:
            raise FileFormatError(
                f"{folder}: frame {number}",
                expected="one file",
                found=f"{out[number].name} and {file.name}",
                fix="keep one of them",
            )
        out[number] = file
    return dict(sorted(out.items()))


def frame_number(path: str | os.PathLike[str]) -> int:
    """Return the last number in a frame's file name."""
    found = _NUMBER.search(Path(path).stem)
    if not found:
        raise FileFormatError(
            os.fspath(path),
            expected="a name that ends in the frame's number, as 000001.png",
            found=Path(path).name,
            fix="rename or remove the file",
        )
    return int(found.group(1))


def read_frame(path: str | os.PathLike[str], colour: Colour = "refuse") -> ByteArray:
    """Read one frame as 8-bit gray.

    Parameters
    ----------
    path : path
        The picture.
    colour : {"refuse", "luma"}
        What to do with a picture whose channels differ: refuse it, or take its luma
        0.299 R + 0.587 G + 0.114 B (ITU-R BT.601).

    Returns
    -------
    (H, W) uint8

    Raises
    ------
    InputFileError
        When the file cannot be read.
    FileFormatError
        When it is damaged, 16-bit, or in colour while `colour` is "refuse".
    """
    where = os.fspath(path)
    return gray(decode(read_bytes(path, _MAX_FILE), where), where, colour)


def read_frames(paths: Iterable[str | os.PathLike[str]], colour: Colour = "refuse") -> Iterator[ByteArray]:
    """Read frames one after the other, all of one size; see `read_frame`.

    Raises
    ------
    FileFormatError
        Also for a frame of another size than the first.
    """
    first: tuple[str, tuple[int, ...]] | None = None
    for path in paths:
        frame = read_frame(path, colour)
        name, shape = first = first or (Path(path).name, frame.shape)
        if frame.shape != shape:
            raise FileFormatError(
                os.fspath(path),
                expected=f"{shape[1]}x{shape[0]} px, as {name}",
                found=f"{frame.shape[1]}x{frame.shape[0]}",
                fix="give frames of one size",
            )
        yield frame


def decode(content: bytes, where: str) -> npt.NDArray[Any]:
    """Decode a picture as it is stored: (H, W) or (H, W, C), in OpenCV's BGR order."""
    picture = None
    if png.is_png(content):
        content = png.sound(content, where)
    jpeg.check(content, where)
    if content:
        with quiet_opencv(), jpeg.watched(content, where), suppress(cv2.error):
            picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None:
        found = f"{len(content)} bytes that are not" if content else "an empty file"
        raise FileFormatError(
            where, expected="a picture", found=found, fix="the file is damaged; fetch it again"
        )
    return np.asarray(picture)


@contextmanager
def quiet_opencv() -> Iterator[None]:
    """Keep OpenCV from writing to standard error: a damaged file is our one line to tell."""
    logging = getattr(cv2.utils, "logging", cv2)  # where it lies depends on OpenCV's release
    level = logging.setLogLevel(_SILENT)
    try:
        yield
    finally:
        logging.setLogLevel(level)


def gray(picture: npt.NDArray[Any], where: str, colour: Colour = "refuse") -> ByteArray:
    """Return (H, W) uint8 from a decoded picture; see `read_frame`."""
    if picture.dtype != np.uint8:
        raise FileFormatError(
            where,
            expected="an 8-bit picture",
            found=f"{8 * picture.dtype.itemsize} bits per channel",
            fix="convert it to 8-bit gray first, with one scale for the whole clip",
        )
    if picture.ndim == 2:
        return picture
    channels = picture[..., :3] if picture.shape[2] >= 3 else picture[..., :1]
    if (channels == channels[..., :1]).all():
        return np.ascontiguousarray(channels[..., 0])
    if colour == "refuse":
        raise FileFormatError(
            where,
            expected="a gray picture",
            found="colour",
            fix="convert it to gray, or ask for its luma with --colour luma (colour='luma')",
        )
    return np.asarray(cv2.cvtColor(channels, cv2.COLOR_BGR2GRAY))


def _check_consecutive(root: Path, numbers: Sequence[int]) -> None:
    for before, after in pairwise(numbers):
        if after != before + 1:
            raise FileFormatError(
                f"{root}: frame {before + 1}",
                expected=f"frames numbered {numbers[0]} to {numbers[-1]} without a gap",
                found=f"{before} followed by {after}",
                fix="add the missing frames, or split the folder at the gap",
            )
