"""The catalog: which frames of which KITTI raw drive a clip is made of.

The 22 clips of KT3DMoSeg are in ``catalog.toml`` next to this file. Users add their own in files of the
same form::

    [clips.MyClip]
    date = "2011_09_26"
    drive = 5
    camera = 0
    length = 20
    numbers = "40-59"               # frame numbers in the drive, when known
    size = [1242, 375]              # optional: width and height in pixels
    frames = [                      # optional with numbers: what the frames are recognised by
      { crc32 = "89abcdef", bytes = 294096, pixels = "0123..." },   # one line per frame
    ]

``crc32`` and ``bytes`` are those of the PNG file, ``pixels`` is `kt3dmoseg.files.sha256_arrays` of the
decoded image, (H, W) uint8 gray or (H, W, 3) uint8 RGB.
"""

from __future__ import annotations

import datetime
import json
import os
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from kt3dmoseg.errors import FileFormatError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import check_target, parse_toml, read_bytes, sha256_arrays, write_text
from kt3dmoseg.registry import unknown_name
from kt3dmoseg.types import ByteArray

BUILT_IN = Path(__file__).with_name("catalog.toml")
CAMERAS = (0, 1, 2, 3)
MOST_FRAMES = 100_000

_LARGEST = 4 << 20
_REQUIRED = ("date", "drive", "camera", "length")
_KEYS = (*_REQUIRED, "size", "numbers", "frames", "proof", "source")


@dataclass(frozen=True, order=True)
class Drive:
    """One recording of KITTI raw.

    Parameters
    ----------
    date : str
        Day of the recording, ``"2011_09_26"``.
    number : int or str
        Number of the drive on that day: 5, ``"5"`` and ``"0005"`` are the same.

    InvalidValueError is raised when either is not of that form.
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
        return f"{self.folder}/image_{camera:02d}"


@dataclass(frozen=True)
class Fingerprint:
    """What one frame is recognised by: CRC32 and size of its PNG, SHA-256 of its pixels."""

    crc32: int
    bytes: int
    pixels: str

    def __post_init__(self) -> None:
        check_integer(self.crc32, "crc32", 0xFFFFFFFF)
        check_integer(self.bytes, "bytes", 1 << 40)
        _check_text(self.pixels, "pixels", "[0-9a-f]{64}", "64 hexadecimal digits")


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

    InvalidValueError is raised when a value makes no sense or lengths disagree.
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
        _check_text(self.name, "name", "[A-Za-z0-9][A-Za-z0-9_-]{0,99}", "letters, digits, _ and -")
        object.__setattr__(self, "camera", check_integer(self.camera, "camera", CAMERAS[-1]))
        if not isinstance(self.size, (list, tuple, type(None))) or len(self.size or (0, 0)) != 2:
            raise InvalidValueError("size", expected="[width, height]", found=repr(self.size))
        if self.size is not None:
            object.__setattr__(self, "size", tuple(check_integer(s, "size", 1 << 16) for s in self.size))
        if self.numbers is None and not self.frames:
            raise InvalidValueError("numbers", expected="numbers or frames", found="neither")
        if check_integer(self.length, "length", MOST_FRAMES) == 0:
            raise InvalidValueError("length", expected="at least 1", found="0")
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


def parse_numbers(text: str) -> tuple[int, ...]:
    """Read ``"40-59, 80"`` as frame numbers, both ends included.

    InvalidValueError when the text is not of that form or names more than 100,000 frames.
    """
    numbers: list[int] = []
    for part in str(text).split(","):
        match = re.fullmatch(r"(\d{1,10})(?:-(\d{1,10}))?", part.strip())
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


def _check_text(value: object, what: str, pattern: str, expected: str) -> str:
    """Return `value`, a text of that form; raise InvalidValueError for anything else."""
    if not isinstance(value, str) or not re.fullmatch(pattern, value):
        raise InvalidValueError(what, expected=expected, found=repr(value))
    return value


def load(*paths: str | os.PathLike[str], built_in: bool = True) -> dict[str, Entry]:
    """Read the built-in catalog and the users' catalogs: clips by name, each in one of them only.

    InputFileError or FileFormatError when a file is missing or not a catalog; the message gives the first
    problem.
    """
    clips: dict[str, Entry] = {}
    for path, found, problems in parse_all(([BUILT_IN] if built_in else []) + [Path(p) for p in paths]):
        if problems:
            more = f"{len(problems) - 1} more: " if len(problems) > 1 else ""
            raise FileFormatError(
                f"{path}: {problems[0]}", fix=f"{more}'kt3dmoseg catalog check' lists all problems"
            )
        clips |= found
    return clips


def parse_all(paths: Iterable[Path]) -> Iterator[tuple[Path, dict[str, Entry], list[str]]]:
    """Read catalogs: of each the path, its valid clips and every problem, names that are taken as well."""
    taken: set[str] = set()
    for path in paths:
        clips, problems = parse(path)
        problems += [f"clips.{name}: the name is taken by another catalog" for name in clips if name in taken]
        taken |= clips.keys()
        yield path, clips, problems


def select(clips: Mapping[str, Entry], names: Iterable[str] = ()) -> list[Entry]:
    """Return the clips of these names, all when none is given; UnknownNameError, with the nearest name."""
    wanted = list(dict.fromkeys(names)) or list(clips)
    for name in wanted:
        if name not in clips:
            raise unknown_name("clip", name, clips)
    return [clips[name] for name in wanted]


def parse(path: str | os.PathLike[str]) -> tuple[dict[str, Entry], list[str]]:
    """Read one catalog; return its valid clips and every problem, one line each."""
    try:
        document = parse_toml(read_bytes(path, _LARGEST), "not TOML", _LARGEST)
    except FileFormatError as error:
        return {}, [str(error)]
    problems = [str(unknown_name("key", key, ["clips"])) for key in document if key != "clips"]
    tables = document.get("clips", {})
    if not isinstance(tables, dict):
        return {}, [*problems, "clips: expected tables [clips.NAME]"]
    clips = {}
    for name, table in tables.items():
        try:
            clips[name] = _entry(name, table)
        except KT3DMoSegError as error:
            problems.append(f"clips.{name}: {error}")
    return clips, problems


def save(path: str | os.PathLike[str], clips: Iterable[Entry], *, comment: str = "") -> None:
    """Write a catalog atomically, clips in the order given."""
    head = [f"# {line}".rstrip() for line in comment.splitlines()]
    write_text(path, "\n".join(head + [""] * bool(head)) + "\n".join(_toml(clip) for clip in clips))


def add(path: str | os.PathLike[str], entry: Entry) -> None:
    """Add a clip to a user's catalog, which is made when missing; InvalidValueError for a taken name."""
    target = Path(path)
    check_target(target)
    present = load(target, built_in=False) if target.exists() else {}
    if entry.name in present or entry.name in load():
        raise InvalidValueError(f"{target}: {entry.name}", expected="a new name", found="one that is taken")
    save(target, [*present.values(), entry])


