"""From labels to scores: one clip, one submission, or two bare vectors; and scores as JSON and back."""

from __future__ import annotations

import hashlib
import math
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import numpy as np

from kt3dmoseg import __version__
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import PathLike, parse_json, read_bytes
from kt3dmoseg.io import predictions
from kt3dmoseg.io.fields import check_name
from kt3dmoseg.registry import strict, unknown_name
from kt3dmoseg.text import count, several
from kt3dmoseg.types import Clip, FloatArray, IntArray, Labels, Trajectories
from mseg.errors import RejectedSubmissionError
from mseg.evaluation.contingency import Contingency, contingency
from mseg.evaluation.metrics import METRICS, all_metrics, evaluate, per_motion
from mseg.evaluation.protocol import (
    Group,
    Protocol,
    choose_protocol,
    list_protocols,
    load_protocol,
    protocol_of_clips,
)
from mseg.evaluation.statistics import Summary, summarise
from mseg.evaluation.submission import (
    SubmissionMeta,
    bare_labels,
    check_names,
    clip_checksum,
    prediction_runs,
    wrong_fields,
)
from mseg.evaluation.validation import Validation, load_clips, validate_submission
from mseg.types import Segmentation

if TYPE_CHECKING:
    import pandas as pd
    import xarray
    from matplotlib.axes import Axes
    from pydantic import BaseModel

    ModelT = TypeVar("ModelT", bound=BaseModel)

_TABLE = "table"  # format of a clip made of tracks and their labels
_MAX_JSON, _MAX_VALUES, _MAX_MEMBERS = 16 << 20, 1_000_000, 5_000


@dataclass(frozen=True)
class Provenance:
    """What was scored on what."""

    dataset_version: str  # by name
    dataset_sha256: str  # over names, trajectories and labels of the clips scored
    submission_sha256: str  # over the files of the submission
    toolkit_version: str  # of this package


@dataclass(frozen=True, eq=False)
class ClipScore:
    """Scores of one clip and one seed."""

    clip: str
    seed: int
    n_motions: int  # true ones
    n: int  # scored trajectories
    n_found: int  # predicted groups among the scored trajectories
    prevalence: float  # classification error of putting every trajectory into the largest motion
    reason: str  # why there are no labels; empty when there are
    values: Mapping[str, float]  # every metric by name
    table: Contingency | None = None  # the counts behind the values, where they are at hand


_BARE, _UNKNOWN = SubmissionMeta("labels"), Provenance("", "", "", "")


@dataclass(frozen=True, eq=False)
class ScoreTable:
    """All scores of a submission."""

    clips: tuple[ClipScore, ...]  # every clip and seed; failed and missing ones included
    meta: SubmissionMeta = _BARE
    protocol: Protocol | None = None  # the benchmark; None = the clips scored, one group
    provenance: Provenance = _UNKNOWN
    problems: tuple[predictions.Problem, ...] = ()  # what was wrong but did not prevent scoring

    def __repr__(self) -> str:
        where = f"{self.benchmark.title}, {self.benchmark.coverage(self.names)}"
        seeds = count(len(self.seeds), "seed")
        return f"ScoreTable({self.meta.method} on {where}, {seeds}: error {100 * self.error:.2f} %)"

    def __str__(self) -> str:
        """One line per metric, the mean over clips and seeds."""
        width = max(map(len, self.metrics))
        counts = f"mean over {count(len(self.names), 'clip')} and {count(len(self.seeds), 'seed')}"
        return "\n".join([counts, *(f"{name:<{width}}  {self[name]:.4f}" for name in self.metrics)])

    def _repr_html_(self) -> str:
        from mseg.evaluation.results import headline, per_clip

        return headline(self).html() + per_clip(self).html()

    def plot(self, metric: str = "error", *, ax: Axes | None = None) -> Axes:
        """Plot a metric of every clip with matplotlib (the extra ``plot``): mean, least and most over seeds.

        UnknownNameError when there is no such metric; MissingDependencyError without matplotlib.
        """
        from mseg.evaluation.results import plot_metric

        return plot_metric({self.meta.method: self}, metric, ax=ax)

    def to_dataframe(self) -> pd.DataFrame:
        """Give one row per clip and seed: counts, `prevalence`, `reason`, and every metric (no per cent)."""
        import pandas as pd

        return pd.DataFrame([vars(c) | dict(c.values) for c in self.clips]).drop(columns=["values", "table"])

    def to_xarray(self) -> xarray.Dataset:
        """Give what `to_dataframe` gives as variables over `clip` and `seed`; ImportError without xarray."""
        return self.to_dataframe().set_index(["clip", "seed"]).to_xarray()

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
        """Return the scores of a clip, by default of the first seed; UnknownNameError when there are none."""
        key = clip, self.seeds[0] if seed is None else seed
        if key not in self._by_key:
            known = clip in self.names
            names = map(str, self.seeds) if known else self.names
            raise unknown_name("seed" if known else "clip", seed if known else clip, names)
        return self._by_key[key]

    def matrix(self, metric: str = "error", clips: Iterable[str] | None = None) -> FloatArray:
        """Values of a metric, (clips, seeds) float64; `clips` are some of `names`, by default all."""
        if metric not in self.clips[0].values:
            raise unknown_name("metric", metric, self.metrics)
        names = self.names if clips is None else clips
        return np.array([[self.of(n, s).values[metric] for s in self.seeds] for n in names])

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
        return summarise(self.matrix(metric, wanted), [self.of(name).n for name in wanted])

    @cached_property
    def _by_key(self) -> dict[tuple[str, int], ClipScore]:
        return {(c.clip, c.seed): c for c in self.clips}


