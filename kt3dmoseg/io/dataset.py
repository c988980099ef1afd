"""A folder of clips."""

from __future__ import annotations

import os
from pathlib import Path

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.io.fields import clip_name
from kt3dmoseg.io.formats import CLIP_SUFFIXES, clip_files, load
from kt3dmoseg.types import Clip


def dataset_paths(folder: str | os.PathLike[str]) -> dict[str, Path]:
    """Names and files of the clips of a folder, without reading them.

    Parameters
    ----------
    folder : path
        Holds one file per clip, or sub-folders that do (``kt3dmoseg/release``,
        ``hopkins155/<sequence>``). Sub-folders count only when the folder itself has no clip.

    Returns
    -------
    dict of str to Path
        Sorted by name.

    Raises
    ------
    InputFileError
        When the folder is missing or holds no clip.
    FileFormatError
        When two files give the same clip.
    """
    root = Path(folder)
    if not root.is_dir():
        raise InputFileError(f"{root}", expected="a folder of clips", found="no such folder")
    files = clip_files(root)
    if not files:
        folders = (sub for sub in sorted(root.iterdir()) if sub.is_dir())
        files = [file for sub in folders for file in clip_files(sub)]
    if not files:
        raise InputFileError(
            f"{root}", expected=f"clips ({', '.join(CLIP_SUFFIXES)})", found="none, nor in its sub-folders"
        )
    out: dict[str, Path] = {}
    for file in files:
        name = clip_name(file)
        if name in out:
            raise FileFormatError(
                f"{root}: clip {name}",
                expected="one file",
                found=f"{out[name].relative_to(root)} and {file.relative_to(root)}",
                fix="keep one of them",
            )
        out[name] = file
    return dict(sorted(out.items()))


def load_dataset(folder: str | os.PathLike[str]) -> dict[str, Clip]:
    """Load every clip of a folder, by name, in the order of `dataset_paths`."""
    return {name: load(path) for name, path in dataset_paths(folder).items()}
