"""Brox and FBMS trajectories, ``.dat``: text of whole numbers and coordinates.

``nFrames``, ``nTracks``, then for each track ``label length`` and `length` times ``x y frame``;
pixels and frames from 0. Labels are kept as they are, -1 (unlabelled) becoming 0. Files of others
break lines anywhere, so tokens are read, not lines (Brox and Malik, ECCV 2010; Ochs et al., 2014).
"""

import os

import numpy as np

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.files import PathLike, read_bytes, write_text
from kt3dmoseg.io.fields import foreign_clip
from kt3dmoseg.types import Clip, FloatArray, IntArray, Labels, Trajectories

_MAX_FILE = 1 << 30
# A track of 5 points in a thousand frames fills 60 cells per token.
_MAX_CELLS, _CELLS_PER_TOKEN, _CELLS_FREE = 1 << 28, 500, 1 << 20
_LAYOUT = "nFrames, nTracks, then per track 'label length' and length times 'x y frame'"
_END = "the end of the file"


def write(clip: Clip, path: PathLike) -> None:
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


def read(path: PathLike) -> Clip:
    """Read a clip; every row counts as evaluated. Label 0 is unlabelled; with -1 for it, 0 is a cluster."""
    label, tracks = read_tracks(path)
    from_zero = (label < 0).any() and (label == 0).any()
    return foreign_clip(path, "brox-dat", tracks, Labels(np.maximum(label + from_zero, 0)))


def read_tracks(path: PathLike) -> tuple[IntArray, Trajectories]:
    """Read the label of each track as the file has it, -1 where there is none, and the tracks."""
    where, content = os.fspath(path), read_bytes(path, _MAX_FILE)
    head = _numbers(content.split(None, 2)[:2], where)
    frames, count = (_whole(head, i, f"{where}: {what}") for i, what in enumerate(("nFrames", "nTracks")))
    most = max(_CELLS_FREE, 2 + count * (2 + 3 * frames))
    tokens = content.split(None, min(most, len(content)))
    if len(tokens) > most:
        found = f"more numbers than {frames} frames x {count} tracks have"
        raise FileFormatError(f"{where}: nTracks", expected="the tracks that follow", found=found)
    numbers = _numbers(tokens, where)
    limit = min(_MAX_CELLS, max(_CELLS_FREE, _CELLS_PER_TOKEN * len(numbers)))
    if frames * max(count, 1) > limit:
        expected, found = f"at most {limit} positions in this file", f"{frames} frames x {count} tracks"
        raise FileFormatError(f"{where}: nFrames", expected=expected, found=found)
    heads: list[tuple[int, int, int]] = []
    at = 2
    while at < len(numbers):
        track = f"{where}: track {len(heads)}"
        label = _whole(numbers, at, f"{track}: label", low=-1)
        length = _whole(numbers, at + 1, f"{track}: length")
        heads.append((at, label, length))
        at += 2 + 3 * length
        if at > len(numbers):
            raise FileFormatError(track, expected=f"{length} points", found=_END)
    if len(heads) != count:
        expected = f"{len(heads)}, the tracks that follow"
        raise FileFormatError(f"{where}: nTracks", expected=expected, found=f"{count}")
    starts, labels, lengths = np.array(heads, dtype=np.int64).reshape(-1, 3).T
    points = np.delete(numbers, [0, 1, *starts, *(starts + 1)]).reshape(-1, 3)
    xy = np.full((count, frames, 2), np.nan)
    _fill(xy, np.repeat(np.arange(count), lengths), points, where)
    return labels, Trajectories(xy, ~np.isnan(xy[..., 0]))


def _fill(xy: FloatArray, row: IntArray, points: FloatArray, where: str) -> None:
    frame, frames = points[:, 2], xy.shape[1]
    bad = (frame < 0) | (frame >= frames) | (frame != np.floor(frame))
    if bad.any():
        track, found = f"{where}: track {row[bad][0]}", f"{frame[bad][0]:g}"
        raise FileFormatError(track, expected=f"frames 0..{frames - 1}", found=found)
    xy[row, frame.astype(np.int64)] = points[:, :2]
    if np.count_nonzero(~np.isnan(xy[..., 0])) != len(row):
        raise FileFormatError(where, expected="one point per track and frame", found="a frame given twice")


def _numbers(tokens: list[bytes], where: str) -> FloatArray:
    numbers = np.fromiter(map(_number, tokens), np.float64, len(tokens))
    if len(bad := np.flatnonzero(~np.isfinite(numbers))):
        found = tokens[bad[0]][:40].decode(errors="replace")
        raise FileFormatError(
            f"{where}: value {bad[0] + 1}", expected=f"finite numbers: {_LAYOUT}", found=repr(found)
        )
    return numbers


def _number(token: bytes) -> float:
    try:
        return float(token)
    except ValueError:
        return np.nan


def _whole(numbers: FloatArray, at: int, where: str, low: int = 0) -> int:
    value = numbers[at] if at < len(numbers) else np.nan
    if value != np.floor(value) or not low <= value < 1 << 40:
        found, fix = _END if at >= len(numbers) else f"{value:g}", f"the layout is {_LAYOUT}"
        raise FileFormatError(where, expected=f"a whole number >= {low}", found=found, fix=fix)
    return int(value)