@strict
def score(
    truth: Any,  # noqa: ANN401  # labels in any of the forms below
    pred: Any,  # noqa: ANN401
    *,
    benchmark: str = "",
    force: bool = False,
    outliers: bool = False,
) -> ScoreTable:
    """Score predictions against the truth.

    Parameters
    ----------
    truth : (n,) array of int, Labels, Clip, table, path, or mapping of clip names to these
        True labels, 0 = not scored; an array that may count from 0 warns; of mostly 0, it is refused. A
        table has the columns `track` and `label`; a path leads to a data file or folder.
    pred : (n,) array of int, Segmentation, Labels, table, path, or mapping of clip names to these
        Predicted labels 1, 2, ..., in the order of the truth; those of a table (or an indexed series) are
        joined by track. A mapping may also be of seeds to such mappings. A path leads to a submission or
        to one clip's file of labels.
    benchmark : str
        Protocol; by default a submission's own, or the one that the clips belong to.
    force : bool
        Score a submission that is invalid: clips with problems count as fully wrong.
    outliers : bool
        Label 0 in `pred` is meant as "outlier", which is always wrong, as it is in a Segmentation. Otherwise
        0 is refused as a sign of labels that count from 0.

    Returns
    -------
    ScoreTable
        ``table.error`` is the classification error (a fraction), ``table["nmi"]`` any other metric.

    Raises
    ------
    InvalidValueError, RejectedSubmissionError, InputFileError
        When labels are no whole numbers >= 0, are not of the same trajectories or clips, or hold a 0; when a
        submission is invalid and not `force`; when a path does not exist.

    Examples
    --------
    >>> score(Labels(np.array([1, 1, 1, 2, 2, 0])), [4, 4, 7, 7, 7, 4]).error
    0.2
    """
    file = Path(pred) if isinstance(pred, (str, os.PathLike)) else None
    if file is not None and file.suffix.lower() not in (*predictions.SUFFIXES, ".txt"):
        data = [truth] if isinstance(truth, Clip) else truth
        return score_submission(file, data, benchmark=benchmark, force=force)
    truths = _truths(truth)
    if isinstance(pred, Mapping) and predictions.label_table(pred, "pred") is None:
        runs = prediction_runs(pred)
    elif len(truths) == 1:
        runs = {None: dict.fromkeys(truths, pred)}
    elif file is not None and file.stem in truths:
        truths = {file.stem: truths[file.stem]}
        runs = {None: {file.stem: file}}
    else:
        expected = f"a mapping of clip names to labels, for {several(list(truths), 5)}"
        raise InvalidValueError("pred", expected=expected, found=type(pred).__name__)
    clips, given = [], hashlib.sha256()
    for seed, run in runs.items():
        check_names(run, truths, "pred", complete=True)
        for name, clip in truths.items():
            where = "pred" if len(truths) == 1 else f"pred of {name}"
            predicted = _predicted(run[name], clip, where, outliers=outliers)
            given.update(f"{name} {seed} {predicted.tolist()}\n".encode())
            clips.append(clip_score(name, seed or 0, _labels(clip), predicted))
    protocol = choose_protocol(benchmark, truths) if benchmark else None
    foreign = [name for name in truths if protocol and not protocol.holds(name)]
    if foreign:
        raise InvalidValueError("truth", expected=f"clips of {benchmark}", found=several(foreign, 5))
    checksums = {name: clip_checksum(clip) for name, clip in truths.items() if isinstance(clip, Clip)}
    source = provenance_of(truths, checksums, submission=given.hexdigest())
    return ScoreTable(tuple(clips), protocol=protocol, provenance=source)


