"""The one results table: scores, comparisons, benchmark runs and leaderboards, as text or data.

Cells are texts, rounded as they are printed; figures to compute with are in `ScoreTable`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kt3dmoseg.text import count, several, text_table
from kt3dmoseg.types import FloatArray
from mseg.evaluation.metrics import all_metrics
from mseg.evaluation.protocol import Protocol, share
from mseg.evaluation.scoring import ScoreTable, to_json

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

MAIN_METRICS = ("error", "adjusted_rand", "nmi", "f_measure", "iou", "moving_f")
ABSENT = "-"
LISTED = 12  # clips named in a note
_ERROR = "classification error in %, lower is better"


@dataclass(frozen=True, eq=False)
class ResultsTable:
    """Rows of texts under headings; the first column is set left, the others right."""

    title: str  # what the table shows, with its unit
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()  # lines below the table

    @property
    def frame(self) -> pd.DataFrame:
        """The cells as a data frame of texts."""
        import pandas as pd

        return pd.DataFrame(list(self.rows), columns=list(self.columns), dtype=object)

    def text(self) -> str:
        """Lay out for a terminal."""
        return "\n".join([self.title, "", text_table(self.rows, self.columns), *self.notes])

    def markdown(self) -> str:
        """Lay out as a Markdown table."""
        head, *rows = ([cell.replace("|", "\\|") for cell in row] for row in (self.columns, *self.rows))
        rule = ["---", *["---:"] * (len(head) - 1)]
        lines = ["| " + " | ".join(row) + " |" for row in (head, rule, *rows)]
        title = [f"**{self.title}**", ""] if self.title else []
        return "\n".join([*title, *lines, "", *(f"- {note}" for note in self.notes)]).rstrip()

    def html(self) -> str:
        """Lay out as HTML."""
        from kt3dmoseg.draw.display import html_table

        return html_table(self.title, self.columns, self.rows, self.notes)

    _repr_html_ = html

    def latex(self) -> str:
        """Lay out as a LaTeX table for the package booktabs."""
        form = "l" + "r" * (len(self.columns) - 1)
        body = self.frame.to_latex(index=False, escape=True, column_format=form).rstrip()
        return "\n".join([*(f"% {text}" for text in (self.title, *self.notes)), body])

    def csv(self) -> str:
        """Lay out as comma-separated values, without title and notes."""
        return self.frame.to_csv(index=False, lineterminator="\n")


# --- errors of several methods on the clips of a benchmark ------------------------------------------
# `motions` are the clips, in order, with their true numbers of motions; `errors` the fractions (clips, seeds)
# of each method, by title.


def published_name(protocol: Protocol, method: str) -> str:
    """Return the name of a method's row in the published table; empty where it has none.

    Upper and lower case and hyphens do not count (``"tlinkage"`` is T-Linkage), and `one_motion` is the
    prevalence row.
    """
    wanted = "prevalence" if method == "one_motion" else method
    return next((name for name in protocol.published if name.lower().replace("-", "") == wanted), "")


def error_table(
    title: str,
    tables: Sequence[ScoreTable],
    published: Iterable[str],
    *,
    extra: Mapping[str, Sequence[str]] | None = None,
    notes: Sequence[str] = (),
) -> ResultsTable:
    """One row per method: mean with its spread over seeds, and median, for every group of a benchmark.

    `published` are rows of the published table to add, '' for none; `extra` more columns, a cell per method.
    """
    protocol, motions = tables[0].benchmark, tables[0].motions
    groups = [(g, protocol.clips_of(g, motions)) for g in protocol.groups]
    columns = ["method"]
    for group, clips in groups:
        columns += [f"{group.title} ({share(len(clips), group.n_clips)}): mean", "median"]
    more = dict(extra or {})
    rows = []
    for i, (method, table) in enumerate(zip(unique_names(tables), tables, strict=True)):
        cells = [method]
        for values in (table.matrix(clips=clips) for _, clips in groups):
            cells += [_mean(values), _median(values)] if len(values) else [ABSENT, ABSENT]
        rows.append([*cells, *(column[i] for column in more.values())])
    for method in dict.fromkeys(filter(None, published)):
        cells = [f"printed {method} (all {protocol.n_clips})"]
        for group, _ in groups:
            known = protocol.published[method].get(group.name, {})
            cells += [f"{known[key]:.2f}" if key in known else ABSENT for key in ("mean", "median")]
        rows.append([*cells, *("" for _ in more)])
    return ResultsTable(title, [*columns, *more], rows, notes)


def clip_table(
    title: str,
    values: Mapping[str, FloatArray],
    motions: Mapping[str, int],
    *,
    scale: int = 100,
    total: str = "",
    last: Sequence[Sequence[str]] = (),
    notes: Sequence[str] = (),
) -> ResultsTable:
    """One row per clip: mean over seeds, with the spread over seeds, of any metric of each method.

    `scale` is the factor of what is printed, `total` describes what mean and median are over, such as
    "14 of 22", and `last` are more rows at the end.
    """
    rows = [
        [clip, str(n), *(_mean(v[i : i + 1], scale) for v in values.values())]
        for i, (clip, n) in enumerate(motions.items())
    ]
    of = f" of {total}" if total else ""
    rows.append([f"mean{of}", "", *(_mean(v, scale) for v in values.values())])
    rows.append([f"median{of}", "", *(_median(v, scale) for v in values.values())])
    seeds = max((v.shape[1] for v in values.values()), default=1)
    spread = ["mean over seeds ± standard deviation over seeds"] * (seeds > 1)
    return ResultsTable(title, ["clip", "motions", *values], [*rows, *last], [*spread, *notes])


def _mean(values: FloatArray, scale: int = 100) -> str:
    """Show the mean over clips and seeds (clips, seeds), with its spread over seeds."""
    means = values.mean(axis=0)
    spread = f" ±{scale * means.std(ddof=1):.2f}" if len(means) > 1 else ""
    return f"{scale * means.mean():.2f}{spread}"


def _median(values: FloatArray, scale: int = 100) -> str:
    return f"{scale * np.median(values.mean(axis=1)):.2f}"


# --- one submission ---------------------------------------------------------------------------------


def unique_names(tables: Sequence[ScoreTable]) -> list[str]:
    """Names of the methods, numbered where they occur more than once."""
    methods, names = [table.meta.method for table in tables], list[str]()
    for name in methods:
        numbered = (f"{name} ({number})" for number in range(1, 2 * len(methods)))
        free = (each for each in numbered if each not in (*methods, *names))
        names.append(next(free) if methods.count(name) > 1 else name)
    return names


def number_notes(tables: Sequence[ScoreTable]) -> list[str]:
    """Note which methods found the number of motions, where others were given it."""
    named = zip(unique_names(tables), tables, strict=True)
    found = [name for name, table in named if not table.meta.n_motions_given]
    mixed = 0 < len(found) < len(tables)
    return [f"Number of motions found by {several(found, LISTED)}, given to the others."] * mixed


def data_notes(scores: ScoreTable) -> list[str]:
    """Note that the published results are of more clips or another version of the data, if they are."""
    protocol, version, notes = scores.benchmark, scores.provenance.dataset_version, []
    if len(scores.names) < protocol.n_clips:
        printed = ": the printed figures are for all of it" if protocol.published else ""
        notes.append(f"A part of the benchmark{printed}.")
    if protocol.of_version(version).published != protocol.published:
        printed = f"printed figures are for version {protocol.published_dataset_version!r}"
        notes.append(f"Data version {version or 'unnamed'!r}; {printed}: not comparable.")
    return notes


def headline(*tables: ScoreTable) -> ResultsTable:
    """Classification error per group of the benchmark, and the rows of Table 1 of Xu et al. 2018.

    The notes are what is needed to read it rightly: coverage, failures, versions, seeds.
    """
    first = tables[0]
    protocol = first.benchmark
    parts = ", ".join(
        f"{group.title} "
        + ("which clips is not published" if group.unknown else f"{len(names)} of {group.n_clips}")
        for group, names in first.groups()
    )
    more = f" ({parts})" if len(protocol.groups) > 1 else ""
    scored = f"Scored: {protocol.coverage(first.names)}{more}."
    notes = [scored, *data_notes(first), *number_notes(tables)]
    for name, table in zip(unique_names(tables), tables, strict=True):
        summary, of = table.summary(), f"{name}: " if len(tables) > 1 else ""
        low, high = summary.interval
        sd = "" if summary.seed_sd is None else f", sd over seeds {100 * summary.seed_sd:.2f}"
        spread = (
            f"{count(len(table.seeds), 'seed')}{sd}; "
            f"95 % bootstrap interval over clips {100 * low:.2f} to {100 * high:.2f}; "
            f"all trajectories pooled {100 * summary.pooled:.2f}."
        )
        notes += [of + note for note in (spread, *method_notes(table), *failure_notes(table))]
    return error_table(f"{protocol.title}: {_ERROR}", tables, protocol.published, notes=notes)


def method_notes(scores: ScoreTable) -> list[str]:
    """Note what the method reports, and where it found another number of groups than it was given."""
    meta, notes = scores.meta, []
    if meta.baseline:
        return []
    found = [c for c in scores.clips if meta.n_motions_given and not c.reason and c.clip not in meta.notes]
    other = {f"{c.clip} ({c.n_found} of {c.n_motions})": 0 for c in found if c.n_found != c.n_motions}
    if other:
        listed = several(list(other), LISTED)
        notes.append(f"Other groups than motions, though their number was given: {listed}.")
    reported = [f"The method reports on {clip}: {' '.join(n.split())}." for clip, n in meta.notes.items()]
    more = len(reported) - LISTED
    return [*notes, *reported[:LISTED], *([f"And on {more} more clips."] if more > 0 else [])]


def failure_notes(scores: ScoreTable, method: str = "") -> list[str]:
    """Name the clips and seeds without labels, and why."""
    who = f"{method} on " if method else ""
    return [f"Counted as fully wrong: {who}{c.clip} (seed {c.seed}): {c.reason}." for c in scores.failures]


def by_axis(*tables: ScoreTable, title: str = f"By what makes clips hard: {_ERROR}") -> ResultsTable | None:
    """Break the classification error down by the axes of the benchmark; None where it has none."""
    protocol, motions = tables[0].benchmark, tables[0].motions
    rows = [
        [f"{axis.title}: {part}", str(len(clips)), *(_mean(table.matrix(clips=clips)) for table in tables)]
        for axis in protocol.axes
        for part, clips in protocol.bins_of(axis, motions).items()
    ]
    return ResultsTable(title, ["part", "clips", *unique_names(tables)], rows) if rows else None


def per_clip(
    scores: ScoreTable, metrics: Sequence[str] = MAIN_METRICS, *, marked: bool = True
) -> ResultsTable:
    """Every clip, means over seeds, with the prevalence baseline.

    Clips with failures are `marked` in their name; else a column counts them.
    """
    specs = [all_metrics()[metric] for metric in metrics]
    values = [scores.per_clip(metric) for metric in metrics]
    rows = []
    for i, name in enumerate(scores.names):
        runs = [scores.of(name, seed) for seed in scores.seeds]
        failed = sum(bool(run.reason) for run in runs)
        mark = " *" if marked and failed else ""
        found = "/".join(map(str, sorted({run.n_found for run in runs})))
        facts = [str(runs[0].n), str(runs[0].n_motions), found, f"{100 * runs[0].prevalence:.2f}"]
        shown = [metric.show(value[i]) for metric, value in zip(specs, values, strict=True)]
        rows.append([name + mark, *facts, *shown, *([str(failed)] * (not marked))])
    columns = ["clip", "n", "motions", "found", "prevalence", *(metric.title for metric in specs)]
    columns += ["failed"] * (not marked)
    notes = ["* failed or missing: the worst score."] if scores.failures else []
    lower, higher = (", ".join(m.title for m in specs if m.better == way) for way in ("lower", "higher"))
    title = f"Per clip, fractions in %; lower is better: {lower}; higher is better: {higher}"
    return ResultsTable(title, columns, rows, notes)


def all_means(scores: ScoreTable, *others: ScoreTable) -> ResultsTable:
    """Every metric: mean, median and pooled over clips, sd over seeds, 95 % interval; of several the mean."""
    title, rows = f"Over {scores.benchmark.coverage(scores.names)}, fractions in %, counts as counts", []
    if others:
        for name, metric in all_metrics().items():
            rows.append([metric.title, metric.better, *(metric.show(t[name]) for t in (scores, *others))])
        return ResultsTable(title, ["metric", "better", *unique_names([scores, *others])], rows)
    for name, metric in all_metrics().items():
        summary = scores.summary(name)
        values = [metric.show(v) for v in (summary.mean, summary.median, summary.pooled)]
        spread = ABSENT if summary.seed_sd is None else metric.show(summary.seed_sd)
        interval = " to ".join(map(metric.show, summary.interval))
        rows.append([metric.title, metric.better, *values, spread, interval])
    columns = ["metric", "better", "mean", "median", "pooled", "sd over seeds", "95 % over clips"]
    return ResultsTable(title, columns, rows)


def rendered(scores: ScoreTable, form: str) -> str:
    """Lay a submission out as "json" (all), "csv" (clips), "markdown", "latex" (headline) or "text"."""
    if form == "json":
        return json.dumps(to_json(scores), indent=1)
    if form == "csv":
        return per_clip(scores, scores.metrics, marked=False).csv().rstrip()
    if form == "text":
        tables = (make(scores) for make in (headline, by_axis, per_clip, all_means))
        return "\n\n".join(table.text() for table in tables if table)
    return headline(scores).markdown() if form == "markdown" else headline(scores).latex()


def plot_metric(scores: Mapping[str, ScoreTable], metric: str, *, ax: Axes | None = None) -> Axes:
    """Plot a metric per clip of submissions, by name, that were scored on the same clips."""
    from kt3dmoseg.draw.display import plot_clip_values

    first = next(iter(scores.values()))
    values = {name: table.matrix(metric) for name, table in scores.items()}  # reports an unknown metric
    spec = all_metrics()[metric]
    axis = f"{spec.title}{', %' if spec.percent else ''} ({spec.better} is better)"
    scaled = {name: spec.scale * value for name, value in values.items()}
    title = f"{first.benchmark.title}, {first.benchmark.coverage(first.names)}"
    return plot_clip_values(scaled, first.names, axis=axis, title=title, ax=ax)


def davis_files(scores: ScoreTable, ending: str = "") -> dict[str, str]:
    """Name and content of the two files that DAVIS scripts look for: fractions, one row per clip."""
    import pandas as pd

    frame = pd.DataFrame({f"{m}-Mean": scores.per_clip(m) for m in scores.metrics}, index=scores.names)
    form: Any = {"float_format": "%.6f", "lineterminator": "\n"}
    name = scores.benchmark.name + ending
    return {
        f"global_results-{name}.csv": frame.mean().to_frame().T.to_csv(index=False, **form),
        f"per-sequence_results-{name}.csv": frame.to_csv(index_label="Sequence", **form),
    }
