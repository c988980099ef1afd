"""Scores as data: per clip and seed, averaged over clips and seeds, per group of the protocol."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kt3dmoseg.registry import unknown_name
from kt3dmoseg.types import FloatArray
from mseg.evaluation.contingency import Contingency
from mseg.evaluation.layout import count
from mseg.evaluation.problems import Problem
from mseg.evaluation.protocol import Group, Protocol, protocol_of_clips
from mseg.evaluation.statistics import Interval, bootstrap_mean, standard_deviation
from mseg.evaluation.submission import SubmissionMeta


@dataclass(frozen=True)
class Provenance:
    """What was scored on what.

    Parameters
    ----------
    dataset_version, dataset_sha256 : str
        Version by name, and the hash over names, trajectories and labels of the clips scored.
    submission_sha256 : str
        Hash over the files of the submission.
    toolkit_version : str
        Version of this package.
    """

    dataset_version: str
    dataset_sha256: str
    submission_sha256: str
    toolkit_version: str


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


@dataclass(frozen=True)
class Summary:
    """One metric over the clips of a group.

    Parameters
    ----------
    mean, median : float
        Over clips, of the means over seeds.
    pooled : float
        Mean over clips weighted by their numbers of scored trajectories; for the classification
        error this is the error over all trajectories together.
    seed_sd : float or None
        Standard deviation over seeds of the mean over clips; None with one seed.
    interval : Interval
        95 % bootstrap interval of the mean over clips.
    """

    mean: float
    median: float
    pooled: float
    seed_sd: float | None
    interval: Interval


_BARE = SubmissionMeta("labels")
_UNKNOWN = Provenance("", "", "", "")


@dataclass(frozen=True, eq=False)
class ScoreTable:
    """All scores of a submission.

    Parameters
    ----------
    clips : tuple of ClipScore
        Every clip and seed; failed and missing ones included.
    meta : SubmissionMeta
        What the submission says about itself.
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
        """Mean of a metric over clips and seeds.

        Raises
        ------
        UnknownNameError
            When there is no such metric.
        """
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
        """Return the scores of a clip; of the first seed unless told."""
        wanted = self.seeds[0] if seed is None else seed
        return self._by_key[clip, wanted]

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
        motions = {name: self.of(name).n_motions for name in self.names}
        for group in self.benchmark.groups:
            yield group, self.benchmark.members(group, motions)

    def summary(self, metric: str = "error", clips: list[str] | None = None) -> Summary:
        """Summarise a metric over clips: one or more of `names`, by default all."""
        wanted = self.names if clips is None else clips
        rows = [self.names.index(name) for name in wanted]
        values = self.matrix(metric)[rows]
        weights = np.array([self.of(name).n for name in wanted], dtype=np.float64)
        means = values.mean(axis=1)
        return Summary(
            float(means.mean()),
            float(np.median(means)),
            float(np.average(means, weights=weights)),
            standard_deviation(values.mean(axis=0)),
            bootstrap_mean(means),
        )

    @cached_property
    def _by_key(self) -> dict[tuple[str, int], ClipScore]:
        return {(c.clip, c.seed): c for c in self.clips}
