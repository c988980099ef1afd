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
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from kt3dmoseg.catalog import models
from kt3dmoseg.catalog.models import Drive, Entry, Fingerprint
from kt3dmoseg.errors import FileFormatError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import read_bytes, write_text
from kt3dmoseg.registry import unknown_name

__all__ = ["BUILT_IN", "Drive", "Entry", "Fingerprint", "add", "load", "parse", "save", "select"]

BUILT_IN = Path(__file__).with_name("catalog.toml")
_LARGEST = 16 << 20
_REQUIRED = ("date", "drive", "camera", "length")
_KEYS = (*_REQUIRED, "size", "numbers", "frames", "proof", "source")


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
        document = tomllib.loads(read_bytes(path, _LARGEST).decode())
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
        if key not in _KEYS:
            raise unknown_name("key", key, _KEYS)
    for key in _REQUIRED:
        if key not in table:
            raise InvalidValueError(key, expected="a value", found="none")
    values = table | {"drive": Drive(table["date"], table["drive"])}
    del values["date"]
    if "numbers" in table:
        values["numbers"] = models.parse_numbers(table["numbers"])
    if not isinstance(table.get("frames", []), list):
        raise InvalidValueError("frames", expected="a list", found=repr(table["frames"])[:80])
    values["frames"] = tuple(_fingerprint(f, k) for k, f in enumerate(table.get("frames", [])))
    return Entry(name, **values)


def _fingerprint(frame: Any, index: int) -> Fingerprint:  # noqa: ANN401
    where = f"frames[{index}]"
    if not isinstance(frame, dict) or set(frame) != {"crc32", "bytes", "pixels"}:
        raise InvalidValueError(where, expected="{ crc32, bytes, pixels }", found=repr(frame)[:80])
    try:
        models.check_text(frame["crc32"], "crc32", "[0-9a-f]{8}", "8 hexadecimal digits")
        return Fingerprint(**frame | {"crc32": int(frame["crc32"], 16)})
    except InvalidValueError as error:
        raise InvalidValueError(f"{where}: {error}") from None


def _toml(clip: Entry) -> str:
    values = {
        "date": quoted(clip.drive.date),
        "drive": f"{clip.drive.number}",
        "camera": f"{clip.camera}",
        "length": f"{clip.length}",
        "size": f"{list(clip.size)}" if clip.size else "",
        "numbers": quoted(models.format_numbers(clip.numbers)) if clip.numbers else "",
        "proof": quoted(clip.proof) if clip.proof else "",
        "source": quoted(clip.source) if clip.source else "",
    }
    lines = [f"[clips.{clip.name}]", *(f"{key} = {value}" for key, value in values.items() if value)]
    rows = [f'crc32 = "{f.crc32:08x}", bytes = {f.bytes}, pixels = "{f.pixels}"' for f in clip.frames]
    lines += ["frames = [", *(f"  {{ {row} }}," for row in rows), "]"] if rows else []
    return "\n".join(lines) + "\n"


def quoted(text: str) -> str:
    r"""Return a text as a basic string of TOML, on one line.

    >>> print(quoted('a 5" pipe'))
    "a 5\" pipe"
    """
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
