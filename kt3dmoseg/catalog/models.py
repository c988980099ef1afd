"""What a catalog holds about a clip: its drive, its frame numbers, what its frames are recognised by."""

from __future__ import annotations

import datetime
import re
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.files import sha256_arrays
from kt3dmoseg.types import ByteArray

CAMERAS = (0, 1, 2, 3)
MOST_FRAMES = 100_000

_RUN = re.compile(r"(\d{1,10})(?:-(\d{1,10}))?")


@dataclass(frozen=True, order=True)
class Drive:
    """One recording of KITTI raw.

    Parameters
    ----------
    date : str
        Day of the recording, ``"2011_09_26"``.
    number : int or str
        Number of the drive on that day: 5, ``"5"`` and ``"0005"`` are the same.

    Raises
    ------
    InvalidValueError
        When either is not of that form.
    """

    date: str
    number: int

    def __post_init__(self) -> None:
        try:
            datetime.datetime.strptime(self.date if len(self.date) == 10 else "", "%Y_%m_%d")
        except (TypeError, ValueError):
            raise InvalidValueError("date", expected="the form 2011_09_26", found=repr(self.date)) from None
        object.__setattr__(self, "number", check_integer(self.number, "drive", 9999))

    @property
    def name(self) -> str:
        """For instance ``"2011_09_26_drive_0005"``."""
        return f"{self.date}_drive_{self.number:04d}"

    @property
    def folder(self) -> str:
        """Folder of the synchronised, rectified drive below a KITTI raw root."""
        return f"{self.date}/{self.name}_sync"

    def camera_folder(self, camera: int) -> str:
        """Folder of one camera below a KITTI raw root; holds ``timestamps.txt`` and ``data/``."""
        return f"{self.folder}/image_{check_camera(camera):02d}"


@dataclass(frozen=True)
class Fingerprint:
    """What one frame is recognised by: CRC32 and size of its PNG, SHA-256 of its pixels."""

    crc32: int
    bytes: int
    pixels: str

    def __post_init__(self) -> None:
        check_integer(self.crc32, "crc32", 0xFFFFFFFF)
        check_integer(self.bytes, "bytes", 1 << 40)
        check_text(self.pixels, "pixels", "[0-9a-f]{64}", "64 hexadecimal digits")


@dataclass(frozen=True)
class Entry:
    """One clip of a catalog.

    Parameters
    ----------
    name : str
        Letters, digits, ``_`` and ``-``.
    drive : Drive
        The drive that the clip is cut from.
    camera : int
        0 gray left, 1 gray right, 2 colour left, 3 colour right.
    length : int
        Number of frames.
    size : (W, H) or None
        Image size in pixels.
    numbers : tuple of int or None
        Ascending frame numbers in the drive, when known.
    frames : tuple of Fingerprint
        One per frame, in order; may be empty when `numbers` is given.
    proof, source : str
        How and where the numbers were found; empty when a person gave them.

    Raises
    ------
    InvalidValueError
        When a value makes no sense or lengths disagree.
    """

    name: str
    drive: Drive
    camera: int
    length: int
    size: tuple[int, int] | None = None
    numbers: tuple[int, ...] | None = None
    frames: tuple[Fingerprint, ...] = ()
    proof: str = ""
    source: str = ""

    def __post_init__(self) -> None:
        check_text(self.name, "name", "[A-Za-z0-9][A-Za-z0-9_-]{0,99}", "letters, digits, _ and -")
        object.__setattr__(self, "camera", check_camera(self.camera))
        if check_integer(self.length, "length", MOST_FRAMES) == 0:
            raise InvalidValueError("length", expected="at least 1", found="0")
        if self.size is not None:
            object.__setattr__(self, "size", _check_size(self.size))
        if self.numbers is None and not self.frames:
            raise InvalidValueError("numbers", expected="numbers or frames", found="neither")
        for key, values in (("numbers", self.numbers), ("frames", self.frames or None)):
            if values is not None and len(values) != self.length:
                raise InvalidValueError(key, expected=f"{self.length}, the length", found=f"{len(values)}")
        numbers = self.numbers or ()
        if any(b <= a for a, b in pairwise(numbers)):
            raise InvalidValueError("numbers", expected="ascending", found=format_numbers(numbers))


def fingerprint(content: bytes, pixels: ByteArray) -> Fingerprint:
    """Fingerprint a frame from its PNG file's bytes and its decoded pixels."""
    return Fingerprint(zlib.crc32(content), len(content), sha256_arrays(pixels))


def check_integer(value: object, what: str, last: int) -> int:
    """Return `value`, an integer or its digits, in 0..`last`; raise InvalidValueError for anything else."""
    digits = str(value)  # what True and 5.0 give are not digits
    if not re.fullmatch(r"[0-9]{1,13}", digits) or int(digits) > last:
        raise InvalidValueError(what, expected=f"a whole number from 0 to {last}", found=repr(value))
    return int(digits)


def check_camera(camera: int | str) -> int:
    """Return the camera's number, 0 to 3; raise InvalidValueError for anything else."""
    return check_integer(camera, "camera", CAMERAS[-1])


def parse_numbers(text: str) -> tuple[int, ...]:
    """Read ``"40-59, 80"`` as frame numbers, both ends included.

    Raises
    ------
    InvalidValueError
        When the text is not of that form or names more than 100,000 frames.
    """
    numbers: list[int] = []
    for part in str(text).split(","):
        match = _RUN.fullmatch(part.strip())
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (0, -1)
        if not first <= last < first + MOST_FRAMES:
            raise InvalidValueError("numbers", expected="the form 40-59 or 40-59,80", found=repr(text))
        numbers += range(first, last + 1)
    return tuple(numbers)


def format_numbers(numbers: Iterable[int]) -> str:
    """Write frame numbers as `parse_numbers` reads them: consecutive ones as ``first-last``."""
    runs: list[list[int]] = []
    for number in map(int, numbers):
        if runs and number == runs[-1][-1] + 1:
            runs[-1] = [runs[-1][0], number]
        else:
            runs.append([number])
    return ",".join("-".join(map(str, run)) for run in runs)


def check_text(value: object, what: str, pattern: str, expected: str) -> str:
    """Return `value`, a text of that form; raise InvalidValueError for anything else."""
    if not isinstance(value, str) or not re.fullmatch(pattern, value):
        raise InvalidValueError(what, expected=expected, found=repr(value))
    return value


def _check_size(size: Sequence[int]) -> tuple[int, int]:
    if not isinstance(size, (list, tuple)) or len(size) != 2:
        raise InvalidValueError("size", expected="[width, height]", found=repr(size))
    return check_integer(size[0], "width", 1 << 16), check_integer(size[1], "height", 1 << 16)
