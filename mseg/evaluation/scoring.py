"""From labels to scores: one clip, one submission, or two bare vectors; and scores as JSON and back."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from kt3dmoseg import __version__
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.io.predictions import SUFFIXES, Problem, numbered, read_prediction
from kt3dmoseg.registry import unknown_name
from kt3dmoseg.types import Clip, FloatArray, IntArray, Labels
from mseg.errors import RejectedSubmissionError
from mseg.evaluation.contingency import Contingency, contingency
from mseg.evaluation.metrics import all_metrics, evaluate, per_motion
from mseg.evaluation.protocol import (
    Group,
    Protocol,
    count,
    list_protocols,
    load_protocol,
    protocol_of_clips,
)
from mseg.evaluation.statistics import Summary, summarise
from mseg.evaluation.submission import SubmissionMeta
from mseg.evaluation.validation import Validation, validate_submission

FORMAT = "mseg-scores"
VERSION = 1
_MAX_JSON = 64 << 20


@dataclass(frozen=True)
class Provenance:
    """What was scored on what."""

    dataset_version: str  # by name
    dataset_sha256: str  # over names, trajectories and labels of the clips scored
    submission_sha256: str  # over the files of the submission
    toolkit_version: str  # of this package


@dataclass(frozen=True, eq=False)
class ClipScore:
    """Scores of one clip and one seed.

    Parameters
    ----------
    clip, seed : str, int
        Which.
    n_motions, n : int
        True motions and scored trajectories.
    values : mapping of str to float
        Every metric by name.
    n_found : int
        Predicted groups among the scored trajectories.
    prevalence : float
        Classification error of putting every trajectory into the largest motion.
    reason : str
        Why there are no labels; empty when there are.
    table : Contingency or None
        The counts behind the values, where they are at hand.
    """

    clip: str
    seed: int
    n_motions: int
    n: int
    values: Mapping[str, float]
    n_found: int = 0
    prevalence: float = 1.0
    reason: str = ""
    table: Contingency | None = None


_BARE, _UNKNOWN = SubmissionMeta("labels"), Provenance("", "", "", "")


@dataclass(frozen=True, eq=False)
class ScoreTable:
    """All scores of a submission.

    Parameters
    ----------
    clips : tuple of ClipScore
        Every clip and seed; failed and missing ones included.
    meta : SubmissionMeta
        The meta data of the submission.
    protocol : Protocol or None
        The benchmark; None = the clips scored, one group.
    provenance : Provenance
        Versions and hashes.
    problems : tuple of Problem
        What was wrong but did not prevent scoring.
    """

    clips: tuple[ClipScore, ...]
    meta: SubmissionMeta = _BARE
    protocol: Protocol | None = None
    provenance: Provenance = _UNKNOWN
    problems: tuple[Problem, ...] = ()

    def __str__(self) -> str:
        """One line per metric, the mean over clips and seeds."""
        width = max(map(len, self.metrics))
        counts = f"mean over {count(len(self.names), 'clip')} and {count(len(self.seeds), 'seed')}"
        return "\n".join([counts, *(f"{name:<{width}}  {self[name]:.4f}" for name in self.metrics)])

    def __getitem__(self, metric: str) -> float:
        """Mean of a metric over clips and seeds; UnknownNameError when there is no such metric."""
        return float(self.per_clip(metric).mean())

    @property
    def error(self) -> float:
        """Mean classification error over clips and seeds, a fraction."""
        return self["error"]

    @property
    def metrics(self) -> list[str]:
        """Names of the metrics."""
        return list(self.clips[0].values)

    @cached_property
    def names(self) -> list[str]:
        """Names of the clips, in order."""
        return list(dict.fromkeys(c.clip for c in self.clips))

    @cached_property
    def seeds(self) -> list[int]:
        """The seeds, in order."""
        return list(dict.fromkeys(c.seed for c in self.clips))

    @cached_property
    def motions(self) -> dict[str, int]:
        """True number of motions of every clip."""
        return {c.clip: c.n_motions for c in self.clips}

    @property
    def failures(self) -> list[ClipScore]:
        """Clips and seeds without labels."""
        return [c for c in self.clips if c.reason]

    @property
    def benchmark(self) -> Protocol:
        """The protocol, or one made of the clips scored."""
        return self.protocol or protocol_of_clips(self.names)

    @property
    def complete(self) -> bool:
        """Whether the whole benchmark is there and no clip failed."""
        present = sum(map(self.benchmark.holds, self.names))
        return not self.failures and present == self.benchmark.n_clips

    def of(self, clip: str, seed: int | None = None) -> ClipScore:
        """Return the scores of a clip; by default of the first seed."""
        return self._by_key[clip, self.seeds[0] if seed is None else seed]

    def matrix(self, metric: str = "error") -> FloatArray:
        """Values of a metric, (clips, seeds) float64."""
        if metric not in self.clips[0].values:
            raise unknown_name("metric", metric, self.metrics)
        return np.array([[self._by_key[n, s].values[metric] for s in self.seeds] for n in self.names])

    def per_clip(self, metric: str = "error") -> FloatArray:
        """Mean over seeds of a metric, (clips,) float64, in the order of `names`."""
        return np.asarray(self.matrix(metric).mean(axis=1), dtype=np.float64)

    def groups(self) -> Iterator[tuple[Group, list[str]]]:
        """Yield the groups of the protocol and the names of the clips scored in each."""
        for group in self.benchmark.groups:
            yield group, self.benchmark.clips_of(group, self.motions)

    def summary(self, metric: str = "error", clips: list[str] | None = None) -> Summary:
        """Summarise a metric over clips: one or more of `names`, by default all."""
        wanted = self.names if clips is None else clips
        rows = [self.names.index(name) for name in wanted]
        weights = np.array([self.of(name).n for name in wanted], dtype=np.float64)
        return summarise(self.matrix(metric)[rows], weights)

    @cached_property
    def _by_key(self) -> dict[tuple[str, int], ClipScore]:
        return {(c.clip, c.seed): c for c in self.clips}


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
    file = Path(pred) if isinstance(pred, (str, os.PathLike)) else None
    if file is not None and file.suffix.lower() not in (*SUFFIXES, ".txt"):
        data = [truth] if isinstance(truth, Clip) else truth
        return score_submission(file, data, benchmark=benchmark, force=force)
    if isinstance(truth, (str, os.PathLike)):
        from kt3dmoseg.io import load

        truth = load(truth)
    predicted = _vector(pred) if file is None else _labels_of(file, truth)
    name = truth.name if isinstance(truth, Clip) else "clip"
    labels = truth.labels if isinstance(truth, Clip) else truth
    background = labels.background if isinstance(labels, Labels) else None
    table = contingency(_vector(labels), predicted, background=background)
    return ScoreTable(clips=(score_clip(name, 0, table),), provenance=Provenance("", "", "", __version__))


def score_clip(name: str, seed: int, table: Contingency) -> ClipScore:
    """Compute every metric of one clip and seed."""
    prevalence = (table.n - int(table.sizes.max())) / table.n
    found, motions = len(table.groups), len(table.motions)
    return ClipScore(name, seed, motions, table.n, evaluate(table), found, prevalence, table=table)


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
            pred, truth = checked.labels.get((seed, name)), clip.labels
            if pred is None:
                clips.append(failed_clip(name, seed, clip, _reason(checked, seed, name)))
            else:
                table = contingency(truth.label, pred, background=truth.background)
                clips.append(score_clip(name, seed, table))
    meta, problems = checked.submission.meta, tuple(checked.problems)
    return ScoreTable(tuple(clips), meta, checked.protocol, _provenance(checked), problems)


def _provenance(checked: Validation) -> Provenance:
    labels = {n: hashlib.sha256(c.labels.label.tobytes()).hexdigest() for n, c in checked.clips.items()}
    text = "\n".join(f"{name} {checked.checksums[name]} {labels[name]}" for name in sorted(labels))
    known = checked.protocol.version_of(checked.checksums)
    version = known or checked.submission.meta.dataset_version or "unnamed"
    dataset = hashlib.sha256(text.encode()).hexdigest()
    return Provenance(version, dataset, checked.submission.sha256, __version__)


def _reason(checked: Validation, seed: int, name: str) -> str:
    """Give the reason why a clip has no labels."""
    read, key = checked.submission, (seed, name)
    if key in read.failures:
        return f"failed: {read.failures[key]}"
    found = next((p.found for p in checked.problems if p.file == read.files.get(key)), "")
    return f"invalid: {found}" if key in read.files else "missing"


def _vector(value: Any) -> npt.ArrayLike:  # noqa: ANN401
    """Take the labels out of a Labels or Segmentation."""
    for attribute in ("label", "labels"):
        inner = getattr(value, attribute, None)
        if inner is not None and not callable(inner):
            return np.asarray(inner)
    return np.asarray(value)


def _labels_of(file: Path, clip: Any) -> IntArray:  # noqa: ANN401  # checked
    """Read a clip's file of labels: a prediction file of a submission, or text with one label per line."""
    if not isinstance(clip, Clip):
        raise InvalidValueError(
            "truth", expected="a clip or its file, to join ids", found=type(clip).__name__
        )
    if file.suffix.lower() == ".txt":
        from mseg.evaluation.label_import import fit_to_clip, read_label_text

        return fit_to_clip(read_label_text(file), clip, f"{file}")
    try:
        return read_prediction(file, clip)
    except FileFormatError as error:
        raise RejectedSubmissionError(str(error)) from None


