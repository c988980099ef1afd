"""A clip from a MAT-file: which of the known collections it belongs to."""

from __future__ import annotations

import os

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.io import hopkins, release
from kt3dmoseg.io.mat5 import read_mat
from kt3dmoseg.types import Clip


def read(path: str | os.PathLike[str]) -> Clip:
    """Read a clip of the 2018 release, Hopkins155, Hopkins12 or MTPV62.

    Raises
    ------
    FileFormatError
        When the file is damaged, of version 7.3 or 4, or of another struct.
    InputFileError
        When it cannot be read.
    """
    variables = read_mat(path)
    if hopkins.is_hopkins(variables):
        return hopkins.read(path, variables)
    if release.is_release(variables):
        return release.read(path, variables)
    data = variables.get("Data")
    inside = f", Data with the fields {', '.join(sorted(data))}" if isinstance(data, dict) else ""
    raise FileFormatError(
        os.fspath(path),
        expected="a struct Data with ySparse and GtLabel, or the variables y and s",
        found=f"variables {', '.join(sorted(variables)) or 'none'}{inside}",
        fix="give a KT3DMoSeg, Hopkins12 or MTPV62 *_Tracks.mat, or a Hopkins155 *_truth.mat",
    )
