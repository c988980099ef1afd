"""Submissions to start from: a simple example, or label files turned into one."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.io import save
from kt3dmoseg.types import Clip, IntArray, Labels, Trajectories
from mseg.evaluation.label_import import Zero, labels_and_note
from mseg.evaluation.protocol import choose_protocol
from mseg.evaluation.submission import FileFormat, SubmissionMeta, clip_checksum, write_submission
from mseg.evaluation.validation import load_clips

_EXAMPLE: dict[str, Any] = {
    "method": "example: left and right",
    "authors": ("Your Name",),
    "n_motions_given": False,
    "link": "https://example.org/paper-or-code",
    "hardware": "one CPU core",
}


class Written(NamedTuple):
    """What was written: the submission, the data that it is for, and how many clips."""

    folder: Path
    data: Path
    clips: int
    note: str = ""  # what was done to the labels


def example_submission(
    data: str | os.PathLike[str] | None,
    output: str | os.PathLike[str],
    *,
    seeds: int = 1,
    format: FileFormat = "csv",
    method: str = "",
    benchmark: str = "",
    source: str | os.PathLike[str] | None = None,
    zero: Zero = "",
) -> Written:
    """Write a valid submission whose labels cut each clip in a left and a right part, or come from files.

    Parameters
    ----------
    data : path or None
        The clips; None makes two small ones up, in ``<output>-data``.
    output : path
        Folder to write.
    seeds : int
        With more than one, each seed cuts elsewhere and has its own folder.
    format : {"csv", "npz", "h5"}
        File format of the predictions.
    method, benchmark : str
        For ``meta.toml``.
    source, zero
        Label files, and what their label 0 is; see `mseg.evaluation.read_label_files`.

    Raises
    ------
    InvalidValueError
        For fewer than one seed, label files without data, or when `output` exists.
    """
    if seeds < 1:
        raise InvalidValueError("seeds", expected="1 or more", found=str(seeds))
    if data is None and source is not None:
        expected = "the folder of clips that the labels are for"
        raise InvalidValueError("data", expected=expected, found="nothing")
    with _new_folder(output) as folder:
        place = Path(data) if data is not None else folder.with_name(folder.name + "-data")
        if data is None:
            for clip in made_up_clips().values():
                save(clip, place / f"{clip.name}.h5")
        clips = load_clips(place)
        protocol = choose_protocol(benchmark, clips)
        meta, note = SubmissionMeta(method or "unnamed", benchmark=protocol.name), ""
        labels: Any
        if source is not None:
            labels, note = labels_and_note(source, clips, names=protocol.clips, zero=zero)
            used = {name: clips[name] for name in labels}
            meta = replace(meta, outliers=any(0 in v for v in labels.values()))
        else:
            used = {name: clip for name, clip in clips.items() if protocol.holds(name)}
            runs = {seed: {n: _left_right(c, seed) for n, c in used.items()} for seed in range(seeds)}
            labels = runs[0] if seeds == 1 else runs
            meta = replace(meta, **_EXAMPLE | ({"method": method} if method else {}))
        version = protocol.version_of({name: clip_checksum(clip) for name, clip in used.items()})
        meta = replace(meta, dataset_version=version or "unnamed")
        write_submission(folder, used.values(), labels, meta, format=format)
        return Written(folder, place, len(used), note)


def made_up_clips() -> dict[str, Clip]:
    """Small clips of points in two and three motions, always the same."""
    return {name: _made_up(name, motions) for name, motions in (("example_two", 2), ("example_three", 3))}


def _made_up(name: str, motions: int) -> Clip:
    rng = np.random.default_rng(motions)
    n, frames = 30 * motions, 10
    label = np.repeat(np.arange(1, motions + 1), 30)
    start = rng.uniform((0, 40), (200, 200), size=(n, 2))
    velocity = np.array([[1.0, 0.0], [4.0, 2.0], [-2.0, -3.0]])[label - 1]
    xy = start[:, None] + velocity[:, None] * np.arange(frames)[:, None]
    xy[::7, frames // 2 :] = np.nan
    dense = Trajectories(xy, ~np.isnan(xy[..., 0]), image_size=(320, 240))
    rows = np.flatnonzero(np.arange(n) % 3 > 0)
    return Clip(name, dense, rows, Labels(label[rows], background=1))


def _left_right(clip: Clip, seed: int) -> IntArray:
    tracks = clip.evaluated_trajectories
    x = np.nan_to_num(tracks.xy[..., 0]).sum(axis=1) / np.maximum(tracks.visible.sum(axis=1), 1)
    share = np.random.default_rng(seed).uniform(0.35, 0.65)
    cut = min(max(1, round(share * len(x))), len(x) - 1)
    label = np.full(len(x), 2, dtype=np.int64)
    label[np.argsort(x, kind="stable")[:cut]] = 1
    return label


@contextmanager
def _new_folder(output: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a folder to fill; of one that could not be filled, nothing stays."""
    folder = Path(output)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        expected, fix = "a new or empty folder", "choose another -o"
        raise InvalidValueError(f"{folder}", expected=expected, found="something there", fix=fix)
    try:
        yield folder
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
