"""Comparing submissions: paired statistics over clips, and the noise between seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.registry import strict, unknown_name
from kt3dmoseg.text import count
from kt3dmoseg.types import FloatArray
from mseg.evaluation.metrics import Metric, all_metrics
from mseg.evaluation.results import (
    ABSENT,
    ResultsTable,
    clip_table,
    failure_notes,
    number_notes,
    plot_metric,
    unique_names,
)
from mseg.evaluation.scoring import ScoreTable
from mseg.evaluation.statistics import (
    Interval,
    bootstrap_mean,
    holm,
    signed_ranks,
    standard_deviation,
    wilcoxon_p,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

_SIGNIFICANT = 0.05
_NOISE = 2.0


@dataclass(frozen=True)
class Pair:
    """Two submissions on the same clips."""

    first: str
    second: str
    difference: float  # mean over clips of first minus second
    interval: Interval  # 95 % bootstrap interval of the difference, over clips
    p: float  # Wilcoxon signed-rank test over clips
    p_holm: float  # the same, corrected for all pairs compared
    seed_sd: float | None  # of the difference when each takes one other seed; None with a single seed
    sentence: str = ""  # the result in words


@dataclass(frozen=True, eq=False)
class Comparison:
    """Several submissions, by unique names, compared pair by pair by one metric."""

    metric: str
    names: list[str]
    tables: Sequence[ScoreTable]
    pairs: list[Pair]

    def __repr__(self) -> str:
        return f"Comparison({self.metric} of {', '.join(self.names)})"

    def _repr_html_(self) -> str:
        sentences = replace(pairs_table(self), notes=[pair.sentence for pair in self.pairs])
        return comparison_table(self).html() + sentences.html()

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Plot the metric of every clip and submission with matplotlib; see `ScoreTable.plot`."""
        return plot_metric(dict(zip(self.names, self.tables, strict=True)), self.metric, ax=ax)

    def to_dataframe(self) -> pd.DataFrame:
        """Give one row per submission, clip and seed: `method` and what `ScoreTable.to_dataframe` gives."""
        import pandas as pd

        frames = zip(self.names, self.tables, strict=True)
        return pd.concat(
            [pd.DataFrame({"method": n, **t.to_dataframe()}) for n, t in frames], ignore_index=True
        )


@strict
def compare(tables: Sequence[ScoreTable] | Mapping[str, ScoreTable], *, metric: str = "error") -> Comparison:
    """Compare two or more submissions that were scored on the same data, by a metric.

    A mapping names the methods; otherwise each table does. InvalidValueError with fewer than two, or when
    they were not scored on the same clips and labels; UnknownNameError when there is no such metric.
    """
    if isinstance(tables, Mapping):
        tables = [_named(name, each) for name, each in tables.items()]
    if len(tables) < 2:
        raise InvalidValueError("compare", expected="two submissions or more", found=str(len(tables)))
    if metric not in all_metrics():
        raise unknown_name("metric", metric, all_metrics())
    first = tables[0]
    for table in tables[1:]:
        data, here = table.provenance.dataset_sha256, first.provenance.dataset_sha256
        if data != here or table.names != first.names:
            raise InvalidValueError(
                f"{table.meta.method} and {first.meta.method}",
                expected="scores on the same clips and labels",
                found=f"dataset {data[:16]} and {here[:16]}",
                fix="score both on the same data; versions are never mixed",
            )
    names = unique_names(tables)
    values = [table.matrix(metric) for table in tables]
    both = list(combinations(range(len(tables)), 2))
    deltas = [values[i].mean(axis=1) - values[j].mean(axis=1) for i, j in both]
    p_values = [wilcoxon_p(delta) for delta in deltas]
    pairs = []
    for (i, j), delta, p, p_holm in zip(both, deltas, p_values, holm(p_values), strict=True):
        one, other = (standard_deviation(values[k].mean(axis=0)) for k in (i, j))
        noise = None if one is None or other is None else float(np.hypot(one, other))
        mean, interval = round(float(delta.mean()), 12) + 0.0, bootstrap_mean(delta)  # + 0.0: never -0.0
        pair = Pair(names[i], names[j], mean, interval, p, p_holm, noise)
        pairs.append(replace(pair, sentence=_sentence(pair, all_metrics()[metric], delta)))
    return Comparison(metric, names, tables, pairs)