# --- scores as JSON, so that they can be kept, compared and ranked without the data ---------------


def to_json(scores: ScoreTable) -> dict[str, Any]:
    """Give all scores as JSON values; fractions stay fractions."""
    groups = {
        group.name: {
            "title": group.title,
            "clips": len(names),
            "clips_in_full": group.n_clips,
            "metrics": {metric: asdict(scores.summary(metric, names)) for metric in scores.metrics if names},
        }
        for group, names in scores.groups()
    }
    return {
        "format": FORMAT,
        "version": VERSION,
        "benchmark": scores.benchmark.name,
        "coverage": scores.benchmark.coverage(scores.names),
        "complete": scores.complete,
        "meta": asdict(scores.meta),
        "provenance": asdict(scores.provenance),
        "seeds": scores.seeds,
        "groups": groups,
        "clips": [_clip_json(score) for score in scores.clips],
        "problems": [asdict(problem) for problem in scores.problems],
    }


def _clip_json(score: ClipScore) -> dict[str, Any]:
    names = ("clip", "seed", "n_motions", "n", "n_found", "prevalence", "reason")
    out = {name: getattr(score, name) for name in names} | {"values": dict(score.values), "motions": []}
    table = score.table
    if table is not None:  # every motion with its group, its confusion and its own scores; not read back
        scores, groups = per_motion(table), table.groups.tolist()
        out["motions"] = [
            {
                "motion": int(motion),
                "n": int(table.sizes[i]),
                "group": groups[table.assignment[i]] if table.assignment[i] >= 0 else None,
                "background": table.background == i,
                "outliers": int(table.unassigned[i]),
                "confusion": dict(zip(map(str, groups), table.counts[i].tolist(), strict=True)),
                **{name: float(values[i]) for name, values in scores.items()},
            }
            for i, motion in enumerate(table.motions)
        ]
    return out