def _truths(truth: Any) -> dict[str, Clip | Labels]:  # noqa: ANN401  # checked
    """Clips, or bare labels, by name."""
    if isinstance(truth, Mapping) and predictions.label_table(truth, "truth") is None:
        return {name: _truth(value, f"truth of {name}", name) for name, value in truth.items()}
    if isinstance(truth, (str, os.PathLike)):
        return {**load_clips(truth)}
    clips = truth if isinstance(truth, (list, tuple)) else [truth]
    if clips and all(isinstance(each, Clip) for each in clips):
        return {**load_clips(clips)}
    return {"clip": _truth(truth, "truth", "clip")}


def _truth(value: Any, where: str, name: str) -> Clip | Labels:  # noqa: ANN401  # checked
    if isinstance(value, (Clip, Labels)):
        return value
    table = predictions.label_table(value, where)
    if table is None:
        label = predictions.label_vector(value, where)
        if predictions.is_zero_based(label):
            zeros, fix = np.bincount(label), "add 1 if they count from 0, or give Labels(truth)"
            found = f"label 0, which is not scored, at {zeros[0]} of {len(label)}"
            if zeros.argmax() == 0:
                raise InvalidValueError(where, expected="labels 1, 2, ...", found=found, fix=fix)
            warnings.warn(f"{where}: {found}; {fix}", stacklevel=2)
        return Labels(label)
    n = len(table.columns["track"])
    tracks = Trajectories(
        np.full((n, 1, 2), np.nan), np.zeros((n, 1), dtype=np.bool_), table.columns["track"]
    )
    return Clip(name, tracks, np.arange(n), Labels(table.columns["label"]), provenance={"format": _TABLE})


def _labels(truth: Clip | Labels) -> Labels:
    return truth.labels if isinstance(truth, Clip) else truth


def _predicted(value: Any, truth: Clip | Labels, where: str, *, outliers: bool) -> IntArray:  # noqa: ANN401
    """Predicted labels in the order of the truth, (n,)."""
    if isinstance(value, (Labels, Segmentation)):  # there 0 has a meaning
        value, outliers = bare_labels(value, truth), True
    if isinstance(value, (str, os.PathLike)):
        label = _labels_of(Path(value), truth)
    elif isinstance(truth, Clip):
        shuffled = truth.provenance.get("format") == _TABLE and np.any(np.diff(truth.dense.track_id) < 0)
        if shuffled and predictions.label_table(value, where) is None:
            expected = "a table of tracks, as truth is one in no order"
            raise InvalidValueError(where, expected=expected, found="a vector")
        label = predictions.clip_labels(value, truth, where)
    elif predictions.label_table(value, where) is not None:
        expected, fix = "a vector, as truth is", "give truth as a clip, or as a table with the same tracks"
        raise InvalidValueError(where, expected=expected, found="a table of tracks", fix=fix)
    else:
        label = predictions.label_vector(value, where)
    if not outliers and (label == 0).any():
        found = f"label 0 of {int((label == 0).sum())} in {len(label)} trajectories"
        fix = "add 1 to all labels if they count from 0; if 0 is an outlier: outliers=True"
        raise InvalidValueError(where, expected="labels 1, 2, ...", found=found, fix=fix)
    return label


def _labels_of(file: Path, clip: Clip | Labels) -> IntArray:
    """Read a clip's file of labels: a prediction file of a submission, or text with one label per line."""
    if not isinstance(clip, Clip):
        raise InvalidValueError("truth", expected="a clip or its file, to join ids", found="bare labels")
    if file.suffix.lower() == ".txt":
        from mseg.evaluation.example import fit_to_clip, read_label_text

        return fit_to_clip(read_label_text(file), clip, f"{file}")
    try:
        return predictions.read_prediction(file, clip)
    except FileFormatError as error:
        raise RejectedSubmissionError(str(error)) from None


def clip_score(
    name: str, seed: int, truth: Labels, predicted: IntArray | None, reason: str = ""
) -> ClipScore:
    """Compute every metric of one clip and seed; without labels each has its worst value, for a `reason`."""
    given = truth.label if predicted is None else predicted
    table = contingency(truth.label, given, background=truth.background)
    n, motions = table.n, len(table.motions)
    prevalence = (n - int(table.sizes.max())) / n
    if predicted is None:
        worst = {key: metric.worst(motions) for key, metric in all_metrics().items()}
        return ClipScore(name, seed, motions, n, 0, prevalence, reason, worst)
    return ClipScore(name, seed, motions, n, len(table.groups), prevalence, "", evaluate(table), table)


