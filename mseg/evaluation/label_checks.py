"""Labels that cannot be meant: counted from 0, all the same, nearly all different."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import Clip, IntArray
from mseg.evaluation.problems import Problem, first_few
from mseg.evaluation.submission import SubmissionMeta


def label_problems(label: IntArray, clip: Clip, file: str, meta: SubmissionMeta) -> list[Problem]:
    """Tell what is wrong with joined labels as labels.

    Parameters
    ----------
    label : (n,) int64
        In the order of ``clip.evaluated``.
    clip : Clip
        The clip that they are for.
    file : str
        Where they come from, for messages.
    meta : SubmissionMeta
        Whether outliers or single labels are meant.
    """
    out = []
    groups = np.unique(label)
    if groups[0] == 0 and not meta.outliers:
        out.append(_zero_label(groups, file, clip.name))
    if len(groups) == 1 and len(label) > 1 and not meta.baseline:
        one = Problem(
            "one-label",
            file,
            clip.name,
            "two motions or more",
            f"all {len(label)} labels are {groups[0]}",
            "look whether the labels were written at all; if it is meant: baseline = true in meta.toml",
        )
        out.append(one)
    if len(groups) > max(2, len(label) // 2):
        out.append(
            Problem(
                "too-many-groups",
                file,
                clip.name,
                "a few groups",
                f"{len(groups)} different labels for {len(label)} trajectories",
                "look whether the columns track and label are swapped",
            )
        )
    return out


def _zero_label(groups: IntArray, file: str, clip: str) -> Problem:
    based = np.array_equal(groups, np.arange(len(groups))) and len(groups) > 1
    return Problem(
        "zero-based" if based else "zero-label",
        file,
        clip,
        "motions 1, 2, ...",
        f"labels {first_few(groups.tolist())}" + (", which look 0-based" if based else ""),
        "add 1 to every label; if 0 is meant as outlier: outliers = true in meta.toml",
    )