def _entry(name: str, table: Any) -> Entry:  # noqa: ANN401  # whatever TOML holds
    if not isinstance(table, dict):
        raise InvalidValueError("entry", expected="a table", found=repr(table))
    for key in table:
        if key not in _KEYS:
            raise unknown_name("key", key, _KEYS)
    for key in _REQUIRED:
        if key not in table:
            raise InvalidValueError(key, expected="a value", found="none")
    values = {"frames": [], **table}
    if not isinstance(values["frames"], list):
        raise InvalidValueError("frames", expected="a list", found=repr(values["frames"])[:80])
    values["frames"] = tuple(_fingerprint(frame, k) for k, frame in enumerate(values["frames"]))
    if "numbers" in table:
        values["numbers"] = parse_numbers(table["numbers"])
    return Entry(name, Drive(values.pop("date"), values.pop("drive")), **values)


def _fingerprint(frame: Any, index: int) -> Fingerprint:  # noqa: ANN401
    try:
        if not isinstance(frame, dict) or set(frame) != {"crc32", "bytes", "pixels"}:
            raise InvalidValueError("frame", expected="{ crc32, bytes, pixels }", found=repr(frame)[:80])
        crc32 = int(_check_text(frame["crc32"], "crc32", "[0-9a-f]{8}", "8 hexadecimal digits"), 16)
        return Fingerprint(crc32, frame["bytes"], frame["pixels"])
    except InvalidValueError as error:
        raise InvalidValueError(f"frames[{index}]: {error}") from None


def _toml(clip: Entry) -> str:
    values = {
        "date": _quoted(clip.drive.date),
        "drive": clip.drive.number,
        "camera": clip.camera,
        "length": clip.length,
        "size": clip.size and list(clip.size),
        "numbers": clip.numbers and _quoted(format_numbers(clip.numbers)),
        "proof": clip.proof and _quoted(clip.proof),
        "source": clip.source and _quoted(clip.source),
    }
    lines = [f"{key} = {value}" for key, value in values.items() if value not in (None, "", ())]
    rows = [f'crc32 = "{f.crc32:08x}", bytes = {f.bytes}, pixels = "{f.pixels}"' for f in clip.frames]
    lines += ["frames = [", *(f"  {{ {row} }}," for row in rows), "]"] if rows else []
    return "\n".join([f"[clips.{clip.name}]", *lines]) + "\n"


def _quoted(text: str) -> str:
    """Return a text as a basic string of TOML, on one line."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
