"""Comparing a submission with the data: every problem at once, and the labels that can be scored."""

import itertools
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.files import PathLike
from kt3dmoseg.io.predictions import Problem, is_zero_based, join_labels, numbered
from kt3dmoseg.registry import nearest, strict
from kt3dmoseg.text import count, several
from kt3dmoseg.types import Clip, IntArray
from mseg.evaluation.protocol import Protocol, choose_protocol
from mseg.evaluation.submission import (
    META,
    Submission,
    SubmissionMeta,
    clip_checksum,
    clips_by_name,
    read_submission,
)

# With these a submission is invalid but can be scored: a missing clip counts as fully wrong, a clip
# with one label as what it is. Anything else forbids scoring.
_SCORABLE = frozenset({"missing-clip", "one-label"})
_MORE_ROWS = 10_000  # than four per trajectory of the largest clip: too many to look at


@dataclass(frozen=True, eq=False)
class Validation:
    """What `validate_submission` found."""

    submission: Submission
    protocol: Protocol  # the benchmark against which it was checked
    clips: Mapping[str, Clip]  # the labelled clips that must be predicted
    labels: dict[tuple[int, str], IntArray] = field(default_factory=dict)  # in the order of clip.evaluated
    problems: list[Problem] = field(default_factory=list)  # what makes it invalid
    notes: list[Problem] = field(default_factory=list)  # what is worth knowing but does not

    @cached_property
    def checksums(self) -> dict[str, str]:
        """`clip_checksum` of every clip."""
        return {name: clip_checksum(clip) for name, clip in self.clips.items()}

    @property
    def ok(self) -> bool:
        """Whether the submission is valid."""
        return not self.problems

    @property
    def scorable(self) -> bool:
        """Whether it can be scored: valid, or wrong only in clips that are missing or have one label."""
        return bool(self.clips) and all(problem.code in _SCORABLE for problem in self.problems)

    def fault(self, seed: int, name: str) -> str:
        """Say what forbids scoring the labels of a clip and seed; empty when nothing does."""
        others = {*self.submission.files.values()} - {self.submission.files.get((seed, name), "")}
        grave = (p for p in self.problems if p.clip == name and p.code not in _SCORABLE)
        return next((problem.found for problem in grave if problem.file not in others), "")

    def __str__(self) -> str:
        runs = count(len(self.submission.seeds), "seed")
        what = f"{count(len(self.clips), 'clip')}, {runs}, {self.protocol.title}"
        lines = [f"valid: {what}" if self.ok else f"invalid: {count(len(self.problems), 'problem')}"]
        lines += [numbered(self.problems)] if self.problems else []
        lines += [f"note: {note}" for note in self.notes]
        return "\n".join(lines)

    def as_dict(self) -> dict[str, object]:
        """Give the result as JSON values."""
        return {
            "valid": self.ok,
            "benchmark": self.protocol.name,
            "clips": sorted(self.clips),
            "seeds": self.submission.seeds,
            "sha256": self.submission.sha256,
            "problems": [{"number": i, **asdict(p)} for i, p in enumerate(self.problems, start=1)],
            "notes": [asdict(note) for note in self.notes],
        }


@strict
def validate_submission(
    submission: PathLike | Submission,
    data: PathLike | Mapping[str, Clip] | Iterable[Clip],
    *,
    benchmark: str = "",
) -> Validation:
    """Check a submission against the clips it is for.

    Parameters
    ----------
    submission : path or Submission
        Folder or zip, see `mseg.evaluation.submission`.
    data : path, mapping or iterable of Clip
        The clips; a path is read with `kt3dmoseg.load_dataset` (a single clip file will do).
    benchmark : str
        Name of the protocol; by default the submission's own, else the one its clips belong to.

    Raises
    ------
    InputFileError, UnknownNameError
        When there is nothing at one of the paths, or the data hold no clip; when there is no such benchmark.
        Never for what is wrong inside the submission.
    """
    given = load_clips(data)
    most = _MORE_ROWS + 4 * max((len(clip.dense) for clip in given.values()), default=0)
    read = submission if isinstance(submission, Submission) else read_submission(submission, most=most)
    labelled = [name for name, clip in given.items() if clip.n_motions]
    protocol = choose_protocol(benchmark or read.meta.benchmark, labelled or given)
    clips = {name: clip for name, clip in given.items() if protocol.holds(name) and clip.n_motions}
    out = Validation(read, protocol, clips, problems=list(read.problems))
    if not clips:
        expected, found = f"labelled clips of {protocol.title}", several(list(given), 5) or "none"
        fix = "give the data that the submission is for, or name another benchmark"
        out.problems.append(Problem("no-data", expected=expected, found=found, fix=fix))
    files = {clip: file for (_, clip), file in sorted(read.files.items(), reverse=True)}
    for name in read.clips:
        if name not in clips:
            _check_extra(name, files[name], given, out)
    for seed, name in itertools.product(read.seeds, clips):
        if (seed, name) not in read.files:
            folder = f"seed-{seed}" if len(read.seeds) > 1 else ""
            fix = f"add it, or {name}.failed with the reason; as it is the clip counts as fully wrong"
            out.problems.append(Problem("missing-clip", folder, name, f"a file for clip {name}", "none", fix))
    _check_version(out)
    for (seed, name), file in read.files.items():
        if name in clips:
            _check_labels(seed, name, file, out)
    return out


