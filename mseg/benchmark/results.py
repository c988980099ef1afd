"""What a benchmark run found, and its tables."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

from kt3dmoseg.text import count, several
from kt3dmoseg.types import FloatArray
from mseg.evaluation import Protocol
from mseg.evaluation.protocol import share
from mseg.evaluation.results import (
    LISTED,
    ResultsTable,
    by_axis,
    clip_table,
    data_notes,
    error_table,
    published_name,
)
from mseg.evaluation.scoring import ScoreTable

RECIPE = "recipe-"
"""How the name of a dataset version begins that is made, not read: `mseg.benchmark.runner.recipe`."""


@dataclass(frozen=True)
class Configuration:
    """A method and the parameters that differ from its defaults."""

    method: str  # name in `mseg.methods.METHODS`
    parameters: Mapping[str, Any] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Name for tables, with the parameters: ``"subset alpha=5.0"``."""
        return " ".join([self.method, *(f"{key}={value}" for key, value in self.parameters.items())])


@dataclass(frozen=True, eq=False)
class BenchmarkResult:
    """Scores and times of M configurations x C clips x S seeds."""

    configurations: tuple[Configuration, ...]  # the rows
    tables: tuple[ScoreTable, ...]  # their scores; a clip on which a method failed is fully wrong
    seconds: FloatArray  # (M, C, S): CPU seconds
    others: tuple[str, ...] = ()  # clips that lay there and do not belong to the benchmark
    notes: tuple[tuple[Configuration, str, int, str], ...] = ()  # configuration, clip, seed and note
    number: Literal["given", "found"] = "given"  # whether the methods were given the number of motions

    def __repr__(self) -> str:
        rows = ", ".join(each.title for each in self.configurations)
        have = self.protocol.coverage(self.clips)
        return f"BenchmarkResult({rows} on {self.protocol.title}, {have}, {count(len(self.seeds), 'seed')})"

    def _repr_html_(self) -> str:
        return self.summary().html()

    @property
    def protocol(self) -> Protocol:
        """The benchmark."""
        return self.tables[0].benchmark

    @property
    def motions(self) -> dict[str, int]:
        """Clips, in order, and their true numbers of motions."""
        return self.tables[0].motions

    @property
    def clips(self) -> list[str]:
        """Names of the clips, in order."""
        return self.tables[0].names

    @property
    def seeds(self) -> list[int]:
        """The seeds, in order."""
        return self.tables[0].seeds

    @cached_property
    def errors(self) -> FloatArray:
        """Classification errors (M, C, S), fractions; 1 where the method failed."""
        return np.array([table.matrix() for table in self.tables])

    @property
    def failures(self) -> list[tuple[Configuration, str, int, str]]:
        """Configuration, clip, seed and reason of every run that failed."""
        rows = zip(self.configurations, self.tables, strict=True)
        return [(made, run.clip, run.seed, run.reason) for made, table in rows for run in table.failures]

    def mean(self, method: str, group: str = "all") -> float:
        """Mean error over clips and seeds, a fraction, of the first configuration of that method."""
        row = [c.method for c in self.configurations].index(method)
        clips = self.protocol.clips_of(self.protocol.group(group), self.motions)
        return float(self.tables[row].matrix(clips=clips).mean())

    def summary(self) -> ResultsTable:
        """One row per configuration: mean, spread over seeds and median of every group, and time."""
        failed = [str(len(table.failures)) for table in self.tables]
        published = [published_name(self.protocol, c.method) for c in self.configurations]
        right = [f"{100 * np.mean([c.n_found == c.n_motions for c in t.clips]):.0f}" for t in self.tables]
        extra = {"number right, %": right} if self.number == "found" else {}
        extra |= {"CPU s": self._seconds(), "failed": failed}
        title = self._title("classification error in %")
        return error_table(title, self.tables, published, extra=extra, notes=self._notes())

    def per_clip(self) -> ResultsTable:
        """One row per clip: mean over seeds of every configuration, with the spread over seeds."""
        errors = {made.title: values for made, values in zip(self.configurations, self.errors, strict=True)}
        total, last = share(len(self.clips), self.protocol.n_clips), [["CPU s", "", *self._seconds()]]
        return clip_table(self._title("error in % per clip"), errors, self.motions, total=total, last=last)

    def by_axis(self) -> ResultsTable | None:
        """One row per bin of what makes clips hard; None where the benchmark has no such axes."""
        return by_axis(*self.tables, title=self._title("error in % by what makes clips hard"))

    def as_dict(self) -> dict[str, Any]:
        """Everything as plain values, for JSON."""
        return {
            "benchmark": self.protocol.name,
            "coverage": self.protocol.coverage(self.clips),
            "number": self.number,
            "seeds": self.seeds,
            "clips": self.motions,
            "methods": [{"method": c.method, "parameters": dict(c.parameters)} for c in self.configurations],
            "errors": self.errors.tolist(),
            "seconds": [[[None if np.isnan(s) else s for s in c] for c in m] for m in self.seconds.tolist()],
            "failures": [
                {"method": c.title, "clip": n, "seed": s, "reason": r} for c, n, s, r in self.failures
            ],
            "notes": [{"method": c.title, "clip": n, "seed": s, "note": t} for c, n, s, t in self.notes],
        }

    def _seconds(self) -> list[str]:
        return [f"{seconds.sum(axis=0).mean():.2f}" for seconds in self.seconds]

    def _title(self, what: str) -> str:
        seeds = count(len(self.seeds), "seed")
        seeds += ", number of motions found" * (self.number == "found")
        have = f"{self.protocol.title}, {self.protocol.coverage(self.clips)}"
        return f"{have}, {seeds}: {what}, lower is better"

    def _notes(self) -> list[str]:
        notes = data_notes(self.tables[0])
        for group in self.protocol.groups:
            missing = group.n_clips - len(self.protocol.clips_of(group, self.motions))
            absent = [name for name in group.clips if name not in self.motions]
            listed = f" ({several(absent, LISTED)})" if absent else ""
            if group.unknown:
                notes.append(f"{group.title}: which clips it holds was never published.")
            elif missing > 0:
                notes.append(f"{group.title}: {missing} of {group.n_clips} clips are missing{listed}.")
        if self.others:
            notes.append(f"Not counted: {several(self.others, LISTED)}.")
        reported = [f"{c.title} on {clip}, seed {seed}: {note}" for c, clip, seed, note in self.notes]
        notes += [f"Reported: {several(reported, LISTED)}."] if reported else []
        wrong = (f"{c.title} on {clip}, seed {seed}: {reason}" for c, clip, seed, reason in self.failures)
        return [*notes, *(f"Counted as fully wrong: {each}." for each in wrong)]
