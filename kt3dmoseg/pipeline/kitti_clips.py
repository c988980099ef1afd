"""Clips of KITTI raw drives: those that were located, all frames on disk, or a range of numbers."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kt3dmoseg import catalog
from kt3dmoseg.catalog.models import Entry, format_numbers
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import sha256_files
from kt3dmoseg.io.images import Colour, read_frames
from kt3dmoseg.kitti import Drive, RawDrive
from kt3dmoseg.kitti.raw import LOCATED
from kt3dmoseg.pipeline.shot import Shot, Source
from kt3dmoseg.types import ByteArray, Camera

DRIVE_FOLDERS = "????_??_??/*_drive_????_sync"
_DRIVE = re.compile(r"(\d{4}_\d\d_\d\d)_drive_(\d{4})_sync")


@dataclass(frozen=True)
class KittiClip:
    """Frames of a KITTI raw drive, by number; all that are on disk unless a range is given."""

    drive: RawDrive
    first: int | None = None
    last: int | None = None
    title: str = ""

    @property
    def name(self) -> str:
        """The given title, or the drive's name and the range."""
        span = "" if self.first is None else f"_{self.first:06d}-{self.last:06d}"
        return self.title or f"{self.drive.drive.name}{span}"

    @property
    def where(self) -> str:
        """The root and the drive in it."""
        return f"{self.drive.root}: {self.drive.drive.name}"

    def inspect(self) -> Shot:
        """Check that the frames are there, hash them, and read their times and the calibration."""
        numbers = self._numbers()
        return Shot(
            numbers=numbers,
            sha256=sha256_files([self.drive.frame_path(n) for n in numbers]),
            description={
                "kind": "kitti",
                "drive": self.drive.drive.name,
                "camera": self.drive.camera,
                "first": numbers[0],
                "last": numbers[-1],
            },
            timestamps=self.drive.timestamps(numbers),
            camera=Camera(f"image_{self.drive.camera:02d}", self.drive.K),
        )

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        """Give gray frames; of the colour cameras 2 and 3 their luma."""
        wanted: Colour = "luma" if self.drive.camera > 1 else colour
        return read_frames([self.drive.frame_path(n) for n in self._numbers()], wanted)

    def _numbers(self) -> Sequence[int]:
        present = [int(n) for n in self.drive.numbers]
        first = self.first if self.first is not None else min(present, default=0)
        last = self.last if self.last is not None else max(present, default=0)
        if last <= first:
            raise InvalidValueError(
                f"{self.where}: range", expected="at least two frames, FIRST-LAST", found=f"{first}-{last}"
            )
        return range(first, last + 1)


def located_sources(root: str | os.PathLike[str]) -> list[Source]:
    """List the clips of ``ROOT/located.toml``, as `pull` and `locate` write it, that are on disk.

    Parameters
    ----------
    root : path
        A KITTI raw root; without that file the list is empty.

    Raises
    ------
    FileFormatError
        When the file is no catalog, or a clip in it skips frames.
    """
    path = Path(root) / LOCATED
    entries = catalog.load(path, built_in=False) if path.is_file() else {}
    return [clip for entry in entries.values() if (clip := _on_disk(path, entry))]


def _on_disk(path: Path, entry: Entry) -> KittiClip | None:
    """Give the clip when at least one of its frames is there."""
    numbers = entry.numbers or ()
    try:
        drive = RawDrive(path.parent, entry.drive.date, entry.drive.number, entry.camera)
        if not np.isin(numbers, drive.numbers).any():
            return None
    except InputFileError:  # nothing of that drive or camera
        return None
    if numbers[-1] - numbers[0] + 1 != len(numbers):
        raise FileFormatError(
            f"{path}: {entry.name}", expected="consecutive frames", found=format_numbers(numbers)
        )
    return KittiClip(drive, numbers[0], numbers[-1], entry.name)


def kitti_sources(
    root: str | os.PathLike[str],
    *,
    date: str | None = None,
    drive: str | int | None = None,
    camera: int = 0,
    frames: str | tuple[int, int] | None = None,
    name: str = "",
) -> list[Source]:
    """List the drives under a KITTI raw root, as clips.

    Parameters
    ----------
    root : path
        The folder that holds ``2011_09_26/2011_09_26_drive_0005_sync``.
    date, drive : optional
        Only that day, only that number.
    camera : int
        0 and 1 gray, 2 and 3 colour.
    frames : (first, last) or "first-last", optional
        Frame numbers, both included; by default all that are on disk.
    name : str
        Name of the clip; only for a single drive.

    Raises
    ------
    InputFileError
        When no drive fits.
    InvalidValueError
        When a range or a name is given for several drives.
    """
    span = _span(frames)
    wanted = None if drive is None else Drive(date or "2011_09_26", drive).number  # type: ignore[arg-type]  # it converts
    found = [
        match
        for folder in sorted(Path(root).glob(DRIVE_FOLDERS))
        if (match := _DRIVE.fullmatch(folder.name))
        and date in (None, match[1])
        and wanted in (None, int(match[2]))
    ]
    if not found:
        asked = " ".join(str(part) for part in (date, drive) if part is not None)
        raise InputFileError(
            f"{os.fspath(root)}",
            expected=f"a KITTI raw root with drive {asked}".rstrip(),
            found="no such drive",
            fix="fetch it with kt3dmoseg pull, or give the folder that holds the day's folder",
        )
    if len(found) > 1 and (span or name):
        raise InvalidValueError(
            "range and name", expected="one drive", found=f"{len(found)}", fix="give --date and --drive"
        )
    first, last = span or (None, None)
    return [KittiClip(RawDrive(root, match[1], match[2], camera), first, last, name) for match in found]


def _span(frames: str | tuple[int, int] | None) -> tuple[int, int] | None:
    if not isinstance(frames, str):
        return frames
    match = re.fullmatch(r"(\d{1,9})-(\d{1,9})", frames)
    if not match:
        raise InvalidValueError("range", expected="FIRST-LAST, as 45-64", found=repr(frames))
    return int(match[1]), int(match[2])
