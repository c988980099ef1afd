"""The frames that belong to a clip, to draw on."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kt3dmoseg.errors import InputFileError
from kt3dmoseg.io.images import frame_paths, numbered_pictures, read_frames
from kt3dmoseg.types import ByteArray, Clip

_DRIVE = re.compile(r"(\d{4}_\d\d_\d\d)_drive_\d{4}")


def frames_place(clip: Clip, folder: str | os.PathLike[str]) -> Path:
    """Return the folder of a clip's frames: below a folder of clips, in a KITTI raw root, or itself."""
    root, source = Path(folder), _kitti_source(clip)
    below, camera = [root / clip.name], source.get("camera")
    if (drive := _DRIVE.fullmatch(str(source.get("drive")))) and camera in (0, 1, 2, 3):
        below.append(root / drive[1] / f"{drive[0]}_sync" / f"image_{camera:02d}" / "data")
    return next((place for place in below if place.is_dir()), root)


def frames_of(clip: Clip, folder: str | os.PathLike[str]) -> list[ByteArray]:
    """Read the frames of a clip: as many as it has, and of its size.

    Parameters
    ----------
    clip : Clip
        The clip.
    folder : path
        Its numbered pictures; of those in colour the luma is taken. There may be more than the clip's
        when it was built from a KITTI drive: those of its numbers are taken.

    Returns
    -------
    list of (H, W) uint8

    Raises
    ------
    InputFileError, FileFormatError
        When they cannot be read, or are those of another clip.
    """
    paths = paths_of_frames(clip, folder)
    if len(paths) != clip.n_frames:
        raise InputFileError(
            os.fspath(folder), expected=f"the {clip.n_frames} frames of {clip.name}", found=f"{len(paths)}"
        )
    frames = list(read_frames(paths, "luma"))
    found, wanted = frames[0].shape[::-1], clip.dense.image_size
    if wanted is not None and found != wanted:
        raise InputFileError(
            os.fspath(folder),
            expected=f"frames of {wanted[0]}x{wanted[1]} px, as in {clip.name}",
            found=f"{found[0]}x{found[1]}",
        )
    return frames


def paths_of_frames(clip: Clip, folder: str | os.PathLike[str]) -> list[Path]:
    """List a folder's numbered pictures, or of a KITTI drive those that the clip was built from."""
    if _kitti_source(clip) and Path(folder).is_dir():
        pictures, numbers = numbered_pictures(Path(folder)), clip.frame_numbers.tolist()
        if set(numbers) <= set(pictures):
            return [pictures[number] for number in numbers]
    return frame_paths(folder)


def _kitti_source(clip: Clip) -> Mapping[str, Any]:
    """Return what a built clip says of the KITTI drive that it comes from; empty of other clips."""
    value: Any = clip.provenance
    for name in ("fingerprint", "source"):
        value = value.get(name) if isinstance(value, Mapping) else None
    return value if isinstance(value, Mapping) and value.get("kind") == "kitti" else {}
