"""What a benchmark run found, and its tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from kt3dmoseg.io.predictions import first_few
from kt3dmoseg.types import FloatArray, IntArray
from mseg.benchmark.tasks import Configuration
from mseg.evaluation import Group, Protocol
from mseg.evaluation.protocol import count, share
from mseg.evaluation.results import ResultsTable, axis_table, clip_table, error_table
from mseg.evaluation.scoring import Provenance

_LISTED = 12  # clips named in a note


def published_name(protocol: Protocol, method: str) -> str:
    """Return the name of a method's row in the published table; empty where it has none.

    Upper and lower case and hyphens do not count (``"tlinkage"`` is T-Linkage), and `one_motion` is the
    prevalence row.
    """
    wanted = "prevalence" if method == "one_motion" else method
    return next((name for name in protocol.published if name.lower().replace("-", "") == wanted), "")


@dataclass(frozen=True, eq=False)
class BenchmarkResult:
    """Errors and times of M configurations x C clips x S seeds."""

    protocol: Protocol
    configurations: tuple[Configuration, ...]  # the rows
    motions: Mapping[str, int]  # clips, in order, and their true numbers of motions
    seeds: tuple[int, ...]
    errors: FloatArray  # (M, C, S): classification error, a fraction; 1 where the method failed
    seconds: FloatArray  # (M, C, S): CPU seconds
    failures: tuple[tuple[Configuration, str, int, str], ...] = ()  # configuration, clip, seed and reason
    others: tuple[str, ...] = ()  # clips that lay there and do not belong to the benchmark
    notes: tuple[tuple[Configuration, str, int, str], ...] = ()  # what `mseg.segment` notes, likewise
    found: IntArray | None = None  # (M, C, S): predicted groups; 0 where the method failed
    scored: Mapping[str, int] = field(
        default_factory=dict
    )  # clips and their numbers of labelled trajectories
    provenance: Provenance | None = None  # of the clips
    number: Literal["given", "found"] = "given"  # whether the methods were given the number of motions

    @property
    def clips(self) -> list[str]:
        """Names of the clips, in order."""
        return list(self.motions)

    def mean(self, method: str, group: str = "all") -> float:
        """Mean error over clips and seeds, a fraction, of the first configuration of that method."""
        row = [c.method for c in self.configurations].index(method)
        clips = self.protocol.clips_of(self.protocol.group(group), self.motions)
        return float(self.errors[row, [self.clips.index(name) for name in clips]].mean())

    def summary(self) -> ResultsTable:
        """One row per configuration: mean, spread over seeds and median of every group, and time."""
        failed = [str(sum(c == wrong for wrong, *_ in self.failures)) for c in self.configurations]
        known = (published_name(self.protocol, c.method) for c in self.configurations)
        return error_table(
            f"{self._heading()}: classification error in %",
            self.protocol,
            self.motions,
            self._errors(),
            [name for name in dict.fromkeys(known) if name],
            extra={"CPU s": self._seconds(), "failed": failed},
            notes=self._notes(),
        )

    def per_clip(self) -> ResultsTable:
        """One row per clip: mean over seeds of every configuration, with the spread over seeds."""
        title = f"{self._heading()}: error in % per clip"
        total = share(len(self.clips), self.protocol.n_clips)
        last = [["CPU s", "", *self._seconds()]]
        return clip_table(title, self._errors(), self.motions, total=total, last=last)

    def by_axis(self) -> ResultsTable | None:
        """One row per bin of what makes clips hard; None where the benchmark has no such axes."""
        title = f"{self._heading()}: error in % by what makes clips hard"
        return axis_table(title, self.protocol, self.motions, self._errors())

    def as_dict(self) -> dict[str, Any]:
        """Everything as plain values, for JSON."""
        return {
            "benchmark": self.protocol.name,
            "coverage": self.protocol.coverage(self.clips),
            "number": self.number,
            "seeds": list(self.seeds),
            "clips": dict(self.motions),
            "methods": [{"method": c.method, "parameters": dict(c.parameters)} for c in self.configurations],
            "errors": self.errors.tolist(),
            "seconds": self.seconds.tolist(),
            "failures": [
                {"method": c.title, "clip": clip, "seed": seed, "reason": reason}
                for c, clip, seed, reason in self.failures
            ],
            "notes": [
                {"method": c.title, "clip": clip, "seed": seed, "note": note}
                for c, clip, seed, note in self.notes
            ],
        }

    def _errors(self) -> dict[str, FloatArray]:
        return {c.title: self.errors[m] for m, c in enumerate(self.configurations)}

    def _seconds(self) -> list[str]:
        return [f"{seconds.sum(axis=0).mean():.2f}" for seconds in self.seconds]

    def _heading(self) -> str:
        seeds = count(len(self.seeds), "seed")
        known = ", number of motions found" if self.number == "found" else ""
        return f"{self.protocol.title}, {self.protocol.coverage(self.clips)}, {seeds}{known}"

    def _notes(self) -> list[str]:
        notes = []
        if len(self.clips) < self.protocol.n_clips:
            notes.append("A part of the benchmark; published rows are for the whole of it.")
        for group in self.protocol.groups:
            present = self.protocol.clips_of(group, self.motions)
            if len(present) < group.n_clips:
                notes.append(f"{group.title}: {_missing(group, present)}.")
        if self.others:
            notes.append(f"Not counted: {first_few(self.others, _LISTED)}.")
        said = [f"{c.title} on {clip}, seed {seed}: {note}" for c, clip, seed, note in self.notes]
        notes += [f"Reported: {first_few(said, _LISTED)}."] if said else []
        notes += [
            f"Counted as fully wrong: {c.title} on {clip}, seed {seed}: {reason}."
            for c, clip, seed, reason in self.failures
        ]
        return notes


def _missing(group: Group, present: list[str]) -> str:
    absent = [name for name in group.clips if name not in present]
    if group.unknown:
        return "which clips it holds was never published"
    what = f" ({first_few(absent, _LISTED)})" if absent else ""
    return f"{group.n_clips - len(present)} of {group.n_clips} clips are missing{what}"
