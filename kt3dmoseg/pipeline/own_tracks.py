"""Trajectories of another tracker as those of a clip: found, compared with the clip's frames, made fit.

Whatever `kt3dmoseg.load` reads is taken; its labels are not. It must have as many frames as the clip and
follow the pictures. Points outside of the image count as not visible; tracks that are then shorter than
`min_length` are dropped, as those of our own tracker.
"""

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import PathLike
from kt3dmoseg.frames import recorded_source
from kt3dmoseg.io import load
from kt3dmoseg.io.fields import clip_name
from kt3dmoseg.io.formats import clip_files
from kt3dmoseg.tracking.point_trackers import APART, fitted
from kt3dmoseg.types import ByteArray, Trajectories


def find_tracks(names: Sequence[str], tracks: PathLike) -> list[Path | None]:
    """Find the file of each clip's trajectories: ``TRACKS/<name>.npz``, or the only one in ``TRACKS/<name>``.

    `tracks` may be the file of a single clip. InputFileError is raised when it has nothing of any clip; of a
    clip that has no file, the path is one where it would be.
    """
    root = Path(tracks)
    if root.is_file() and len(names) == 1:
        return [root]
    if not root.is_dir():
        raise InputFileError(f"{root}", expected="a folder of trajectories", found="none")
    here = clip_files(root)
    found: list[Path | None] = []
    for name in names:
        below = clip_files(root / name) if (root / name).is_dir() else []
        files = [file for file in here if clip_name(file) == name] or below
        if len(files) > 1:
            listing = " and ".join(file.name for file in files[:2])
            raise FileFormatError(f"{root}: tracks of {name}", expected="one file", found=listing)
        found.append(files[0] if files else root / f"{name}.npz")
    if not any(path and path.is_file() for path in found):
        shown = ", ".join(path.name for path in here[:3]) or "no tracks"
        raise InputFileError(f"{root}", expected=f"{names[0]}.npz or {names[0]}/FILE.npz", found=shown)
    return found


def read_tracks(
    path: Path, frames: Iterator[ByteArray], numbers: Sequence[int] | None, min_length: int
) -> tuple[Trajectories, dict[str, int]]:
    """Read the trajectories of a clip with these frames, and count what is left out, in words.

    FileFormatError when they are of another number of frames, or of other ones by their recorded numbers, or
    follow the frames only with x and y exchanged, or scaled.
    """
    clip = load(path)
    given, stated = clip.dense, clip.frame_numbers.tolist()
    pictures = np.stack(list(islice(frames, APART + 1)))
    count = len(numbers) if numbers is not None else len(pictures) + sum(1 for _ in frames)
    height, width = pictures.shape[1:]
    fix = "give the tracks of all frames of the clip, and of no others"
    if given.n_frames != count:
        raise FileFormatError(f"{path}", expected=f"{count} frames", found=f"{given.n_frames}", fix=fix)
    known = recorded_source(clip.provenance) or stated != list(range(count))  # trackers record no numbers
    if known and numbers is not None and stated != list(numbers):
        expected, found = (f"frames {some[0]}-{some[-1]}" for some in (numbers, stated))
        raise FileFormatError(f"{path}", expected=expected, found=found, fix=fix)
    if given.image_size not in (None, (width, height)):
        expected = f"tracks in {width}x{height} px, as the frames"
        raise FileFormatError(f"{path}", expected=expected, found=f"{given.image_size}")
    try:
        return fitted(given, pictures, min_length)
    except InvalidValueError as error:
        raise FileFormatError(f"{path}: {error}") from None
