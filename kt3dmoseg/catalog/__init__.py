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

import datetime
import re
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

from kt3dmoseg.errors import FileFormatError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import PathLike, check_target, parse_toml, read_bytes, sha256_arrays, write_text
from kt3dmoseg.registry import unknown_name
from kt3dmoseg.text import toml_text
from kt3dmoseg.types import ByteArray

BUILT_IN = Path(__file__).with_name("catalog.toml")
CAMERAS = (0, 1, 2, 3)
MOST_FRAMES = 100_000

_LARGEST = 4 << 20
_REQUIRED = ("date", "drive", "camera", "length")
_KEYS = (*_REQUIRED, "size", "numbers", "frames", "proof", "source")


@dataclass(frozen=True, order=True)
class Drive:
    """One recording of KITTI raw: its day, ``"2011_09_26"``, and its number then (5, ``"5"`` or ``"0005"``).

    InvalidValueError when either is not of that form.
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
        object.__setattr__(self, "crc32", check_integer(self.crc32, "crc32", 0xFFFFFFFF))
        object.__setattr__(self, "bytes", check_integer(self.bytes, "bytes", 1 << 40))
        _check_text("pixels", self.pixels, "[0-9a-f]{64}", "64 hexadecimal digits")


@dataclass(frozen=True)
class Entry:
    """One clip of a catalog; InvalidValueError when a value makes no sense or lengths disagree.

    `name` is of letters, digits, ``_`` and ``-``; `camera` 0 gray left, 1 gray right, 2 colour left, 3 colour
    right; `length` the number of frames; `size` width and height in pixels. `numbers` are the ascending frame
    numbers in the drive, when known; `frames` one fingerprint per frame, or none when `numbers` are given.
    `proof` and `source` state how and where the numbers were found; empty when a person gave them.
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
        _check_text("name", self.name, "[A-Za-z0-9][A-Za-z0-9_-]{0,99}", "letters, digits, _ and -")
        object.__setattr__(self, "camera", check_integer(self.camera, "camera", CAMERAS[-1]))
        if self.size is not None:
            two = isinstance(self.size, (list, tuple)) and len(self.size) == 2
            _require(two, "size", "[width, height]", self.size)
            object.__setattr__(self, "size", tuple(check_integer(s, "size", 1 << 16) for s in self.size))
        numbers = self.numbers or ()
        _require(bool(numbers or self.frames), "numbers", "numbers or frames", "neither")
        object.__setattr__(self, "length", check_integer(self.length, "length", MOST_FRAMES))
        _require(self.length > 0, "length", "at least 1", 0)
        for key, values in (("numbers", numbers), ("frames", self.frames)):
            _require(len(values) in (0, self.length), key, f"{self.length}, the length", len(values))
        ascending = all(a < b for a, b in pairwise(numbers))
        _require(ascending, "numbers", "ascending", format_numbers(numbers))


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
    return ",".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs(numbers))


def runs(numbers: Iterable[int]) -> list[list[int]]:
    """Split numbers into runs of consecutive ones."""
    steady = groupby(enumerate(map(int, numbers)), lambda pair: pair[1] - pair[0])
    return [[number for _, number in run] for _, run in steady]


def _require(holds: bool, what: str, expected: str, found: object) -> None:
    if not holds:
        raise InvalidValueError(what, expected=expected, found=str(found)[:80])


def _check_text(what: str, value: object, pattern: str, expected: str) -> None:
    _require(isinstance(value, str) and bool(re.fullmatch(pattern, value)), what, expected, repr(value))


def load(*paths: PathLike, built_in: bool = True) -> dict[str, Entry]:
    """Read the built-in catalog and the users' catalogs: clips by name, each in one of them only.

    InputFileError or FileFormatError, with the first problem, when a file is missing or not a catalog.
    """
    clips: dict[str, Entry] = {}
    for path, found, problems in parse_all(([BUILT_IN] if built_in else []) + [Path(p) for p in paths]):
        if problems:
            fix = f"'kt3dmoseg catalog check' lists all {len(problems)}"
            raise FileFormatError(f"{path}: {problems[0]}", fix=fix)
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


def choose(names: Iterable[str], *paths: PathLike) -> list[Entry]:
    """Return the clips of these names; without names all of the users' catalogs, else of the built-in one.

    UnknownNameError, with the nearest name, for an unknown one; errors of files as `load`.
    """
    clips = load(*paths)
    wanted = list(dict.fromkeys(names)) or list(load(*paths, built_in=False) if paths else clips)
    for name in wanted:
        if name not in clips:
            raise unknown_name("clip", name, clips)
    return [clips[name] for name in wanted]


def parse(path: PathLike) -> tuple[dict[str, Entry], list[str]]:
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


def save(path: PathLike, clips: Iterable[Entry], *, comment: str = "") -> None:
    """Write a catalog atomically, clips in the order given."""
    head = [f"# {line}".rstrip() for line in comment.splitlines()]
    write_text(path, "\n".join(head + [""] * bool(head)) + "\n".join(_toml(clip) for clip in clips))


def add(path: PathLike, entry: Entry) -> None:
    """Add a clip to a user's catalog, which is made when missing; InvalidValueError for a taken name."""
    target = Path(path)
    check_target(target)
    present = load(target, built_in=False) if target.exists() else {}
    if entry.name in present or entry.name in load():
        raise InvalidValueError(f"{target}: {entry.name}", expected="a new name", found="one that is taken")
    save(target, [*present.values(), entry])


def _entry(name: str, table: Any) -> Entry:  # noqa: ANN401  # whatever TOML holds
    _require(isinstance(table, dict), "entry", "a table", table)
    for key in table:
        if key not in _KEYS:
            raise unknown_name("key", key, _KEYS)
    for key in _REQUIRED:
        _require(key in table, key, "a value", "none")
    values = {"frames": [], **table}
    _require(isinstance(values["frames"], list), "frames", "a list", values["frames"])
    values["frames"] = tuple(_fingerprint(frame, k) for k, frame in enumerate(values["frames"]))
    if "numbers" in table:
        values["numbers"] = parse_numbers(table["numbers"])
    return Entry(name, Drive(values.pop("date"), values.pop("drive")), **values)


def _fingerprint(frame: Any, index: int) -> Fingerprint:  # noqa: ANN401
    complete = isinstance(frame, dict) and frame.keys() == {"crc32", "bytes", "pixels"}
    _require(complete, f"frames[{index}]", "{ crc32, bytes, pixels }", frame)
    try:
        _check_text("crc32", frame["crc32"], "[0-9a-f]{8}", "8 hexadecimal digits")
        return Fingerprint(int(frame["crc32"], 16), frame["bytes"], frame["pixels"])
    except InvalidValueError as error:
        raise InvalidValueError(f"frames[{index}]: {error}") from None


def _toml(clip: Entry) -> str:
    numbers = format_numbers(clip.numbers or ())
    values = vars(clip) | {"date": clip.drive.date, "drive": clip.drive.number, "numbers": numbers}
    given = {key: values[key] for key in _KEYS if key != "frames" and values[key] not in (None, "")}
    lines = [f"{key} = {toml_text(value)}" for key, value in given.items()]
    rows = [f'crc32 = "{f.crc32:08x}", bytes = {f.bytes}, pixels = "{f.pixels}"' for f in clip.frames]
    lines += ["frames = [", *(f"  {{ {row} }}," for row in rows), "]"] if rows else []
    return "\n".join([f"[clips.{clip.name}]", *lines]) + "\n"
