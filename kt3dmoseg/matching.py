"""What belongs together: files and the frames they are of, labels of two labellings that mean one motion."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

import numpy as np

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.files import is_hidden
from kt3dmoseg.text import several
from kt3dmoseg.types import IntArray

_LAST_NUMBER = re.compile(r"(\d{1,18})\D*$")
# Roboflow appends a checksum, whose digits are no frame's number.
_APPENDED = re.compile(r"[_.](png|jpe?g|bmp|tiff?|webp)(\.rf\.\w+)?$", re.IGNORECASE)


def _path(name: str) -> PurePosixPath:
    return PurePosixPath(name.replace("\\", "/"))


def stem(name: str) -> str:
    r"""Return a file's name without folders, given with ``/`` or ``\``, and without its suffix."""
    path = _path(name)
    return _APPENDED.sub("", path.name if path.suffix[1:].isdecimal() else path.stem)


def number_in(name: str) -> int | None:
    """Return the last number in a file's name without its suffix, None when there is none.

    >>> number_in("left/frame_000012.png")
    12
    """
    found = _LAST_NUMBER.search(stem(name))
    return int(found[1]) if found else None


@dataclass(frozen=True)
class FrameMatch:
    """Which frame each file is of, by its index in the clip, whose frames are named `names`.

    The `unmatched` files are of no frame, and the `others` of other clips, in folders of their own. The
    `note` says what was concluded from the numbers; it is empty when the names say it all. The `shift` would
    let the files' numbers begin with the first frame's; None where one of them has none.
    """

    frames: dict[str, int]
    unmatched: list[str]
    others: list[str]
    note: str
    names: Sequence[str]
    shift: int | None

    @property
    def doubt(self) -> str:
        """What makes the match doubtful: files of no frame, unless every frame has one."""
        if not self.unmatched or len(set(self.frames.values())) == len(self.names):
            return ""
        return f"{several(self.unmatched)} belong to no frame of the clip"

    @property
    def expected(self) -> str:
        """What files of the clip's frames are called."""
        return f"names or numbers of the frames, {self.names[0]} to {self.names[-1]}"

    @property
    def fix(self) -> str:
        """What to do about files of no frame."""
        if self.shift is None:
            return "rename them as the frames"
        advice = f"; a shift of {self.shift} begins with the first frame"
        return "shift the numbers" + advice * bool(self.shift)


def match_frames(
    files: Iterable[str], frames: Sequence[str], *, clip: str = "", shift: int | None = None
) -> FrameMatch:
    """Find the frame of each file: the one of the same name, else of the same number; never by position.

    `frames` are the names of the clip's frames. Numbers that start at 0 and go on to the last frame are
    indices where no frame bears any of them; a `shift` is added to the files' numbers, and their names do not
    count. Hidden files are passed over. Of files in several folders, those below a folder of the clip's name
    count. FileFormatError when two files are of one frame, or files compete and no folder is the clip's.
    """
    shown = [file for file in files if not is_hidden(file)]
    named = {} if shift is not None else {stem(name): k for k, name in enumerate(frames)}
    numbered = {number_in(name): k for k, name in enumerate(frames)}
    numbers = _numbers(_of_clip(shown, clip), named, numbered)
    by_name = {file: named[stem(file)] for file in numbers if stem(file) in named}
    note = f"numbers shifted by {shift}" if shift else ""
    indices = range(len(frames))
    fits = bool(by_name) or any(number in numbered for number in numbers.values())
    if shift is None and not fits and len(numbers) == len(frames) and {*numbers.values()} == {*indices}:
        numbered = dict(zip(indices, indices, strict=True))
        note = f"numbered from 0, where the clip starts with {frames[0]}"
    found, taken, unmatched = dict(by_name), {*by_name.values()}, []
    for file, number in numbers.items():
        if file not in by_name:
            frame = None if number is None else numbered.get(number + (shift or 0))
            if frame is None or frame in taken:
                unmatched.append(file)
            else:
                found[file] = frame
    owners: dict[int, str] = {}
    for file, frame in found.items():
        if owners.setdefault(frame, file) != file:
            where, both = f"frame {frame}", f"{owners[frame]} and {file}"
            raise FileFormatError(where, expected="one file", found=both, fix="keep one of them")
    first, known = number_in(frames[0]), [number for number in numbers.values() if number is not None]
    begin = None if first is None or not known else first - min(known)
    return FrameMatch(found, unmatched, [f for f in shown if f not in numbers], note, frames, begin)


def _numbers(
    files: list[str], named: Mapping[str, int], numbered: Mapping[int | None, int]
) -> dict[str, int | None]:
    """Return the last number of each file; None where it is that of a part, an object or a camera.

    That it is behind a frame's name; or number, if this differs: ``0005_000012.png`` can be of a drive.
    """
    before = {file: _LAST_NUMBER.sub("", stem(file)).rstrip("_-. ") for file in files}
    alike = len(files) > 1 and len({*before.values()}) == 1
    frames = {
        b for b in before.values() if b.isdecimal() and len(b) < 19 and int(b) in numbered and not alike
    }
    return {file: None if b in named or b in frames else number_in(file) for file, b in before.items()}


def _of_clip(files: list[str], clip: str) -> list[str]:
    """Those below a folder of the clip's name, else all; the same names in several folders are refused."""
    paths = {file: _path(file) for file in files}
    own = {
        file: path for file, path in paths.items() if clip.casefold() in map(str.casefold, path.parent.parts)
    } or paths
    if len({path.name for path in own.values()}) < len(own):
        found = several(sorted({str(path.parent) for path in own.values()}))
        fix = f"name one {clip}, or leave the others out"
        raise FileFormatError("folders", expected=f"one of {clip}", found=found, fix=fix)
    return list(own)


def match_labels(a: IntArray, b: IntArray) -> dict[int, int]:
    """Match labels (n,) of the same trajectories one to one so that most agree (Kuhn 1955).

    Returns label of `a` to label of `b`, only those that share a trajectory; 0 matches nothing.

    >>> match_labels(np.array([1, 1, 2, 0]), np.array([5, 5, 5, 7]))
    {1: 5}
    """
    from scipy.optimize import linear_sum_assignment  # a third of a second that few commands need

    names_a, names_b = (np.unique(labels[labels != 0]) for labels in (a, b))
    shared = ((a == names_a[:, None])[:, None] & (b == names_b[:, None])).sum(axis=2)
    pairs = zip(*linear_sum_assignment(shared, maximize=True), strict=True)
    return {int(names_a[i]): int(names_b[j]) for i, j in pairs if shared[i, j] > 0}
