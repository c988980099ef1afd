"""Comparing a submission with the data: every problem at once, and the labels that are sound."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from kt3dmoseg.registry import nearest
from kt3dmoseg.types import Clip, IntArray
from mseg.evaluation.joining import join_labels
from mseg.evaluation.label_checks import label_problems
from mseg.evaluation.layout import count
from mseg.evaluation.problems import Problem, first_few, numbered
from mseg.evaluation.protocol import (
    Protocol,
    guess_protocol,
    list_protocols,
    load_protocol,
    protocol_of_clips,
)
from mseg.evaluation.reading import Submission, read_submission
from mseg.evaluation.submission import META, fingerprint

# With these a submission is invalid but can be scored: a missing clip counts as fully wrong, a clip
# with one label as what it is. Anything else forbids scoring.
_SCORABLE = frozenset({"missing-clip", "one-label"})


@dataclass(frozen=True, eq=False)
class Validation:
    """What `validate_submission` found.

    Parameters
    ----------
    submission : Submission
        What was read.
    protocol : Protocol
        The benchmark against which it was checked.
    clips : mapping of str to Clip
        The labelled clips that must be predicted.
    labels : mapping of (seed, clip) to (n,) int64
        Sound predictions in the order of ``clip.evaluated``.
    problems, notes : list of Problem
        What makes it invalid; what is worth knowing but does not.
    """

    submission: Submission
    protocol: Protocol
    clips: Mapping[str, Clip]
    labels: Mapping[tuple[int, str], IntArray] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    notes: list[Problem] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        """Whether the submission is valid."""
        return not self.problems

    @property
    def scorable(self) -> bool:
        """Whether it can be scored: valid, or wrong only in clips that are missing or have one label."""
        return bool(self.clips) and all(problem.code in _SCORABLE for problem in self.problems)

    def __str__(self) -> str:
        """Give the verdict, the numbered problems and the notes."""
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
            "problems": [{"number": i, **p.as_dict()} for i, p in enumerate(self.problems, start=1)],
            "notes": [note.as_dict() for note in self.notes],
        }


def validate_submission(
    submission: str | os.PathLike[str] | Submission,
    data: str | os.PathLike[str] | Mapping[str, Clip] | Iterable[Clip],
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

    Returns
    -------
    Validation
        Never raises for what is wrong inside the submission.

    Raises
    ------
    InputFileError
        When there is nothing at one of the paths, or the data hold no clip.
    UnknownNameError
        When there is no such benchmark.
    """
    read = submission if isinstance(submission, Submission) else read_submission(submission)
    given = load_clips(data)
    own = read.meta.benchmark if read.meta.benchmark in ("custom", *list_protocols()) else ""
    protocol = choose_protocol(benchmark or own, given)
    counted = {name: clip for name, clip in given.items() if protocol.holds(name)}
    checker = _Checker(read, protocol, given, counted)
    checker.check()
    return Validation(read, protocol, checker.clips, checker.labels, checker.problems, checker.notes)


def load_clips(data: str | os.PathLike[str] | Mapping[str, Clip] | Iterable[Clip]) -> dict[str, Clip]:
    """Return clips by name, in the order of their names, from a path, a mapping or clips."""
    if isinstance(data, (str, os.PathLike)):
        from kt3dmoseg.io import load, load_dataset

        if os.path.isfile(data):  # noqa: PTH113  # a str or path in
            clip = load(data)
            return {clip.name: clip}
        return load_dataset(data)
    by_name = dict(data) if isinstance(data, Mapping) else {clip.name: clip for clip in data}
    return dict(sorted(by_name.items()))


def choose_protocol(name: str, clips: Iterable[str]) -> Protocol:
    """Return the protocol of that name; without one, the protocol that the clips belong to."""
    names = list(clips)
    if name == "custom":
        return protocol_of_clips(names)
    if not name:
        return guess_protocol(names)
    return load_protocol(name)


