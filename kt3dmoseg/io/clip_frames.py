"""The frames that belong to a clip, to draw on."""

from __future__ import annotations

import os

from kt3dmoseg.errors import InputFileError
from kt3dmoseg.io.images import frame_paths, read_frames
from kt3dmoseg.types import ByteArray, Clip


def frames_of(clip: Clip, folder: str | os.PathLike[str]) -> list[ByteArray]:
    """Read the frames of a clip: as many as it has, and of its size.

    Parameters
    ----------
    clip : Clip
        The clip.
    folder : path
        Its numbered pictures; of those in colour the luma is taken.

    Returns
    -------
    list of (H, W) uint8

    Raises
    ------
    InputFileError, FileFormatError
        When they cannot be read, or are those of another clip.
    """
    paths = frame_paths(folder)
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