def score_submission(
    submission: PathLike,
    data: PathLike | Mapping[str, Clip] | Iterable[Clip],
    *,
    benchmark: str = "",
    force: bool = False,
) -> ScoreTable:
    """Validate a submission, as `validate_submission` does, and score it.

    A missing clip, or one on which the method failed, gets the worst score. Any other problem makes the
    submission invalid: RejectedSubmissionError names all problems, unless `force` counts the clips with
    problems as fully wrong.
    """
    return score_validated(validate_submission(submission, data, benchmark=benchmark), force=force)


def score_validated(checked: Validation, *, force: bool = False) -> ScoreTable:
    """Score what `validate_submission` found; see `score_submission`."""
    if not checked.scorable and not (force and checked.clips):
        wrong = f"{count(len(checked.problems), 'problem')}: {predictions.numbered(checked.problems)}"
        raise RejectedSubmissionError(f"submission rejected, {wrong}")
    clips, read = [], checked.submission
    for seed in read.seeds or [0]:
        for name, clip in checked.clips.items():
            fault, failure = checked.fault(seed, name), read.failures.get((seed, name))
            reason = f"invalid: {fault}" if fault else f"failed: {failure}" if failure else "missing"
            pred = None if fault else checked.labels.get((seed, name))
            clips.append(clip_score(name, seed, clip.labels, pred, reason))
    meta, problems = read.meta, tuple(checked.problems)
    version = checked.protocol.version_of(checked.checksums) or meta.dataset_version or "unnamed"
    source = provenance_of(checked.clips, checked.checksums, version, read.sha256)
    return ScoreTable(tuple(clips), meta, checked.protocol, source, problems)


def provenance_of(
    truths: Mapping[str, Clip | Labels], checksums: Mapping[str, str], version: str = "", submission: str = ""
) -> Provenance:
    """Describe the data that is scored, by names, checksums and labels."""
    hashes = {name: hashlib.sha256(_labels(t).label.tobytes()).hexdigest() for name, t in truths.items()}
    text = "\n".join(f"{name} {checksums.get(name, '')} {hashes[name]}" for name in sorted(hashes))
    return Provenance(version, hashlib.sha256(text.encode()).hexdigest(), submission, __version__)


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
        "format": "mseg-scores",
        "version": 1,
        "benchmark": scores.benchmark.name,
        "coverage": scores.benchmark.coverage(scores.names),
        "complete": scores.complete,
        "meta": asdict(scores.meta),
        "provenance": asdict(scores.provenance),
        "seeds": scores.seeds,
        "groups": groups,
        "clips": [clip_json(score) for score in scores.clips],
        "problems": [asdict(problem) for problem in scores.problems],
    }


def clip_json(score: ClipScore) -> dict[str, Any]:
    """Give the scores of a clip, and of every motion with its group, which are not read back."""
    out, table = {**vars(score), "motions": []}, score.table
    del out["table"]
    if table is not None:
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


@strict
def load_scores(path: PathLike) -> ScoreTable:
    """Read a file written by ``mseg score --json``."""
    return from_json(read_bytes(path, _MAX_JSON), os.fspath(path))


def from_json(content: str | bytes, where: str = "scores") -> ScoreTable:
    """Read what `to_json` wrote, without contingency tables; FileFormatError when it is something else.

    Its figures are claims: those of the clips must be possible, and everything else must be what follows from
    them.
    """
    from pydantic import BaseModel, FailFast, Field

    class Scores(BaseModel, arbitrary_types_allowed=True, allow_inf_nan=False, extra="allow"):
        format: Literal["mseg-scores"]
        version: Literal[1]
        benchmark: str
        meta: SubmissionMeta
        provenance: Provenance
        clips: Annotated[list[ClipScore], FailFast()] = Field(min_length=1)
        problems: list[predictions.Problem] = []

    expected = "scores that 'mseg score' wrote as JSON"
    read = read_model(Scores, content, where, expected)
    protocol = load_protocol(read.benchmark) if read.benchmark in list_protocols() else None
    table = ScoreTable(tuple(read.clips), read.meta, protocol, read.provenance, tuple(read.problems))
    wrong = next(_impossible(table, dict(read)), "")
    if wrong:
        raise FileFormatError(where, expected=expected, found=f"what cannot be true, {wrong:.200}")
    return table


