"""Joining predictions to the evaluated trajectories, by id."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import Clip, IntArray
from mseg.evaluation.problems import Problem, first_few

_SAME = 0.5


def join_labels(
    track: IntArray, label: IntArray, clip: Clip, file: str
) -> tuple[IntArray | None, list[Problem]]:
    """Bring predicted labels into the order of ``clip.evaluated``.

    Parameters
    ----------
    track, label : (m,) int64
        Ids and labels as predicted.
    clip : Clip
        The clip that they are for.
    file : str
        Where they come from, for messages.

    Returns
    -------
    labels : (n,) int64 or None
        None when the ids do not match.
    problems : list of Problem
    """
    wanted = clip.dense.track_id[clip.evaluated]
    problems = []
    ids, first, counts = np.unique(track, return_index=True, return_counts=True)
    if (counts > 1).any():
        twice = ids[counts > 1].tolist()
        problems.append(
            Problem(
                "duplicate-rows",
                file,
                clip.name,
                "each trajectory once",
                f"{len(twice)} given more than once (track {first_few(twice)})",
                "keep one row per trajectory",
            )
        )
    if not np.array_equal(ids, np.sort(wanted)):
        problems.append(_mismatch(ids, label[first], wanted, clip, file))
    if problems:
        return None, problems
    place = np.searchsorted(ids, wanted)
    return label[first][place], []


def _mismatch(ids: IntArray, label: IntArray, wanted: IntArray, clip: Clip, file: str) -> Problem:
    code, found, fix = _usual_mistake(ids, label, wanted, clip) or _difference(ids, wanted)
    return Problem(code, file, clip.name, f"the {len(wanted)} evaluated trajectories", found, fix)


def _usual_mistake(
    ids: IntArray, label: IntArray, wanted: IntArray, clip: Clip
) -> tuple[str, str, str] | None:
    """Recognise what is often written instead of the ids: code, what was found, repair."""
    n, found = len(wanted), len(ids)
    if found > n and np.array_equal(ids, np.sort(clip.dense.track_id)):
        return (
            "all-trajectories",
            f"{found} labels: those are all trajectories of the clip",
            "keep the evaluated ones (clip.dense.track_id[clip.evaluated])",
        )
    if 2 * found < n and np.isin(label, wanted).mean() > _SAME:
        return (
            "swapped-columns",
            "the ids in the column label",
            "swap the columns: track first, then label",
        )
    if found == n and np.array_equal(ids - 1, np.sort(wanted)):
        return (
            "one-based-ids",
            "ids that are each one larger, counted from 1 as in MATLAB",
            "subtract 1 from every track",
        )
    if found == n and ids[0] in (0, 1) and np.array_equal(ids - ids[0], np.arange(n)):
        return (
            "row-numbers",
            f"row numbers {ids[0]}..{ids[-1]} instead of track ids",
            "write clip.dense.track_id[clip.evaluated] as track",
        )
    return None


def _difference(ids: IntArray, wanted: IntArray) -> tuple[str, str, str]:
    """Say which ids are missing and which do not belong: code, what was found, repair."""
    missing, extra = np.setdiff1d(wanted, ids), np.setdiff1d(ids, wanted)
    parts = [
        f"{len(missing)} missing (track {first_few(missing.tolist())})" if len(missing) else "",
        f"{len(extra)} that are not evaluated (track {first_few(extra.tolist())})" if len(extra) else "",
    ]
    found = " and ".join(part for part in parts if part)
    if len(missing) > _SAME * len(wanted):
        fix = "most ids do not fit: these look like labels for another clip or another version of the data"
        return "other-trajectories", found, fix
    return "trajectories", found, "write one row per evaluated trajectory, by its track id"
