"""The table of clip formats, and `load`, which recognises what it is given."""

from __future__ import annotations

import os
from pathlib import Path

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.io import hopkins, release
from kt3dmoseg.io.mat5 import read_mat
from kt3dmoseg.types import Clip

CLIP_SUFFIXES = (".h5", ".mat", ".npz", ".dat")


def load(path: str | os.PathLike[str]) -> Clip:
    """Load one clip from any format that is read.

    Parameters
    ----------
    path : path
        A file, or a folder that holds one clip file.

    Raises
    ------
    InputFileError
        When it is missing or unreadable.
    FileFormatError
        When it is of no known format, damaged, or contradicts itself.
    """
    file = Path(path)
    if not file.exists():
        raise InputFileError(f"{file}: no such file")
    variables = read_mat(file)
    if hopkins.is_hopkins(variables):
        return hopkins.read(file, variables)
    if release.is_release(variables):
        return release.read(file, variables)
    raise FileFormatError(f"{file}", expected="a clip", found=f"variables {', '.join(variables)}")
