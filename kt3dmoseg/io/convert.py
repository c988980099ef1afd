"""From one format to another, telling what the target cannot hold."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.io.formats import CLIP_SUFFIXES, load, save
from kt3dmoseg.types import Clip


def convert(source: str | os.PathLike[str], target: str | os.PathLike[str]) -> list[str]:
    """Convert a clip or a flow field; the suffix of `target` names the format.

    The file is read back and compared with what went in.

    Parameters
    ----------
    source : path
        A clip, or a flow field when `target` is ``.flo``, ``.png`` or ``.npy``.
    target : path
        The file to write.

    Returns
    -------
    list of str
        What did not survive, in words; empty when everything did.

    Raises
    ------
    InputFileError, FileFormatError
        When the source cannot be read or the target cannot be written.
    InvalidValueError
        When the target's suffix is of no format, or source and target are the same file.
    """
    if Path(target).exists() and Path(target).resolve() == Path(source).resolve():
        raise InvalidValueError(os.fspath(target), expected="another file than the source", found="the same")
    if Path(target).suffix.lower() in CLIP_SUFFIXES:
        clip = load(source)
        save(clip, target)
        return _lost(clip, load(target))
    return _convert_flow(source, target)


def _convert_flow(source: str | os.PathLike[str], target: str | os.PathLike[str]) -> list[str]:
    from kt3dmoseg.io.flow_files import FLOW_SUFFIXES, read_flow, write_flow

    if Path(target).suffix.lower() not in FLOW_SUFFIXES:
        known = ", ".join(dict.fromkeys((*CLIP_SUFFIXES, *FLOW_SUFFIXES)))
        raise InvalidValueError(
            os.fspath(target), expected=f"a suffix of {known}", found=repr(Path(target).suffix)
        )
    field = read_flow(source)
    write_flow(target, field)
    error = np.abs(read_flow(target).astype(np.float64) - field)
    worst = float(np.nanmax(error, initial=0.0))
    return [f"displacements are rounded by up to {worst:.4f} px"] if worst > 0 else []


def _lost(before: Clip, after: Clip) -> list[str]:
    b, a = before.dense, after.dense
    same = {
        "name": before.name == after.name,
        "coordinates": np.array_equal(b.xy, a.xy, equal_nan=True),
        "track ids": np.array_equal(b.track_id, a.track_id),
        "image size": b.image_size == a.image_size,
        "which trajectories are evaluated": np.array_equal(before.evaluated, after.evaluated),
        "labels": np.array_equal(before.labels.label, after.labels.label),
        "which label is the background": before.labels.background == after.labels.background,
        "names of the motions": dict(before.labels.names) == dict(after.labels.names),
        "frame numbers": np.array_equal(before.frame_numbers, after.frame_numbers),
        "timestamps": _same(before.timestamps, after.timestamps),
        "camera": _same_camera(before, after),
        "provenance": dict(before.provenance) == dict(after.provenance),
    }
    return [what for what, kept in same.items() if not kept]


def _same(first: object, second: object) -> bool:
    if first is None or second is None:
        return first is second
    return bool(np.array_equal(np.asarray(first), np.asarray(second)))


def _same_camera(before: Clip, after: Clip) -> bool:
    if before.camera is None or after.camera is None:
        return before.camera is after.camera
    return before.camera.name == after.camera.name and _same(before.camera.K, after.camera.K)
