"""What belongs together: files and the frames they are of, labels of two labellings that mean one motion."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import PurePosixPath

import numpy as np
from scipy.optimize import linear_sum_assignment

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.types import IntArray

_LAST_NUMBER = re.compile(r"(\d{1,18})\D*$")
# Roboflow appends a checksum, whose digits are no frame's number.
_APPENDED = re.compile(r"[_.](png|jpe?g|bmp|tiff?|webp)(\.rf\.\w+)?$", re.IGNORECASE)
_LISTED = 3


def number_in(name: str) -> int | None:
    """Return the last number in a file's name without its suffix, None when there is none.

    >>> number_in("left/frame_000012.png")
    12
    """
    found = _LAST_NUMBER.search(stem(name))
    return int(found[1]) if found else None


def stem(name: str) -> str:
    r"""Return a file's name without folders, given with ``/`` or ``\``, and without its suffix."""
    return _APPENDED.sub("", PurePosixPath(name.replace("\\", "/")).stem)


def is_hidden(name: str) -> bool:
    """Whether a file is hidden, as macOS leaves them between those of a folder or zip (``._x``, __MACOSX)."""
    parts = PurePosixPath(name.replace("\\", "/")).parts
    return any(part.startswith(".") and part.strip(".") for part in parts) or "__MACOSX" in parts


def several(items: Iterable[object]) -> str:
    """List a few items, and how many more there are."""
    names = [str(item) for item in items]
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return ", ".join(names[:_LISTED]) + more


@dataclass(frozen=True)
class FrameMatch:
    """Which frame each file is of.

    Parameters
    ----------
    frames : dict of str to int
        File to the index of its frame in the clip.
    unmatched : list of str
        Files that belong to no frame.
    others : list of str
        Files of other clips, in folders of their own.
    note : str
        What was concluded from the numbers; empty when the names say it all.
    """

    frames: dict[str, int] = field(default_factory=dict)
    unmatched: list[str] = field(default_factory=list)
    others: list[str] = field(default_factory=list)
    note: str = ""

    def doubt(self, n_frames: int) -> str:
        """Say what makes the match doubtful: files of no frame, unless every frame has one."""
        if not self.unmatched or len(set(self.frames.values())) == n_frames:
            return ""
        return f"{several(self.unmatched)} belong to no frame of the clip"


def match_frames(
    files: Iterable[str], frames: Sequence[str], *, clip: str = "", shift: int | None = None
) -> FrameMatch:
    """Find the frame of each file: the one of the same name, else of the same number; never by position.

    Numbers that start at 0 and go on to the last frame are indices where no frame bears any of them. Hidden
    files are passed over. Of files in several folders that compete for frames, those below a folder of the
    clip's name count.

    Parameters
    ----------
    files, frames : sequence of str
        Paths of the files, and names of the clip's frames in their order.
    clip : str
        Name of the clip.
    shift : int, optional
        Add this to the files' numbers instead of looking at names.

    Raises
    ------
    FileFormatError
        When two files are of one frame, or several folders compete and none is the clip's.
    """
    shown = [file for file in files if not is_hidden(file)]
    chosen = _of_clip(shown, clip)
    named = {} if shift is not None else {stem(name): k for k, name in enumerate(frames)}
    numbered = {number_in(name): k for k, name in enumerate(frames)}
    numbers = {file: number_in(file) for file in chosen}
    note = f"numbers shifted by {shift}" if shift else ""
    known = any(stem(file) in named or numbers[file] in numbered for file in chosen)
    if shift is None and not known and sorted(map(str, numbers.values())) == _texts(len(frames)):
        numbered = {k: k for k in range(len(frames))}
        note = f"numbered from 0, where the clip starts with {frames[0]}"
    match = FrameMatch(others=[file for file in shown if file not in chosen], note=note)
    first: dict[int, str] = {}
    for file in chosen:
        if (frame := named.get(stem(file))) is not None:
            match.frames[file] = frame
            _check_alone(first.setdefault(frame, file), file, frame)
    for file in (file for file in chosen if file not in match.frames):
        number = numbers[file]
        frame = None if number is None else numbered.get(number + (shift or 0))
        if frame is None or stem(first.get(frame, "")) in named:
            match.unmatched.append(file)
        else:
            match.frames[file] = frame
            _check_alone(first.setdefault(frame, file), file, frame)
    return match


def _texts(count: int) -> list[str]:
    return sorted(map(str, range(count)))


def _check_alone(first: str, file: str, frame: int) -> None:
    if first != file:
        where, found = f"frame {frame}", f"{first} and {file}"
        raise FileFormatError(where, expected="one file", found=found, fix="keep one of them")


def _of_clip(files: list[str], clip: str) -> list[str]:
    """Those of the clip's folder, where the same names are in several folders."""
    folders: dict[str, list[str]] = {}
    for file in files:
        path = PurePosixPath(file.replace("\\", "/"))
        folders.setdefault(str(path.parent), []).append(path.name)
    names = [name for inside in folders.values() for name in inside]
    if len(folders) < 2 or len(set(names)) == len(names):
        return files
    own = [folder for folder in folders if clip in PurePosixPath(folder).parts]
    if len(own) != 1:
        where, fix = several(sorted(folders)), f"name one {clip}, or leave the others out"
        raise FileFormatError("folders", expected=f"one of {clip}", found=where, fix=fix)
    return [f for f in files if str(PurePosixPath(f.replace("\\", "/")).parent) == own[0]]


def match_labels(a: IntArray, b: IntArray) -> dict[int, int]:
    """Match labels one to one so that most trajectories agree (Kuhn 1955).

    Parameters
    ----------
    a, b : (n,) int64
        Labels of the same trajectories; 0 matches nothing.

    Returns
    -------
    dict of int to int
        Label of `a` to label of `b`; only those that share a trajectory.

    Examples
    --------
    >>> match_labels(np.array([1, 1, 2, 0]), np.array([5, 5, 5, 7]))
    {1: 5}
    """
    names_a, names_b = (np.unique(labels[labels != 0]) for labels in (a, b))
    shared = ((a == names_a[:, None])[:, None] & (b == names_b[:, None])).sum(axis=2)
    pairs = zip(*linear_sum_assignment(shared, maximize=True), strict=True)
    return {int(names_a[i]): int(names_b[j]) for i, j in pairs if shared[i, j] > 0}
