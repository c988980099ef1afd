"""Brox and FBMS trajectories, ``.dat``: text of whole numbers and coordinates.

``nFrames``, ``nTracks``, then for each track ``label length`` and `length` times ``x y frame``;
pixels and frames from 0. Labels are kept as they are, -1 (unlabelled) becoming 0. Files of others
break lines anywhere, so tokens are read, not lines (Brox and Malik, ECCV 2010; Ochs et al., 2014).
"""

from __future__ import annotations

import os

import numpy as np

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.files import read_bytes, write_text
from kt3dmoseg.io.fields import clip_of_tracks
from kt3dmoseg.types import BoolArray, Clip, FloatArray, IntArray, Trajectories

_MAX_FILE = 1 << 30
# A track of 5 points in a thousand frames fills 60 cells per token.
_MAX_CELLS, _CELLS_PER_TOKEN, _CELLS_FREE = 1 << 28, 500, 1 << 20
_LAYOUT = "nFrames, nTracks, then per track 'label length' and length times 'x y frame'"
_END = "the end of the file"


def write(clip: Clip, path: str | os.PathLike[str]) -> None:
    """Write all trajectories; those that are not evaluated get label 0.

    Coordinates keep every bit. Which rows are evaluated, ids, image size and the rest cannot be kept
    in the format.
    """
    label = np.zeros(len(clip.dense), dtype=np.int64)
    label[clip.evaluated] = clip.labels.label
    lines = [f"{clip.n_frames}", f"{len(clip.dense)}"]
    for row, value in enumerate(label.tolist()):
        frames = np.flatnonzero(clip.dense.visible[row])
        lines.append(f"{value} {len(frames)}")
        points = clip.dense.xy[row, frames].tolist()
        lines += [f"{x!r} {y!r} {frame}" for (x, y), frame in zip(points, frames.tolist(), strict=True)]
    write_text(path, "\n".join(lines) + "\n")


def read(path: str | os.PathLike[str]) -> Clip:
    """Read a clip; every row counts as evaluated, label 0 being unlabelled."""
    numbers, frames, tracks = _parse(path)
    xy, visible = _fill(numbers, tracks, frames, os.fspath(path))
    return clip_of_tracks(path, "brox-dat", Trajectories(xy, visible), np.maximum(tracks[:, 0], 0))


def read_labels(path: str | os.PathLike[str]) -> IntArray:
    """Read only the label of each track, as the file has it: -1 where there is none; raises as `read`."""
    return _parse(path)[2][:, 0]


def _parse(path: str | os.PathLike[str]) -> tuple[FloatArray, int, IntArray]:
    """Return the numbers of the file, nFrames, and label, start and length (nTracks, 3) of each track."""
    where = os.fspath(path)
    tokens = read_bytes(path, _MAX_FILE).split()
    try:
        numbers = np.array(tokens, dtype="S32").astype(np.float64) if tokens else np.zeros(0)
    except ValueError:
        numbers = np.array([np.nan])
    if max(map(len, tokens), default=0) > 32 or not np.isfinite(numbers).all():
        number, token = next((k, t) for k, t in enumerate(tokens, start=1) if not _is_finite(t))
        expected = f"finite numbers of at most 32 digits: {_LAYOUT}"
        raise FileFormatError(
            f"{where}: value {number}", expected=expected, found=repr(token[:40].decode(errors="replace"))
        )
    if len(numbers) < 2:
        raise FileFormatError(where, expected=_LAYOUT, found=f"{len(numbers)} numbers; the file is truncated")
    frames, count = (_integer(numbers[i], where, what) for i, what in enumerate(("nFrames", "nTracks")))
    most = (len(numbers) - 2) // 2
    if count > most:
        raise FileFormatError(f"{where}: nTracks", expected=f"at most {most} in this file", found=f"{count}")
    limit = min(_MAX_CELLS, max(_CELLS_FREE, _CELLS_PER_TOKEN * len(numbers)))
    if frames * max(count, 1) > limit:
        expected, found = f"at most {limit} positions in this file", f"{frames} frames x {count} tracks"
        raise FileFormatError(f"{where}: nFrames", expected=expected, found=found)
    return numbers, frames, _tracks(numbers, count, where)


def _is_finite(token: bytes) -> bool:
    try:
        return len(token) <= 32 and bool(np.isfinite(np.array(token).astype(np.float64)))
    except ValueError:
        return False


def _tracks(numbers: FloatArray, count: int, where: str) -> IntArray:
    tracks, at = np.zeros((count, 3), dtype=np.int64), 2
    for row in range(count):
        if at + 2 > len(numbers):
            raise FileFormatError(f"{where}: track {row}", expected="label and length", found=_END)
        label = _integer(numbers[at], where, f"label of track {row}", low=-1)
        length = _integer(numbers[at + 1], where, f"length of track {row}")
        tracks[row] = label, at + 2, length
        at += 2 + 3 * length
        if at > len(numbers):
            raise FileFormatError(f"{where}: track {row}", expected=f"{length} points", found=_END)
    if at != len(numbers):
        found = f"{len(numbers) - at} more numbers"
        raise FileFormatError(where, expected=f"the end after {count} tracks", found=found)
    return tracks


def _fill(numbers: FloatArray, tracks: IntArray, frames: int, where: str) -> tuple[FloatArray, BoolArray]:
    _, starts, lengths = tracks.T
    points = np.delete(numbers, [0, 1, *(starts - 2), *(starts - 1)]).reshape(-1, 3)
    row, frame = np.repeat(np.arange(len(tracks)), lengths), points[:, 2]
    bad = (frame < 0) | (frame >= frames) | (frame != np.floor(frame))
    if bad.any():
        first, found = f"{where}: track {row[bad][0]}", f"{frame[bad][0]:g}"
        raise FileFormatError(first, expected=f"frames 0..{frames - 1}", found=found)
    index = frame.astype(np.int64)
    xy = np.full((len(tracks), frames, 2), np.nan)
    visible = np.zeros((len(tracks), frames), dtype=np.bool_)
    xy[row, index], visible[row, index] = points[:, :2], True
    if np.count_nonzero(visible) != len(row):
        raise FileFormatError(where, expected="one point per track and frame", found="a frame given twice")
    return xy, visible


def _integer(value: float, where: str, what: str, low: int = 0) -> int:
    if value != np.floor(value) or not low <= value < 1 << 40:
        expected, fix = f"a whole number >= {low}", f"the layout is {_LAYOUT}"
        raise FileFormatError(f"{where}: {what}", expected=expected, found=f"{value:g}", fix=fix)
    return int(value)
