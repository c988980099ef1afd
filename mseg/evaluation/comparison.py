"""Comparing submissions: paired statistics over clips, and the noise between seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from kt3dmoseg.errors import InvalidValueError
from mseg.evaluation.layout import TextTable
from mseg.evaluation.metrics import METRICS, Metric
from mseg.evaluation.results import ScoreTable
from mseg.evaluation.statistics import Interval, bootstrap_mean, holm, standard_deviation, wilcoxon_p

_SIGNIFICANT = 0.05
_NOISE = 2.0


@dataclass(frozen=True)
class Pair:
    """Two submissions on the same clips.

    Parameters
    ----------
    first, second : str
        Their names.
    difference : float
        Mean over clips of first minus second.
    interval : Interval
        95 % bootstrap interval of the difference, over clips.
    p, p_holm : float
        Wilcoxon signed-rank test over clips, alone and corrected for all pairs compared.
    seed_sd : float or None
        Standard deviation, over the choice of one seed each, of the difference of the two means;
        None when one of them has a single seed.
    sentence : str
        What this says, in words.
    """

    first: str
    second: str
    difference: float
    interval: Interval
    p: float
    p_holm: float
    seed_sd: float | None
    sentence: str


@dataclass(frozen=True, eq=False)
class Comparison:
    """Several submissions compared by one metric.

    Parameters
    ----------
    metric : str
        Name of the metric.
    names : list of str
        Of the submissions, unique.
    tables : sequence of ScoreTable
        Their scores.
    pairs : list of Pair
        Every pair.
    """

    metric: str
    names: list[str]
    tables: Sequence[ScoreTable]
    pairs: list[Pair]


def compare(tables: Sequence[ScoreTable], *, metric: str = "error") -> Comparison:
    """Compare submissions that were scored on the same data.

    Parameters
    ----------
    tables : sequence of ScoreTable
        Two or more.
    metric : str
        What to compare by.

    Raises
    ------
    InvalidValueError
        With fewer than two, or when they were not scored on the same clips and labels.
    UnknownNameError
        When there is no such metric.
    """
    if len(tables) < 2:
        raise InvalidValueError("compare", expected="two submissions or more", found=str(len(tables)))
    _same_data(tables)
    spec: Metric = METRICS.load(metric)
    values = [table.matrix(metric) for table in tables]
    names = _unique_names([table.meta.method for table in tables])
    index = list(combinations(range(len(tables)), 2))
    means = [v.mean(axis=1) for v in values]
    p_values = [wilcoxon_p(means[i] - means[j]) for i, j in index]
    sds = [standard_deviation(v.mean(axis=0)) for v in values]
    pairs = []
    for (i, j), p, p_holm in zip(index, p_values, holm(p_values), strict=True):
        difference = means[i] - means[j]
        noise = _noise_of(sds[i], sds[j])
        pair = Pair(
            names[i], names[j], float(difference.mean()), bootstrap_mean(difference), p, p_holm, noise, ""
        )
        pairs.append(_with_sentence(pair, spec, len(difference)))
    return Comparison(metric, names, tables, pairs)


def comparison_table(comparison: Comparison) -> TextTable:
    """Lay out the submissions side by side: per clip, then mean, median, sd over seeds."""
    spec: Metric = METRICS.load(comparison.metric)
    scale = 100 if spec.percent else 1
    first = comparison.tables[0]
    values = [table.per_clip(comparison.metric) for table in comparison.tables]
    rows = [[name, *(f"{scale * v[i]:.2f}" for v in values)] for i, name in enumerate(first.names)]
    rows.append(["mean", *(f"{scale * v.mean():.2f}" for v in values)])
    rows.append(["median", *(f"{scale * np.median(v):.2f}" for v in values)])
    sds = [standard_deviation(t.matrix(comparison.metric).mean(axis=0)) for t in comparison.tables]
    rows.append(["sd over seeds", *("-" if sd is None else f"{scale * sd:.2f}" for sd in sds)])
    unit = " in %" if spec.percent else ""
    notes = [f"Scored: {first.benchmark.coverage(first.names)}."]
    for name, table in zip(comparison.names, comparison.tables, strict=True):
        notes += [
            f"{name}: {c.clip} (seed {c.seed}) counts as fully wrong: {c.reason}." for c in table.failures
        ]
    title = f"{first.benchmark.title}: {spec.title}{unit}, {spec.better} is better"
    return TextTable(title, ["clip", *comparison.names], rows, notes)


def pairs_table(comparison: Comparison) -> TextTable:
    """Lay out the paired statistics."""
    scale = 100 if METRICS.load(comparison.metric).percent else 1
    rows = [
        [
            f"{pair.first} - {pair.second}",
            f"{scale * pair.difference:+.2f}",
            f"{scale * pair.interval.low:+.2f}..{scale * pair.interval.high:+.2f}",
            "-" if pair.seed_sd is None else f"{scale * pair.seed_sd:.2f}",
            f"{pair.p:.3g}",
            f"{pair.p_holm:.3g}",
        ]
        for pair in comparison.pairs
    ]
    columns = ["pair", "difference", "95 % over clips", "seed sd", "Wilcoxon p", "Holm p"]
    return TextTable("Paired over clips", columns, rows)


def _same_data(tables: Sequence[ScoreTable]) -> None:
    first = tables[0]
    for table in tables[1:]:
        same = table.provenance.dataset_sha256 == first.provenance.dataset_sha256
        if not same or table.names != first.names:
            raise InvalidValueError(
                f"{table.meta.method} and {first.meta.method}",
                expected="scores on the same clips and labels",
                found=f"dataset {table.provenance.dataset_sha256[:16]} and "
                f"{first.provenance.dataset_sha256[:16]}",
                fix="score both on the same data; versions are never mixed",
            )


def _noise_of(first: float | None, second: float | None) -> float | None:
    return None if first is None or second is None else float(np.hypot(first, second))


def _unique_names(names: Sequence[str]) -> list[str]:
    """Make names unique by numbering those that occur more than once."""
    return [
        f"{name} ({names[: i + 1].count(name)})" if names.count(name) > 1 else name
        for i, name in enumerate(names)
    ]


def _with_sentence(pair: Pair, spec: Metric, n_clips: int) -> Pair:
    return replace(pair, sentence=_sentence(pair, spec, n_clips))


def _sentence(pair: Pair, spec: Metric, n_clips: int) -> str:
    if pair.difference == 0:
        return f"{pair.first} and {pair.second} have the same mean."
    scale, unit = (100, " points") if spec.percent else (1, "")
    ahead, behind = pair.first, pair.second
    if (pair.difference > 0) == (spec.better == "lower"):
        ahead, behind = behind, ahead
    size = f"{scale * abs(pair.difference):.2f}{unit}"
    return (
        f"{ahead} is better than {behind} by {size} on average over {n_clips} clips. "
        f"{_noise_sentence(pair, scale, unit)} {_test_sentence(pair, n_clips)}"
    )


def _noise_sentence(pair: Pair, scale: int, unit: str) -> str:
    if pair.seed_sd is None:
        return "Whether that is larger than the seed noise cannot be said: one of them has a single seed."
    larger = abs(pair.difference) > _NOISE * pair.seed_sd
    verdict = "The difference is larger than" if larger else "The difference is not larger than"
    return (
        f"{verdict} the seed noise ({_NOISE:g} standard deviations over seeds, "
        f"each {scale * pair.seed_sd:.2f}{unit})."
    )


def _test_sentence(pair: Pair, n_clips: int) -> str:
    if 2 / 2**n_clips >= _SIGNIFICANT:  # the smallest p-value that so many clips can give
        return f"Whether it is consistent over clips, {n_clips} of them cannot tell."
    verdict = "is consistent" if pair.p_holm < _SIGNIFICANT else "could be chance"
    return f"Over the clips it {verdict} (Wilcoxon with Holm's correction, p = {pair.p_holm:.3g})."
