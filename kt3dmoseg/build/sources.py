"""What a clip is built from: a folder of frames, a video file, a range of a KITTI raw drive."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import sha256_file
from kt3dmoseg.io.images import (
    IMAGE_SUFFIXES,
    Colour,
    frame_number,
    frame_paths,
    gray,
    quiet_opencv,
    read_frame,
)
from kt3dmoseg.kitti import Drive, RawDrive
from kt3dmoseg.types import ByteArray, Camera, FloatArray

VIDEO_SUFFIXES = (".avi", ".mkv", ".mov", ".mp4", ".mpg", ".webm")
# FFmpeg's AV_LOG_QUIET, which OpenCV reads once: a damaged video is our one line to tell.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

_DRIVE = re.compile(r"(\d{4}_\d\d_\d\d)_drive_(\d{4})_sync")


@dataclass(frozen=True)
class Shot:
    """What is known of a clip before its frames are read.

    Parameters
    ----------
    numbers : sequence of int or None
        Numbers of the frames; None when only reading tells.
    sha256 : str
        Of everything the frames are decoded from, in order.
    description : mapping
        Where the frames come from, for the provenance; no path of this machine.
    timestamps : (F,) float64 or None
        Seconds.
    camera : Camera or None
        The camera.
    """

    numbers: Sequence[int] | None
    sha256: str
    description: dict[str, Any]
    timestamps: FloatArray | None = None
    camera: Camera | None = None


class Source(Protocol):
    """A clip's frames. Making one reads nothing, so that a bad clip fails when it is built."""

    @property
    def name(self) -> str:
        """Name of the clip."""
        ...

    @property
    def where(self) -> str:
        """The place on this machine, for messages."""
        ...

    def inspect(self) -> Shot:
        """Check the source and say what is known without decoding it."""
        ...

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        """Give gray frames one after the other."""
        ...


@dataclass(frozen=True)
class FrameFolder:
    """A folder of numbered pictures; the clip has the folder's name."""

    folder: Path

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.resolve().name

    @property
    def where(self) -> str:
        """The folder."""
        return f"{self.folder}"

    def inspect(self) -> Shot:
        """Check names and numbers and hash the files."""
        paths = frame_paths(self.folder)
        return Shot(
            numbers=[frame_number(path) for path in paths],
            sha256=_sha256_of(paths),
            description={
                "kind": "frames",
                "first": paths[0].name,
                "last": paths[-1].name,
                "count": len(paths),
            },
        )

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        """Give gray frames, all of one size."""
        return _pictures(frame_paths(self.folder), colour)


@dataclass(frozen=True)
class VideoFile:
    """A video, decoded frame by frame; always taken as luma."""

    file: Path

    @property
    def name(self) -> str:
        """Name of the file without its suffix."""
        return self.file.stem

    @property
    def where(self) -> str:
        """The file."""
        return f"{self.file}"

    def inspect(self) -> Shot:
        """Hash the file."""
        digest = sha256_file(self.file)
        return Shot(None, digest, {"kind": "video", "file": self.file.name, "sha256": digest})

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        """Give the luma of every frame."""
        del colour  # a video is in colour by nature
        with quiet_opencv():
            video = cv2.VideoCapture(os.fspath(self.file))
        try:
            if not video.isOpened():
                raise FileFormatError(
                    f"{self.file}", expected="a video that OpenCV decodes", found="none", fix="check the file"
                )
            while True:
                more, picture = video.read()
                if not more:
                    return
                yield gray(np.asarray(picture), f"{self.file}", "luma")
        finally:
            video.release()


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
            sha256=_sha256_of([self.drive.frame_path(n) for n in numbers]),
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
        return _pictures([self.drive.frame_path(n) for n in self._numbers()], wanted)

    def _numbers(self) -> list[int]:
        present = [int(n) for n in self.drive.numbers]
        first = self.first if self.first is not None else min(present, default=0)
        last = self.last if self.last is not None else max(present, default=0)
        if last <= first:
            raise InvalidValueError(
                f"{self.where}: range", expected="at least two frames, FIRST-LAST", found=f"{first}-{last}"
            )
        return list(range(first, last + 1))


def find_sources(path: str | os.PathLike[str]) -> list[Source]:
    """List the clips at a path, sorted by name.

    Parameters
    ----------
    path : path
        A folder of frames, a video, a KITTI raw root (one clip per drive), or a folder of any of
        the first two.

    Raises
    ------
    InputFileError
        When there is nothing of the kind.
    """
    root = Path(path)
    if root.is_file():
        return [VideoFile(root)]
    if not root.is_dir():
        raise InputFileError(f"{root}", expected="frames, a video or a KITTI raw root", found="no such path")
    entries = [entry for entry in sorted(root.iterdir()) if not entry.name.startswith(".")]
    if any(entry.suffix.lower() in IMAGE_SUFFIXES for entry in entries):
        return [FrameFolder(root)]
    found: list[Source] = []
    if any(root.glob("????_??_??/*_drive_????_sync")):
        found += kitti_sources(root)
    else:
        found += [FrameFolder(entry) for entry in entries if entry.is_dir()]
        found += [VideoFile(entry) for entry in entries if entry.suffix.lower() in VIDEO_SUFFIXES]
    if not found:
        raise InputFileError(
            f"{root}",
            expected="numbered frames, or one folder of frames per clip",
            found="an empty folder" if not entries else f"{entries[0].name}, no pictures",
            fix="give the folder that holds them",
        )
    return sorted(found, key=lambda source: source.name)


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
        for folder in sorted(Path(root).glob("????_??_??/*_drive_????_sync"))
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


def _pictures(paths: Sequence[Path], colour: Colour) -> Iterator[ByteArray]:
    first: tuple[int, ...] | None = None
    for path in paths:
        frame = read_frame(path, colour)
        first = first or frame.shape
        if frame.shape != first:
            raise FileFormatError(
                f"{path}",
                expected=f"{first[1]}x{first[0]} px, as {paths[0].name}",
                found=f"{frame.shape[1]}x{frame.shape[0]}",
                fix="give frames of one size",
            )
        yield frame


def _sha256_of(paths: Sequence[Path]) -> str:
    return hashlib.sha256("\n".join(map(sha256_file, paths)).encode()).hexdigest()