def read_model(model: type[ModelT], content: str | bytes, where: str, expected: str) -> ModelT:
    """Read JSON strictly as a pydantic model; FileFormatError names the first field that is wrong."""
    from pydantic import ValidationError

    try:
        # Whatever is wrong takes memory: it is bounded first.
        parse_json(content, where, _MAX_JSON, values=_MAX_VALUES, members=_MAX_MEMBERS)
        return model.model_validate_json(content, strict=True)
    except FileFormatError as error:
        found = f"{error.found:.160} (expected: {error.expected})"
        raise FileFormatError(where, expected=expected, found=found) from None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        found = ": ".join(part for part in (".".join(map(str, first["loc"])), first["msg"]) if part)
        raise FileFormatError(where, expected=expected, found=found[:200]) from None


def _impossible(table: ScoreTable, claimed: Mapping[str, Any]) -> Iterator[str]:
    """Name the fields whose claims cannot be true."""
    runs = {(c.clip, c.seed) for c in table.clips}
    if not len(runs) == len(table.clips) == len(table.names) * len(table.seeds):
        yield "clips that are not in every seed, once"
        return
    for clip in table.clips:
        where = f"clip {clip.clip} in seed {clip.seed}: "
        if not METRICS.keys() <= clip.values.keys() == set(table.metrics) <= all_metrics().keys():
            yield f"{where}values of the metrics {', '.join(clip.values)}"
            return
        try:
            check_name(clip.clip, "clip")
        except InvalidValueError as error:
            yield str(error)
            return
        yield from _differences(asdict(clip), _corrected(clip, table.of(clip.clip)), where)
    yield from _impossible_source(table, claimed["benchmark"])
    summary = to_json(table)
    for name in ("seeds", "coverage", "complete", "groups"):  # which follow from the others
        if claimed.get(name) is not None:
            yield from _differences(claimed[name], summary[name], f"{name}.")


def _impossible_source(table: ScoreTable, benchmark: str) -> Iterator[str]:
    protocol, source = table.benchmark, table.provenance
    if benchmark not in ("custom", *list_protocols()):
        yield f"benchmark {benchmark!r:.40}"
    foreign = (name for name in table.names if not protocol.holds(name))
    yield from (f"clip {name} in {protocol.title}" for name in foreign)
    checksums = {name: value for name, value in table.meta.fingerprints.items() if name in table.motions}
    if protocol.contradicts(source.dataset_version, checksums):
        yield f"dataset version {source.dataset_version!r}"
    hashes = (source.dataset_sha256, source.submission_sha256)
    if not all(re.fullmatch("([0-9a-f]{64})?", each) for each in hashes):
        yield "provenance, in which a sha256 is none"
    yield from (f"meta.{name}" for name in wrong_fields(asdict(table.meta)))


def _corrected(clip: ClipScore, first: ClipScore) -> dict[str, Any]:
    """Give the figures of a clip as they would have to be; `first` is its first seed."""
    n = min(max(first.n, 1), 2**53)
    motions, found = min(max(first.n_motions, 1), n), min(max(clip.n_found, 0), 0 if clip.reason else n)
    values = {}
    for name, metric in all_metrics().items():
        low, high = metric.bounds
        possible = min(max(clip.values.get(name, low), low), high)
        values[name] = metric.worst(motions) if clip.reason else possible
    if not clip.reason:
        values |= {"error": round(values["error"] * n) / n, "count_error": float(abs(found - motions))}
    seed, prevalence = min(max(clip.seed, 0), 10**18), min(max(first.prevalence, 0.0), 1.0)
    counts = {"seed": seed, "n": n, "n_motions": motions, "n_found": found}
    return counts | {"prevalence": round(prevalence * n) / n, "values": values}


def _differences(claimed: Any, own: Any, where: str) -> Iterator[str]:  # noqa: ANN401  # JSON values
    """Name what is not as it must be; what is left out claims nothing."""
    if isinstance(claimed, Mapping) and isinstance(own, Mapping):
        for name in (claimed.keys() & own.keys()) - {"interval"}:  # which is of numpy's random numbers
            yield from _differences(claimed[name], own[name], f"{where}{name}.")
        return
    numbers = isinstance(claimed, float) and isinstance(own, float)
    if not (math.isclose(claimed, own, rel_tol=1e-9, abs_tol=1e-9) if numbers else claimed == own):
        yield f"{where[:-1]} = {claimed!r:.60} (possible: {own!r:.60})"
