"""A submission, format version 1: its layout and how to write one.

::

    my-submission/                 a folder, or a zip of its content
        meta.toml                  who, how, on which data
        Seq005_Clip01.csv          one file per clip: track,label
        Seq005_Clip02.failed       ... or the reason why the method failed on it

Predictions of several seeds lie in one folder per seed, ``seed-0/Seq005_Clip01.csv``.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.files import atomic_path, check_writable, sha256_arrays, write_text
from kt3dmoseg.io.npz import write_npz
from kt3dmoseg.io.predictions import SUFFIXES, clip_labels, first_few, label_table
from kt3dmoseg.registry import nearest
from kt3dmoseg.types import Clip, IntArray, Labels
from mseg.types import Segmentation

FORMAT_VERSION = 1
META = "meta.toml"
FAILED = ".failed"
FileFormat: TypeAlias = Literal["csv", "npz", "h5"]
_CLIP_NAME = re.compile(r"\w[\w .-]{0,127}")


@dataclass(frozen=True)
class SubmissionMeta:
    """The meta data of a submission: the fields of ``meta.toml``."""

    method: str  # name of the method, as it shall appear in tables
    authors: tuple[str, ...] = ("unnamed",)
    dataset_version: str = ""  # such as "2018", the release of that year; may be empty with fingerprints
    benchmark: str = ""  # name of the protocol; empty = the one that the clips belong to
    n_motions_given: bool = True  # whether the method was given the number of motions of each clip
    link: str = ""  # paper or code
    hardware: str = ""
    seconds: float = 0.0  # for all clips, of one seed
    outliers: bool = False  # label 0 is meant; otherwise it is refused as a sign of labels from 0
    baseline: bool = False  # one label for a whole clip is meant; otherwise refused as a mistake
    fingerprints: Mapping[str, str] = field(default_factory=dict)  # clip -> clip_checksum
    parameters: Mapping[str, str] = field(default_factory=dict)  # options of the method, free
    # Clip -> what one must know to trust its labels, such as a method that did not converge.
    notes: Mapping[str, str] = field(default_factory=dict)


def clip_checksum(clip: Clip) -> str:
    """Identify the evaluated trajectories of a clip: 16 hexadecimal digits.

    Ids and visibility count exactly, positions as float32, so that the same data in another file
    format has the same checksum; the order of the trajectories and the labels do not count.
    """
    tracks = clip.evaluated_trajectories
    order = np.argsort(tracks.track_id)
    xy = np.where(tracks.visible[..., None], tracks.xy, 0.0).astype(np.float32) + np.float32(0)
    return sha256_arrays(tracks.track_id[order], tracks.visible[order], xy[order])[:16]


fingerprint = clip_checksum  # its public name up to version 0.1


def write_meta(folder: str | os.PathLike[str], meta: SubmissionMeta) -> Path:
    """Write ``meta.toml``; returns its path."""
    path = Path(folder) / META
    values = asdict(meta)
    lines = [f"format_version = {FORMAT_VERSION}"]
    lines += [f"{key} = {_toml(value)}" for key, value in values.items() if not isinstance(value, dict)]
    for key, value in values.items():
        if isinstance(value, dict) and value:
            lines += ["", f"[{key}]", *(f"{_toml(k)} = {_toml(v)}" for k, v in sorted(value.items()))]
    write_text(path, "\n".join([*lines, ""]))
    return path


def write_prediction(
    folder: str | os.PathLike[str],
    clip: Clip,
    labels: npt.ArrayLike,
    *,
    seed: int | None = None,
    format: FileFormat = "csv",
) -> Path:
    """Write the labels of one clip into a submission.

    Parameters
    ----------
    folder : path
        The submission.
    clip : Clip
        The clip; the ids of its evaluated trajectories go into the file.
    labels : (n,) int
        One label per evaluated trajectory: 1, 2, ...; 0 = outlier.
    seed : int or None
        Write into ``seed-<seed>/``; None for a submission of a single run.
    format : {"csv", "npz", "h5"}
        File format.

    Raises
    ------
    InvalidValueError
        When the labels do not fit the clip, or its name cannot be a file name.
    """
    label = clip_labels(bare_labels(labels), clip, f"labels of {clip.name}")
    if format not in get_args(FileFormat):
        raise InvalidValueError("format", expected=" or ".join(get_args(FileFormat)), found=repr(format))
    path = file_of(folder, clip.name, seed, f".{format}")
    track = clip.dense.track_id[clip.evaluated]
    if format == "csv":
        rows = "\n".join(f"{t},{v}" for t, v in zip(track.tolist(), label.tolist(), strict=True))
        write_text(path, f"track,label\n{rows}\n")
    elif format == "npz":
        write_npz(path, {"track": track, "label": label})
    else:
        import h5py

        with atomic_path(path) as temporary, h5py.File(temporary, "w") as stream:
            stream.create_dataset("track", data=track)
            stream.create_dataset("label", data=label)
    for ending in {*SUFFIXES, FAILED} - {path.suffix}:  # what an earlier run wrote about the clip
        file_of(folder, clip.name, seed, ending).unlink(missing_ok=True)
    return path


def write_failure(
    folder: str | os.PathLike[str], clip: Clip, reason: str, *, seed: int | None = None
) -> Path:
    """Record that the method failed on a clip, and why; it will count as fully wrong."""
    path = file_of(folder, clip.name, seed, FAILED)
    write_text(path, " ".join(reason.split()) + "\n")
    return path


def write_submission(
    folder: str | os.PathLike[str],
    clips: Iterable[Clip],
    predictions: Mapping[str, npt.ArrayLike] | Mapping[int, Mapping[str, npt.ArrayLike]],
    meta: SubmissionMeta,
    *,
    format: FileFormat = "csv",
) -> Path:
    """Write a whole submission.

    Parameters
    ----------
    folder : path
        Where; created when missing.
    clips : iterable of Clip
        The clips that were segmented.
    predictions : mapping
        Clip name -> labels for a single run, or seed -> clip name -> labels.
    meta : SubmissionMeta
        The meta data; the checksums of the clips are added.
    format : {"csv", "npz", "h5"}
        File format of the predictions.

    Returns
    -------
    Path
        The folder.
    """
    if not isinstance(meta, SubmissionMeta):
        raise InvalidValueError("meta", expected="a SubmissionMeta", found=type(meta).__name__)
    check_writable(folder)
    by_name = clips_by_name(clips.values() if isinstance(clips, Mapping) else clips)
    labels: dict[tuple[int | None, str], IntArray] = {}
    for seed, run in prediction_runs(predictions).items():
        check_names(run, by_name, "predictions")
        for name, values in run.items():
            labels[seed, name] = clip_labels(bare_labels(values), by_name[name], f"predictions of {name}")
    written = {file_of(folder, name, seed, "") for seed, name in labels}
    older = [path for path in prediction_files(folder) if path.with_suffix("") not in written]
    if older:
        found = f"{first_few([p.relative_to(folder).as_posix() for p in older])} of an earlier one"
        fix = "remove them, or write to another folder"
        raise InvalidValueError(f"{folder}", expected="no other predictions", found=found, fix=fix)
    (Path(folder) / META).unlink(missing_ok=True)  # until all is written, nothing counts
    for (seed, name), vector in labels.items():
        write_prediction(folder, by_name[name], vector, seed=seed, format=format)
    checksums = {name: clip_checksum(clip) for name, clip in by_name.items()}
    write_meta(folder, replace(meta, fingerprints={**checksums, **meta.fingerprints}))
    return Path(folder)


def prediction_files(folder: str | os.PathLike[str]) -> list[Path]:
    """List the files of predictions and failures in a folder, sorted; hidden ones do not count."""
    files = sorted(path for path in Path(folder).rglob("*") if path.suffix.lower() in (*SUFFIXES, FAILED))
    return [path for path in files if not any(p.startswith(".") for p in path.relative_to(folder).parts)]


def bare_labels(values: Any) -> Any:  # noqa: ANN401  # as clip_labels takes them
    """Take the vector out of a Labels or a Segmentation."""
    if isinstance(values, Labels):
        return values.label
    return values.labels if isinstance(values, Segmentation) else values


def prediction_runs(predictions: Any) -> dict[int | None, Mapping[str, Any]]:  # noqa: ANN401
    """Sort out whether predictions are of clips, one run without a seed (None), or of seeds and clips."""
    if not isinstance(predictions, Mapping):
        found = type(predictions).__name__
        raise InvalidValueError("predictions", expected="a mapping of clip names to labels", found=found)
    nested = [isinstance(v, Mapping) and label_table(v, "predictions") is None for v in predictions.values()]
    if predictions and not any(nested):
        return {None: predictions}
    seeds = [
        s for s in predictions if isinstance(s, (int, np.integer)) and not isinstance(s, bool) and s >= 0
    ]
    if not all(nested) or len(seeds) != len(predictions) or not seeds:
        expected = "clip names with their labels, or seeds (0, 1, ...) with these"
        raise InvalidValueError(
            "predictions", expected=expected, found=first_few(list(predictions)) or "none"
        )
    return {int(seed): run for seed, run in predictions.items()}


def check_names(names: Iterable[str], clips: Iterable[str], where: str, *, complete: bool = False) -> None:
    """Refuse predictions of clips that do not exist and, for `complete` ones, clips without predictions."""
    wanted, given = list(clips), list(names)
    extra = [name for name in given if name not in wanted]
    missing = [name for name in wanted if name not in given] if complete else []
    if extra or missing:
        meant = nearest(str(extra[0]), wanted) if extra else ""
        found = f"{first_few(extra)}, which is no clip" if extra else f"nothing for {first_few(missing)}"
        expected, fix = f"labels of {first_few(wanted)}", f"did you mean {meant!r}?" if meant else ""
        raise InvalidValueError(where, expected=expected, found=found, fix=fix)


def clips_by_name(clips: Iterable[Clip]) -> dict[str, Clip]:
    """Return clips by name; InvalidValueError when two have one name, or one is no clip."""
    out: dict[str, Clip] = {}
    for clip in clips:
        if not isinstance(clip, Clip) or clip.name in out:
            found = f"two named {clip.name}" if isinstance(clip, Clip) else type(clip).__name__
            raise InvalidValueError("clips", expected="clips, each of its own name", found=found)
        out[clip.name] = clip
    return out


def file_of(folder: str | os.PathLike[str], clip: str, seed: int | None, ending: str) -> Path:
    """Path of a clip's file in a submission; InvalidValueError when its name cannot be a file name."""
    if not _CLIP_NAME.fullmatch(clip) or ".." in clip:
        raise InvalidValueError(
            "clip name",
            expected="a plain file name: letters, digits, space, '.', '_', '-'",
            found=repr(clip),
            fix="rename the clip",
        )
    return (Path(folder) if seed is None else Path(folder) / f"seed-{seed}") / f"{clip}{ending}"


def _toml(value: object) -> str:
    """Write a value as TOML does: of numbers, texts and lists, as JSON does."""
    known = value if isinstance(value, (bool, int, float, list, tuple)) else str(value)
    return json.dumps(known, ensure_ascii=False, default=str).replace("\x7f", "\\u007f")