class _Checker:
    def __init__(
        self, read: Submission, protocol: Protocol, given: Mapping[str, Clip], counted: Mapping[str, Clip]
    ) -> None:
        self.read, self.protocol, self.given = read, protocol, given
        self.clips = {name: clip for name, clip in counted.items() if clip.n_motions}
        self.labels: dict[tuple[int, str], IntArray] = {}
        self.problems, self.notes = list(read.problems), list[Problem]()

    def check(self) -> None:
        self._check_data()
        self._check_names()
        self._check_fingerprints()
        for (seed, name), prediction in self.read.predictions.items():
            clip = self.clips.get(name)
            if clip is None or prediction.problems:
                continue
            file = self.read.files[seed, name]
            found, problems = join_labels(prediction.track, prediction.label, clip, file)
            if found is not None:
                problems += label_problems(found, clip, file, self.read.meta)
            self.problems += problems
            if found is not None and all(problem.code in _SCORABLE for problem in problems):
                self.labels[seed, name] = found
        self.notes += [
            Problem("failed", self.read.files[key], key[1], found=reason, fix="it counts as fully wrong")
            for key, reason in self.read.failures.items()
            if key[1] in self.clips
        ]

    def _check_data(self) -> None:
        if not self.clips:
            self.problems.append(
                Problem(
                    "no-data",
                    expected=f"labelled clips of {self.protocol.title}",
                    found=first_few(list(self.given)) or "none",
                    fix="give the data that the submission is for, or another --benchmark",
                )
            )

    def _check_names(self) -> None:
        if not self.read.seeds:
            return
        here = set(self.clips)
        for name in self.read.clips:
            if name not in here:
                self._extra(name)
        for seed in self.read.seeds:
            for name in self.clips:
                key = (seed, name)
                if key not in self.read.predictions and key not in self.read.failures:
                    self._missing(seed, name)

    def _extra(self, name: str) -> None:
        file = next(file for (_, clip), file in self.read.files.items() if clip == name)
        same = next((n for n in self.given if n.lower() == name.lower()), None)
        if name in self.given or self.protocol.holds(name):
            reason = (
                "it never counts" if name in self.protocol.exclude else "no labels for it in the data here"
            )
            self.notes.append(Problem("not-scored", file, name, found=reason))
        elif same:
            self.problems.append(
                Problem("wrong-case", file, name, f"the name {same}", name, f"rename the file to {same}")
            )
        else:
            self.problems.append(_extra_clip(file, name, list(self.given)))

    def _missing(self, seed: int, name: str) -> None:
        place = f"seed-{seed}" if len(self.read.seeds) > 1 else ""
        self.problems.append(
            Problem(
                "missing-clip",
                place,
                name,
                f"a file for clip {name}",
                "none",
                f"add it, or {name}.failed with the reason; as it is the clip counts as fully wrong",
            )
        )

    def _check_fingerprints(self) -> None:
        """Tell a submission that was made on other trajectories, by fingerprint or version."""
        if not self.clips:
            return
        declared, version = self.read.meta.fingerprints, self.read.meta.dataset_version
        prints = {name: fingerprint(clip) for name, clip in self.clips.items()}
        for name, value in declared.items():
            if name in prints and value != prints[name]:
                self.problems.append(_other_data(name, prints[name], value))
        if version and self.protocol.contradicts(version, prints):
            here = self.protocol.version_of(prints)
            self.problems.append(
                Problem(
                    "dataset-version",
                    META,
                    expected=f"dataset_version = {here!r}" if here else "the version of the data given here",
                    found=f"{version!r}, which these data are not",
                    fix="segment these data, or validate against the version that was segmented",
                )
            )


def _other_data(name: str, here: str, found: str) -> Problem:
    return Problem(
        "dataset-version",
        META,
        name,
        f"trajectories with fingerprint {here}",
        str(found)[:40],
        "the submission was made on another version of the data: segment these trajectories",
    )


def _extra_clip(file: str, name: str, known: list[str]) -> Problem:
    stem = name.removesuffix("_Tracks").removesuffix("_truth")
    meant = stem if stem in known else nearest(name, known)
    fix = f"did you mean {meant}?" if meant else "remove it"
    return Problem("extra-clip", file, name, f"one of {first_few(known)}", name, fix)