def from_json(content: str | bytes, where: str = "scores") -> ScoreTable:
    """Read what `to_json` wrote, without contingency tables; FileFormatError when it is something else."""
    from pydantic import BaseModel, Field, FiniteFloat, ValidationError, model_validator

    class OneClip(BaseModel):
        clip: str
        seed: int
        n_motions: int
        n: int
        n_found: int
        prevalence: FiniteFloat
        reason: str
        values: dict[str, FiniteFloat] = Field(min_length=1)

    class Scores(BaseModel):
        format: Literal["mseg-scores"]
        version: Literal[1]
        benchmark: str
        meta: SubmissionMeta
        provenance: Provenance
        clips: list[OneClip] = Field(min_length=1)

        @model_validator(mode="after")
        def check_grid(self) -> Scores:
            runs = [(each.clip, each.seed) for each in self.clips]
            clips, seeds = ({run[i] for run in runs} for i in (0, 1))
            if len(set(runs)) != len(runs) or len(runs) != len(clips) * len(seeds):
                raise ValueError("not every clip for every seed, once")
            if len({tuple(each.values) for each in self.clips}) != 1:
                raise ValueError("clips with different metrics")
            return self

    try:
        read = Scores.model_validate_json(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        found = ": ".join(part for part in (".".join(map(str, first["loc"])), first["msg"]) if part)[:120]
        expected = "scores as 'mseg score --json' writes them"
        raise FileFormatError(where, expected=expected, found=found) from None
    clips = tuple(ClipScore(**dict(clip)) for clip in read.clips)
    protocol = load_protocol(read.benchmark) if read.benchmark in list_protocols() else None
    return ScoreTable(clips, read.meta, protocol, read.provenance)


def load_scores(path: str | os.PathLike[str]) -> ScoreTable:
    """Read a file written by ``mseg score --json``."""
    return from_json(read_bytes(path, _MAX_JSON), os.fspath(path))
