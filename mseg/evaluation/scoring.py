"""From labels to scores: one clip, one submission, or two bare vectors."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg import __version__
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import Clip, Labels
from mseg.errors import RejectedSubmissionError
from mseg.evaluation.contingency import Contingency, contingency
from mseg.evaluation.label_file import LABEL_FILES, read_label_file
from mseg.evaluation.layout import count
from mseg.evaluation.metrics import all_metrics
from mseg.evaluation.problems import numbered
from mseg.evaluation.results import ClipScore, Provenance, ScoreTable
from mseg.evaluation.submission import fingerprint
from mseg.evaluation.validate import Validation, validate_submission

_Path = (str, os.PathLike)


def score(
    *,
    truth: Any,  # noqa: ANN401  # labels in any of the forms below
    pred: Any,  # noqa: ANN401
    benchmark: str = "",
    force: bool = False,
) -> ScoreTable:
    """Score predictions against the truth.

    Parameters
    ----------
    truth : (n,) array of int, Labels, Clip or path
        True labels, 0 = not scored; or a clip; or a data file or folder.
    pred : (n,) array of int, Segmentation, Labels or path
        Predicted labels in the same order, 0 = outlier; or, with truth a path or clip, a
        submission, or one clip's file of labels.
    benchmark : str
        Protocol of a submission; by default its own.
    force : bool
        Score a submission that is invalid: clips with problems count as fully wrong.

    Returns
    -------
    ScoreTable
        ``table.error`` is the classification error (a fraction), ``table["nmi"]`` any other metric.

    Raises
    ------
    InvalidValueError
        When bare vectors are no labels or differ in length.
    RejectedSubmissionError
        When a submission is invalid and not `force`.
    InputFileError
        When a path does not exist.

    Examples
    --------
    >>> score(truth=[1, 1, 1, 2, 2, 0], pred=[4, 4, 7, 7, 7, 4]).error
    0.2
    """
    label_file = isinstance(pred, _Path) and Path(pred).suffix.lower() in LABEL_FILES
    if isinstance(pred, _Path) and not label_file:
        data = [truth] if isinstance(truth, Clip) else truth
        return score_submission(pred, data, benchmark=benchmark, force=force)
    if isinstance(truth, _Path):
        from kt3dmoseg.io import load

        truth = load(truth)
    if label_file:
        pred = read_label_file(pred, truth)
    name = truth.name if isinstance(truth, Clip) else "clip"
    labels = truth.labels if isinstance(truth, Clip) else truth
    background = labels.background if isinstance(labels, Labels) else None
    table = contingency(_vector(labels), _vector(pred), background=background)
    return ScoreTable(clips=(score_clip(name, 0, table),), provenance=Provenance("", "", "", __version__))


def score_clip(name: str, seed: int, table: Contingency) -> ClipScore:
    """Compute every metric of one clip and seed."""
    values = {key: metric(table) for key, metric in all_metrics().items()}
    prevalence = (table.n - int(table.sizes.max())) / table.n
    return ClipScore(
        name, seed, len(table.motions), table.n, values, len(table.groups), prevalence, table=table
    )


def failed_clip(name: str, seed: int, clip: Clip, reason: str) -> ClipScore:
    """Give a failed or missing clip the worst value of every metric."""
    values = {key: metric.worst(clip.n_motions) for key, metric in all_metrics().items()}
    sizes = np.bincount(clip.labels.label)[1:]
    n = int(sizes.sum())
    return ClipScore(name, seed, clip.n_motions, n, values, 0, (n - int(sizes.max())) / n, reason)


def score_submission(
    submission: str | os.PathLike[str],
    data: str | os.PathLike[str] | Mapping[str, Clip] | Iterable[Clip],
    *,
    benchmark: str = "",
    force: bool = False,
) -> ScoreTable:
    """Validate a submission and score it.

    A missing clip, or one on which the method failed, gets the worst score. Any other problem
    makes the submission invalid.

    Parameters
    ----------
    submission : path
        Folder or zip.
    data : path, mapping or iterable of Clip
        The clips with their labels.
    benchmark : str
        Protocol; by default the submission's own.
    force : bool
        Score an invalid submission: clips with problems count as fully wrong.

    Raises
    ------
    RejectedSubmissionError
        With all problems, numbered; never when `force`, unless there is nothing to score.
    """
    return score_validated(validate_submission(submission, data, benchmark=benchmark), force=force)


def score_validated(checked: Validation, *, force: bool = False) -> ScoreTable:
    """Score what `validate_submission` found; see `score_submission`."""
    if not checked.scorable and not (force and checked.clips):
        raise RejectedSubmissionError(
            f"submission rejected, {count(len(checked.problems), 'problem')}: {numbered(checked.problems)}"
        )
    clips = []
    for seed in checked.submission.seeds or [0]:
        for name, clip in checked.clips.items():
            if (seed, name) in checked.labels:
                table = contingency(
                    clip.labels.label, checked.labels[seed, name], background=clip.labels.background
                )
                clips.append(score_clip(name, seed, table))
            else:
                clips.append(failed_clip(name, seed, clip, _reason(checked, seed, name)))
    return ScoreTable(
        tuple(clips),
        checked.submission.meta,
        checked.protocol,
        provenance_of(checked),
        tuple(checked.problems),
    )


def provenance_of(checked: Validation) -> Provenance:
    """Say what was scored on what, with which version of the toolkit."""
    prints = {name: fingerprint(clip) for name, clip in checked.clips.items()}
    labels = {n: hashlib.sha256(c.labels.label.tobytes()).hexdigest() for n, c in checked.clips.items()}
    text = "\n".join(f"{name} {prints[name]} {labels[name]}" for name in sorted(prints))
    version = checked.protocol.version_of(prints) or checked.submission.meta.dataset_version or "unnamed"
    return Provenance(
        version, hashlib.sha256(text.encode()).hexdigest(), checked.submission.sha256, __version__
    )


def _reason(checked: Validation, seed: int, name: str) -> str:
    if (seed, name) in checked.submission.failures:
        return f"failed: {checked.submission.failures[seed, name]}"
    file = checked.submission.files.get((seed, name))
    if file is None:
        return "missing"
    found = next((p for p in checked.problems if p.file == file), None)
    return f"invalid: {found.found}" if found else "invalid"


def _vector(value: Any) -> npt.ArrayLike:  # noqa: ANN401
    """Take the labels out of a Labels or Segmentation."""
    for attribute in ("label", "labels"):
        inner = getattr(value, attribute, None)
        if inner is not None and not callable(inner):
            return np.asarray(inner)
    if isinstance(value, Path):
        raise InvalidValueError("labels", expected="an array", found="a path")
    return np.asarray(value)
