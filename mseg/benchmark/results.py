"""What a benchmark run found, and its tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from kt3dmoseg.types import FloatArray
from mseg.benchmark.tasks import Configuration
from mseg.evaluation import Group, Protocol
from mseg.evaluation.layout import TextTable, count
from mseg.evaluation.problems import first_few
from mseg.evaluation.statistics import standard_deviation

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
    """Errors and times of configurations x clips x seeds.

    Parameters
    ----------
    protocol : Protocol
        The benchmark.
    configurations : tuple of Configuration
        The rows.
    motions : mapping of str to int
        Clips, in order, and their true numbers of motions.
    seeds : tuple of int
        The seeds.
    errors : (M, C, S) float64
        Classification error, a fraction; 1 where the method failed.
    seconds : (M, C, S) float64
        CPU seconds.
    failures : tuple of (configuration, clip, seed, reason)
        What failed and why.
    others : tuple of str
        Clips that lay there and do not belong to the benchmark.
    """

    protocol: Protocol
    configurations: tuple[Configuration, ...]
    motions: Mapping[str, int]
    seeds: tuple[int, ...]
    errors: FloatArray
    seconds: FloatArray
    failures: tuple[tuple[Configuration, str, int, str], ...] = ()
    others: tuple[str, ...] = ()

    @property
    def clips(self) -> list[str]:
        """Names of the clips, in order."""
        return list(self.motions)

    def mean(self, method: str, group: str = "all") -> float:
        """Mean error over clips and seeds, a fraction, of the first configuration of that method."""
        row = [c.method for c in self.configurations].index(method)
        return float(self.errors[row, self._members(self.protocol.group(group))].mean())

    def summary(self) -> TextTable:
        """One row per configuration: mean, spread over seeds and median of every group, and time."""
        groups = [(g, self._members(g)) for g in self.protocol.groups]
        present = [(g, rows) for g, rows in groups if rows]
        columns = ["method"]
        for group, rows in present:
            columns += [f"{group.title} ({_of(len(rows), group.n_clips)}): mean", "sd seeds", "median"]
        columns += ["CPU s", "failed"]
        lines: list[list[str]] = []
        for m, configuration in enumerate(self.configurations):
            cells = [cell for _, rows in present for cell in _statistics(self.errors[m, rows])]
            failed = sum(configuration == c for c, *_ in self.failures)
            lines.append(
                [configuration.title, *cells, f"{self.seconds[m].sum(axis=0).mean():.2f}", str(failed)]
            )
        lines += self._published([group for group, _ in present])
        return TextTable(f"{self._heading()}: classification error in %", columns, lines, self._notes())

    def per_clip(self) -> TextTable:
        """One row per clip: mean over seeds of every configuration, with the spread over seeds."""
        columns = ["clip", "motions", *(c.title for c in self.configurations)]
        lines = []
        for i, (name, motions) in enumerate(self.motions.items()):
            cells = [_with_spread(self.errors[m, i]) for m in range(len(self.configurations))]
            lines.append([name, str(motions), *cells])
        means = [_with_spread(self.errors[m].mean(axis=0)) for m in range(len(self.configurations))]
        medians = [f"{100 * np.median(self.errors[m].mean(axis=1)):.2f}" for m in range(len(means))]
        seconds = [f"{self.seconds[m].sum(axis=0).mean():.2f}" for m in range(len(means))]
        number = _of(len(self.clips), self.protocol.n_clips)
        lines += [
            [f"mean of {number}", "", *means],
            [f"median of {number}", "", *medians],
            ["CPU s", "", *seconds],
        ]
        note = [] if len(self.seeds) < 2 else ["mean over seeds +- standard deviation over seeds"]
        return TextTable(f"{self._heading()}: error in % per clip", columns, lines, note)

    def as_dict(self) -> dict[str, Any]:
        """Everything as plain values, for JSON."""
        return {
            "benchmark": self.protocol.name,
            "coverage": self.protocol.coverage(self.clips),
            "seeds": list(self.seeds),
            "clips": dict(self.motions),
            "methods": [{"method": c.method, "parameters": dict(c.parameters)} for c in self.configurations],
            "errors": self.errors.tolist(),
            "seconds": self.seconds.tolist(),
            "failures": [
                {"method": c.title, "clip": clip, "seed": seed, "reason": reason}
                for c, clip, seed, reason in self.failures
            ],
        }

    def _members(self, group: Group) -> list[int]:
        names = self.protocol.members(group, self.motions)
        return [self.clips.index(name) for name in names]

    def _heading(self) -> str:
        seeds = count(len(self.seeds), "seed")
        return f"{self.protocol.title}, {self.protocol.coverage(self.clips)}, {seeds}"

    def _published(self, groups: list[Group]) -> list[list[str]]:
        """Rows of the published table for the methods that were run."""
        lines: list[list[str]] = []
        for configuration in self.configurations:
            name = published_name(self.protocol, configuration.method)
            published = self.protocol.published.get(name)
            if published and not any(line[0] == f"published {name}" for line in lines):
                cells = [c for g in groups for c in _published_cells(published.get(g.name, {}))]
                lines.append([f"published {name}", *cells, "", ""])
        return lines

    def _notes(self) -> list[str]:
        notes = []
        if len(self.clips) < self.protocol.n_clips:
            notes.append("A part of the benchmark; published rows are for the whole of it.")
        for group in self.protocol.groups:
            rows = self._members(group)
            if len(rows) < group.n_clips:
                notes.append(f"{group.title}: {_missing(group, [self.clips[r] for r in rows])}.")
        if self.others:
            notes.append(f"Not counted: {first_few(self.others, _LISTED)}.")
        notes += [
            f"Counted as fully wrong: {c.title} on {clip}, seed {seed}: {reason}."
            for c, clip, seed, reason in self.failures
        ]
        return notes


def _statistics(errors: FloatArray) -> list[str]:
    spread = standard_deviation(errors.mean(axis=0))
    return [
        f"{100 * errors.mean():.2f}",
        "-" if spread is None else f"{100 * spread:.2f}",
        f"{100 * np.median(errors.mean(axis=1)):.2f}",
    ]


def _with_spread(errors: FloatArray) -> str:
    spread = standard_deviation(errors)
    mean = f"{100 * errors.mean():.2f}"
    return mean if spread is None else f"{mean} +- {100 * spread:.2f}"


def _published_cells(values: Mapping[str, float]) -> list[str]:
    mean, median = values.get("mean"), values.get("median")
    return [
        "-" if mean is None else f"{mean:.2f}",
        "",
        "-" if median is None else f"{median:.2f}",
    ]


def _missing(group: Group, present: list[str]) -> str:
    absent = [name for name in group.clips if name not in present]
    if group.unknown:
        return "which clips it holds was never published"
    what = f" ({first_few(absent, _LISTED)})" if absent else ""
    return f"{group.n_clips - len(present)} of {group.n_clips} clips are missing{what}"


def _of(present: int, total: int) -> str:
    return f"all {total}" if present == total else f"{present} of {total}"
