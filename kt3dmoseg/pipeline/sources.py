"""What a clip is built from: a folder of frames, a video file, a KITTI raw root."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import sha256_file, sha256_files
from kt3dmoseg.io.images import Colour, frame_number, frame_paths, gray, has_pictures, read_frames
from kt3dmoseg.io.video import VIDEO_SUFFIXES, open_video
from kt3dmoseg.pipeline.kitti_clips import DRIVE_FOLDERS, kitti_sources, located_sources
from kt3dmoseg.pipeline.shot import Shot, Source
from kt3dmoseg.types import ByteArray


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
            sha256=sha256_files(paths),
            description={
                "kind": "frames",
                "first": paths[0].name,
                "last": paths[-1].name,
                "count": len(paths),
            },
        )

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        """Give gray frames, all of one size."""
        return read_frames(frame_paths(self.folder), colour)


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
        with open_video(self.file) as video:
            if not video.isOpened():
                raise FileFormatError(
                    f"{self.file}", expected="a video that OpenCV decodes", found="none", fix="check the file"
                )
            while (read := video.read())[0]:
                yield gray(np.asarray(read[1]), f"{self.file}", "luma")


def find_sources(path: str | os.PathLike[str]) -> list[Source]:
    """List the clips at a path, sorted by name.

    Parameters
    ----------
    path : path
        A folder of frames, a video, a KITTI raw root (the clips of its ``located.toml``, else one per
        drive), or a folder of any of the first two.

    Raises
    ------
    InputFileError
        When there is nothing of the kind.
    FileFormatError
        When ``located.toml`` is no catalog.
    """
    root = Path(path)
    if root.is_file():
        return [VideoFile(root)]
    if not root.is_dir():
        raise InputFileError(f"{root}", expected="frames, a video or a KITTI raw root", found="no such path")
    entries = [entry for entry in sorted(root.iterdir()) if not entry.name.startswith(".")]
    if has_pictures(root):
        return [FrameFolder(root)]
    found: list[Source] = []
    if any(root.glob(DRIVE_FOLDERS)):
        found += located_sources(root) or kitti_sources(root)
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
