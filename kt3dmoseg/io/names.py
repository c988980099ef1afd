"""From a file's name to the clip's name."""

from __future__ import annotations

import os
from pathlib import Path

_ENDINGS = ("_Tracks", "_truth")


def clip_name(path: str | os.PathLike[str]) -> str:
    """Return the clip's name: the file's stem without ``_Tracks`` or ``_truth``.

    >>> clip_name("release/Seq028_clip03_Tracks.mat"), clip_name("cars1_truth.mat")
    ('Seq028_clip03', 'cars1')
    """
    stem = Path(path).stem
    for ending in _ENDINGS:
        stem = stem.removesuffix(ending)
    return stem