@strict
def _named(method: str, table: ScoreTable) -> ScoreTable:
    return replace(table, meta=replace(table.meta, method=method))


def comparison_table(comparison: Comparison) -> ResultsTable:
    """Lay out the submissions, one column each: every clip, mean and median, with the spread over seeds."""
    spec, first = all_metrics()[comparison.metric], comparison.tables[0]
    values, notes = {}, [f"Scored: {first.benchmark.coverage(first.names)}."]
    for name, table in zip(comparison.names, comparison.tables, strict=True):
        values[name] = table.matrix(comparison.metric)
        notes += failure_notes(table, name)
    notes += number_notes(comparison.tables)
    unit = " in %" if spec.percent else ""
    title = f"{first.benchmark.title}: {spec.title}{unit}, {spec.better} is better"
    return clip_table(title, values, first.motions, scale=spec.scale, notes=notes)


def pairs_table(comparison: Comparison) -> ResultsTable:
    """Lay out the paired statistics."""
    spec = all_metrics()[comparison.metric]
    scale, unit = spec.scale, ", differences in points" if spec.percent else ""
    rows = []
    for pair in comparison.pairs:
        low, high = (signed(scale * bound) for bound in pair.interval)
        noise = ABSENT if pair.seed_sd is None else f"{scale * pair.seed_sd:.2f}"
        tests = [f"{pair.p:.3g}", f"{pair.p_holm:.3g}"]
        difference = signed(scale * pair.difference)
        rows.append([f"{pair.first} - {pair.second}", difference, f"{low}..{high}", noise, *tests])
    columns = ["pair", "difference", "95 % over clips", "seed sd", "Wilcoxon p", "Holm p"]
    return ResultsTable(f"Paired over clips{unit}", columns, rows)


def signed(value: float) -> str:
    """Show a difference with its sign, unless it is shown as 0.00."""
    return f"{value:+.2f}" if round(value, 2) else "0.00"


def _sentence(pair: Pair, spec: Metric, delta: FloatArray) -> str:
    n_clips = len(delta)
    unit = " points" if spec.percent else ""
    size = round(spec.scale * abs(pair.difference), 2)
    if not size:
        near = f", to within 0.01{unit}" if pair.difference else ""
        return f"{pair.first} and {pair.second} have the same mean{near}."
    better, worse = pair.first, pair.second
    if (pair.difference > 0) == (spec.better == "lower"):
        better, worse = worse, better
    text = f"{better} is better than {worse} by {size:.2f}{unit} on average over {count(n_clips, 'clip')}. "
    if pair.seed_sd is None:
        text += "Whether that is larger than the seed noise is unknown: one of them has a single seed. "
    else:
        noise = round(spec.scale * _NOISE * pair.seed_sd, 2)
        larger = "larger" if size > noise else "not larger"
        text += (
            f"The difference is {larger} than the seed noise ({_NOISE:g} standard deviations over seeds, "
            f"each {spec.scale * pair.seed_sd:.2f}{unit}). "
        )
    if 2 / 2**n_clips >= _SIGNIFICANT:  # the smallest p-value that so many clips can give
        return f"{text}There are too few clips ({n_clips}) to show whether it is consistent over clips."
    test = f"(Wilcoxon with Holm's correction, p = {pair.p_holm:.3g})"
    if pair.p_holm < _SIGNIFICANT and signed_ranks(delta).sum() * pair.difference < 0:
        return (
            f"{text}But over the clips {worse} is better, consistently {test}: a few clips decide the mean."
        )
    verdict = "is consistent" if pair.p_holm < _SIGNIFICANT else "could be chance"
    return f"{text}Over the clips it {verdict} {test}."
