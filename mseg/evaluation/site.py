"""The page of a leaderboard: rows ranked per benchmark, data and protocol, with filters and every clip.

Both `mseg leaderboard site` (results as data) and `mseg leaderboard export` (the SQLite file) write it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from kt3dmoseg.types import FloatArray
from mseg.evaluation.protocol import Protocol
from mseg.evaluation.report import render
from mseg.evaluation.statistics import Summary, bootstrap_mean, summarise


@dataclass(frozen=True)
class Version:
    """An earlier version of a row."""

    date: str
    mean: float | None  # a fraction; None = written in a form that is not read any more
    about: str


@dataclass(frozen=True, eq=False)
class Row:
    """One method on one dataset under one protocol."""

    name: str
    errors: FloatArray  # (clips, seeds), classification errors as fractions
    scored: Sequence[int] | None = None  # trajectories of each clip; None: the same of all
    number: str = "given"  # of motions: "given" or "found"
    kind: str = "measured"  # "baseline", or "claimed": read from a file of scores
    supervised: bool = False  # trained with labels of other clips
    authors: str = ""
    link: str = ""
    failed: int = 0  # runs that count as fully wrong
    complete: bool = True  # has all clips that the others have
    right: float | None = None  # share of the runs with as many groups as motions
    seconds: float = 0.0  # of one seed on all clips; 0 = not stated
    facts: Mapping[str, str] = field(default_factory=dict)
    history: Sequence[Version] = ()

    @property
    def address(self) -> str:
        """The link, when it is one to the web."""
        return self.link if re.match(r"https?://", self.link) else ""

    @property
    def group(self) -> str:
        """Rows of one group are ranked together: the same protocol, complete and without failures."""
        return self.number if self.complete and not self.failed else ""

    @cached_property
    def per_clip(self) -> FloatArray:
        """Mean over seeds, (clips,)."""
        return np.asarray(self.errors.mean(axis=1))

    @cached_property
    def shown(self) -> float:
        """The mean as it is printed, in per cent, by which rows are ranked."""
        return round(100 * self.summary.mean, 2)

    @cached_property
    def summary(self) -> Summary:
        """Mean, median, interval and spread."""
        return summarise(self.errors, self.scored)

    def like(self, other: Row) -> bool:
        """Whether the 95 % interval of the paired difference of two rows of the same clips holds 0."""
        low, high = bootstrap_mean(self.per_clip - other.per_clip)
        return low <= 0 <= high


@dataclass(frozen=True, eq=False)
class DataRows:
    """Rows on one dataset."""

    title: str  # of the benchmark, or benchmark/version
    about: str  # how much of it, and which data
    protocol: Protocol
    motions: Mapping[str, int]  # clips, and their true numbers of motions
    rows: Sequence[Row]
    pictures: Mapping[str, str] = field(default_factory=dict)  # clip -> picture, as an address of data

    @cached_property
    def ranked(self) -> list[tuple[int | None, Row, bool]]:
        """Rank (equal means share one), row, and whether it may be as good as the best; best first."""
        order = sorted(self.rows, key=lambda row: (row.number != "given", not row.group, row.shown))
        out = []
        for row in order:
            peers = [other for other in order if row.group and other.group == row.group]
            rank = 1 + sum(other.shown < row.shown for other in peers) if peers else None
            out.append((rank, row, bool(peers) and row.like(peers[0])))
        return out

    @property
    def highest(self) -> float:
        """Upper end of the intervals that the axis must hold: those of methods, not of baselines."""
        rows = [row for row in self.rows if row.kind != "baseline"] or self.rows
        return max(row.summary.interval.high for row in rows)

    @property
    def groups(self) -> list[tuple[str, list[int]]]:
        """Parts of the benchmark with clips here, when there are several, and the numbers of their clips."""
        clips = list(self.motions)
        found = [(g.title, self.protocol.clips_of(g, self.motions)) for g in self.protocol.groups]
        parts = [(title, [clips.index(name) for name in names]) for title, names in found if names]
        return parts if len(self.protocol.groups) > 1 else []

    @property
    def printed(self) -> list[tuple[str, float, float | None]]:
        """Method, mean and median of the published table, fractions, over the whole benchmark."""
        known = {name: parts.get("all", {}) for name, parts in self.protocol.published.items()}
        rows = [(n, v["mean"] / 100, v.get("median")) for n, v in known.items() if "mean" in v]
        return [(n, mean, None if median is None else median / 100) for n, mean, median in rows]


def site_html(boards: Sequence[DataRows], *, title: str = "Leaderboard", notes: Sequence[str] = ()) -> str:
    """Make the page."""
    rows = [row for board in boards for row in board.rows]
    return render(
        "site.html",
        boards=boards,
        title=title,
        notes=notes,
        kinds=sorted({row.kind for row in rows} | {"printed" for b in boards if b.printed}),
        most_seeds=max((row.errors.shape[1] for row in rows), default=1),
    )
