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

import json
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from kt3dmoseg.catalog.models import (
    Drive,
    Entry,
    Fingerprint,
    check_integer,
    format_numbers,
    matching,
    parse_numbers,
)
from kt3dmoseg.errors import FileFormatError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import read_bytes, write_text
from kt3dmoseg.registry import unknown_name

__all__ = ["BUILT_IN", "Drive", "Entry", "Fingerprint", "add", "load", "parse", "save", "select"]

BUILT_IN = Path(__file__).with_name("catalog.toml")
_LARGEST = 16 << 20
# Python's parser takes time quadratic in the length of a dotted name.
_DEEP = re.compile(r"""(?:\.[\s\w"'-]*){33}""")
_REQUIRED = ("date", "drive", "camera", "length")
_OPTIONAL = ("size", "numbers", "frames", "proof", "source")


def load(*paths: str | os.PathLike[str], built_in: bool = True) -> dict[str, Entry]:
    """Read the built-in catalog and the users' catalogs.

    Parameters
    ----------
    *paths : path
        Users' catalogs, in order; a name may be in one of them only.
    built_in : bool
        Whether the 22 clips are included.

    Returns
    -------
    dict of str to Entry
        Clips by name.

    Raises
    ------
    InputFileError, FileFormatError
        When a file is missing or not a catalog; the message gives the first problem.
    """
    clips: dict[str, Entry] = {}
    for path in ([BUILT_IN] if built_in else []) + [Path(p) for p in paths]:
        found, problems = parse(path)
        problems += [f"clips.{name}: the name is taken by another catalog" for name in found if name in clips]
        if problems:
            more = f"{len(problems) - 1} more: " if len(problems) > 1 else ""
            raise FileFormatError(
                f"{path}: {problems[0]}", fix=f"{more}'kt3dmoseg catalog check' lists all problems"
            )
        clips |= found
    return clips


def select(clips: Mapping[str, Entry], names: Iterable[str] = ()) -> list[Entry]:
    """Return the clips of these names, all when none is given.

    Raises
    ------
    UnknownNameError
        For a name that is not in the catalog, with the nearest.
    """
    wanted = list(dict.fromkeys(names)) or list(clips)
    for name in wanted:
        if name not in clips:
            raise unknown_name("clip", name, clips)
    return [clips[name] for name in wanted]


def parse(path: str | os.PathLike[str]) -> tuple[dict[str, Entry], list[str]]:
    """Read one catalog; return its valid clips and every problem, one line each."""
    try:
        text = read_bytes(path, _LARGEST).decode()
        if _DEEP.search(text):
            return {}, ["not TOML: names nested deeper than 32"]
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # no TOML, no UTF-8, a number or nesting without end
        return {}, [f"not TOML: {error}"]
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
    """Add a clip to a user's catalog, which is made when missing.

    Raises
    ------
    InvalidValueError
        When the name is in that catalog or in the built-in one.
    """
    target = Path(path)
    present = load(target, built_in=False) if target.exists() else {}
    if entry.name in present or entry.name in load():
        raise InvalidValueError(f"{target}: {entry.name}", expected="a new name", found="one that is taken")
    save(target, [*present.values(), entry])


def _entry(name: str, table: Any) -> Entry:  # noqa: ANN401  # whatever TOML holds
    if not isinstance(table, dict):
        raise InvalidValueError("entry", expected="a table", found=repr(table))
    for key in table:
        if key not in _REQUIRED + _OPTIONAL:
            raise unknown_name("key", key, _REQUIRED + _OPTIONAL)
    for key in _REQUIRED:
        if key not in table:
            raise InvalidValueError(key, expected="a value", found="none")
    return Entry(
        name=name,
        drive=Drive(table["date"], table["drive"]),
        camera=table["camera"],
        length=table["length"],
        size=_size(table["size"]) if "size" in table else None,
        numbers=parse_numbers(table["numbers"]) if "numbers" in table else None,
        frames=_frames(table.get("frames", [])),
        proof=str(table.get("proof", "")),
        source=str(table.get("source", "")),
    )


def _size(value: Any) -> tuple[int, int]:  # noqa: ANN401
    if not isinstance(value, list) or len(value) != 2:
        raise InvalidValueError("size", expected="[width, height]", found=repr(value))
    return check_integer(value[0], "width", 1 << 16), check_integer(value[1], "height", 1 << 16)


def _frames(value: Any) -> tuple[Fingerprint, ...]:  # noqa: ANN401
    if not isinstance(value, list):
        raise InvalidValueError("frames", expected="a list", found=repr(value)[:80])
    frames = []
    for index, frame in enumerate(value):
        where = f"frames[{index}]"
        if not isinstance(frame, dict) or set(frame) != {"crc32", "bytes", "pixels"}:
            raise InvalidValueError(where, expected="{ crc32, bytes, pixels }", found=repr(frame)[:80])
        try:
            crc = int(matching(frame["crc32"], "crc32", "[0-9a-f]{8}", "8 hexadecimal digits"), 16)
            frames.append(Fingerprint(crc, frame["bytes"], frame["pixels"]))
        except InvalidValueError as error:
            raise InvalidValueError(f"{where}: {error}") from None
    return tuple(frames)


def _toml(entry: Entry) -> str:
    lines = [
        f"[clips.{entry.name}]",
        f'date = "{entry.drive.date}"',
        f"drive = {entry.drive.number}",
        f"camera = {entry.camera}",
        f"length = {entry.length}",
    ]
    if entry.size:
        lines.append(f"size = [{entry.size[0]}, {entry.size[1]}]")
    if entry.numbers is not None:
        lines.append(f'numbers = "{format_numbers(entry.numbers)}"')
    lines += [f"{key} = {quoted(value)}" for key in ("proof", "source") if (value := getattr(entry, key))]
    if entry.frames:
        rows = [
            f'  {{ crc32 = "{f.crc32:08x}", bytes = {f.bytes}, pixels = "{f.pixels}" }},'
            for f in entry.frames
        ]
        lines += ["frames = [", *rows, "]"]
    return "\n".join(lines) + "\n"


def quoted(text: str) -> str:
    r"""Return a text as a basic string of TOML, on one line.

    >>> print(quoted('a 5" pipe'))
    "a 5\" pipe"
    """
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
