"""List the clips, check catalogs, add clips of your own.

kt3dmoseg catalog list
kt3dmoseg catalog add MyClip --date 2011_09_26 --drive 5 --camera 2 --numbers 40-59 --catalog mine.toml
kt3dmoseg catalog add MyClip --date 2011_09_26 --drive 5 --frames FOLDER --catalog mine.toml
kt3dmoseg catalog check mine.toml
"""

from __future__ import annotations

import argparse
from pathlib import Path

from kt3dmoseg import catalog
from kt3dmoseg.catalog.models import Drive, Entry, Fingerprint, check_camera, format_numbers, parse_numbers
from kt3dmoseg.errors import FileFormatError, InvalidValueError


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the verbs of ``kt3dmoseg catalog``."""
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="{list,add,check}")
    listing = verbs.add_parser("list", help="print the clips")
    listing.add_argument(
        "--catalog",
        action="append",
        default=[],
        metavar="FILE",
        help="a catalog of your own; may be repeated",
    )
    check = verbs.add_parser("check", help="print every problem of catalogs")
    check.add_argument("catalogs", nargs="*", metavar="FILE", help="files (default: the built-in one)")
    add = verbs.add_parser("add", help="add a clip to a catalog of your own")
    add.add_argument("name", metavar="NAME", help="name of the clip")
    add.add_argument("--catalog", required=True, metavar="FILE", help="the file to add to; made when missing")
    add.add_argument("--date", required=True, help="day of the drive, 2011_09_26")
    add.add_argument("--drive", required=True, help="number of the drive")
    add.add_argument("--camera", default="0", help="0 gray left, 1 gray right, 2 colour left, 3 colour right")
    add.add_argument("--numbers", help="frame numbers, 40-59 or 40-59,80")
    add.add_argument(
        "--frames", type=Path, metavar="FOLDER", help="folder with the clip's PNG files, to locate them by"
    )


def run(arguments: argparse.Namespace) -> int:
    """Run ``kt3dmoseg catalog``."""
    return {"list": _list, "add": _add, "check": _check}[arguments.verb](arguments)


def _list(arguments: argparse.Namespace) -> int:
    entries = catalog.load(*arguments.catalog)
    width = max(map(len, entries), default=4)
    print(f"{'clip':<{width}}  {'drive':<21}  camera  frames  size       numbers")
    for entry in entries.values():
        size = "x".join(map(str, entry.size)) if entry.size else "unknown"
        numbers = format_numbers(entry.numbers) if entry.numbers else "to be located"
        columns = f"{entry.name:<{width}}  {entry.drive.name:<21}  {entry.camera:>6}  {entry.length:>6}"
        print(f"{columns}  {size:<9}  {numbers}")
    return 0


def _add(arguments: argparse.Namespace) -> int:
    marks: tuple[Fingerprint, ...] = ()
    size = None
    if arguments.frames is not None:
        from kt3dmoseg.kitti.locating import fingerprint_folder

        marks, size = fingerprint_folder(arguments.frames)
    numbers = None if arguments.numbers is None else parse_numbers(arguments.numbers)
    if numbers is None and not marks:
        raise InvalidValueError("catalog add", expected="--numbers or --frames", found="neither")
    entry = Entry(
        name=arguments.name,
        drive=Drive(arguments.date, arguments.drive),
        camera=check_camera(arguments.camera),
        length=len(numbers or marks),
        size=size,
        numbers=numbers,
        frames=marks,
    )
    catalog.add(arguments.catalog, entry)
    print(f"{arguments.catalog}: added {entry.name}, {entry.length} frames of {entry.drive.name}")
    return 0


def _check(arguments: argparse.Namespace) -> int:
    names: dict[str, str] = {}
    wrong = 0
    for path in arguments.catalogs or [catalog.BUILT_IN]:
        entries, problems = catalog.parse(path)
        problems += [f"clips.{name}: also in {names[name]}" for name in entries if name in names]
        names |= dict.fromkeys(entries, str(path))
        for problem in problems:
            print(f"{path}: {problem}")
        wrong += len(problems)
        print(f"{path}: {len(entries)} clips, {len(problems)} problems")
    if wrong:
        raise FileFormatError("catalog check", found=f"{wrong} problems")
    return 0