def load_clips(data: PathLike | Mapping[str, Clip] | Iterable[Clip]) -> dict[str, Clip]:
    """Return clips by name, in the order of their names, from a path, a mapping or clips."""
    if not isinstance(data, (str, os.PathLike)):
        return dict(sorted(clips_by_name(data).items()))
    from kt3dmoseg.io import load, load_dataset
    from kt3dmoseg.io.fields import clip_name

    path = Path(data)
    if (path / META).is_file() or path.suffix == ".json":
        found = "a submission" if path.is_dir() else "scores"
        fix = "on the command line give the data last, to mseg.score(truth, pred) first"
        raise InvalidValueError(f"{path}", expected="the data (a folder of clips)", found=found, fix=fix)
    return (
        {clip_name(path): replace(load(path), name=clip_name(path))} if path.is_file() else load_dataset(path)
    )


def _check_labels(seed: int, name: str, file: str, out: Validation) -> None:
    """Join a prediction to its clip, and keep labels that can be scored."""
    read, clip = out.submission, out.clips[name]
    if (seed, name) in read.failures:
        found, fix = read.failures[seed, name].removeprefix("found "), "it counts as fully wrong"
        out.notes.append(Problem("failed", file, name, found=found, fix=fix))
    elif not read.predictions[seed, name].problems:
        labels, problems = join_labels(read.predictions[seed, name], clip, file)
        if labels is not None:
            problems = list(_label_problems(labels, clip, file, read.meta))
            if all(problem.code in _SCORABLE for problem in problems):
                out.labels[seed, name] = labels
        out.problems.extend(problems)


def _label_problems(label: IntArray, clip: Clip, file: str, meta: SubmissionMeta) -> Iterator[Problem]:
    """Yield what cannot be meant: labels counted from 0, all the same, nearly all different."""
    groups = np.unique(label)
    if groups[0] == 0 and not meta.outliers:
        based = is_zero_based(label)
        found = f"labels {several(groups.tolist(), 5)}" + (", which look 0-based" if based else "")
        fix = "add 1 to every label; if 0 is meant as outlier: outliers = true in meta.toml"
        code = "zero-based" if based else "zero-label"
        yield Problem(code, file, clip.name, "motions 1, 2, ...", found, fix)
    if len(groups) == 1 and min(len(label), clip.n_motions) > 1 and not meta.baseline:
        found = f"all {len(label)} labels are {groups[0]}"
        fix = "check that the labels were written at all; if it is meant: baseline = true in meta.toml"
        yield Problem("one-label", file, clip.name, "two motions or more", found, fix)
    if len(groups) > max(2, len(label) // 2):
        found = f"{len(groups)} different labels for {len(label)} trajectories"
        fix = "check whether the columns track and label are swapped"
        yield Problem("too-many-groups", file, clip.name, "a few groups", found, fix)


def _check_extra(name: str, file: str, given: Mapping[str, Clip], out: Validation) -> None:
    """Report whether a predicted clip that is not scored is a mistake."""
    protocol = out.protocol
    if name in given or protocol.holds(name):
        reason = "no labels for it in the data here"
        if not protocol.holds(name):
            reason = "it never counts" if name in protocol.exclude else f"it is no clip of {protocol.title}"
        out.notes.append(Problem("not-scored", file, name, found=reason))
        return
    stem = name.removesuffix("_Tracks").removesuffix("_truth")
    meant = stem if stem in given else nearest(name, given)
    code, fix = "extra-clip", f"did you mean {meant}?" if meant else "remove it"
    if meant.lower() == name.lower():
        code, fix = "wrong-case", f"rename the file to {meant}"
    out.problems.append(Problem(code, file, name, f"one of {several(list(given), 5)}", name, fix))


def _check_version(out: Validation) -> None:
    """Recognise a submission that was made on other trajectories, by their checksums or the version."""
    meta = out.submission.meta
    for name, found in meta.fingerprints.items():
        if name in out.clips and found != out.checksums[name]:
            expected = f"trajectories with checksum {out.checksums[name]}"
            fix = "the submission was made on another version of the data: segment these trajectories"
            out.problems.append(Problem("dataset-version", META, name, expected, found[:40], fix))
    version = meta.dataset_version
    if version and out.protocol.contradicts(version, out.checksums):
        here = out.protocol.version_of(out.checksums)
        expected = f"dataset_version = {here!r}" if here else "the version of the data given here"
        fix = "segment these data, or validate against the version that was segmented"
        found = f"{version!r}, which these data are not"
        out.problems.append(Problem("dataset-version", META, expected=expected, found=found, fix=fix))
