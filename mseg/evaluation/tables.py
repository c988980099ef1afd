"""The tables of a scored submission, and its JSON and DAVIS-style files."""

from __future__ import annotations

from collections.abc import Sequence

from mseg.evaluation.layout import TextTable
from mseg.evaluation.metrics import Metric, all_metrics
from mseg.evaluation.protocol import Group
from mseg.evaluation.results import ScoreTable, Summary

MAIN_METRICS = ("error", "adjusted_rand", "nmi", "f_measure", "iou", "moving_f")
_ABSENT = "-"


def headline(scores: ScoreTable, *, published: bool = True) -> TextTable:
    """Classification error per group of the benchmark, beside the published rows.

    Parameters
    ----------
    scores : ScoreTable
        One submission.
    published : bool
        Add the rows of Table 1 of Xu et al. 2018, where the benchmark has them.
    """
    groups = list(scores.groups())
    columns = [""]
    for group, _ in groups:
        columns += [f"{group.title}: mean", "median"]
    rows = [_own_row(scores, groups)]
    if published:
        rows += _published_rows(scores, groups)
    return TextTable(
        f"{scores.benchmark.title}: classification error in %", columns, rows, headline_notes(scores)
    )


def headline_notes(scores: ScoreTable) -> list[str]:
    """Say what is needed to read the headline rightly: coverage, failures, versions, seeds."""
    protocol = scores.benchmark
    notes = [f"Scored: {protocol.coverage(scores.names)}{_groups_present(scores)}."]
    if len(scores.names) < protocol.n_clips:
        notes.append("A part of the benchmark: the published figures are for all of it.")
    version, wanted = scores.provenance.dataset_version, protocol.published_dataset_version
    if protocol.published and wanted and version != wanted:
        notes.append(
            f"Data version {version!r}; published figures are for version {wanted!r}: not comparable."
        )
    notes.append(_spread(scores, scores.summary()))
    notes += [f"Counted as fully wrong: {c.clip} (seed {c.seed}): {c.reason}." for c in scores.failures]
    return notes


def per_clip(scores: ScoreTable, metrics: Sequence[str] = MAIN_METRICS) -> TextTable:
    """Every clip, means over seeds, beside the prevalence baseline."""
    specs = all_metrics()
    columns = ["clip", "n", "motions", "found", "prevalence", *(specs[m].title for m in metrics)]
    values = {m: scores.per_clip(m) for m in metrics}
    rows = []
    for i, name in enumerate(scores.names):
        runs = [scores.of(name, seed) for seed in scores.seeds]
        found = sorted({run.n_found for run in runs})
        mark = " *" if any(run.reason for run in runs) else ""
        row = [
            name + mark,
            str(runs[0].n),
            str(runs[0].n_motions),
            "/".join(map(str, found)),
            f"{100 * runs[0].prevalence:.2f}",
        ]
        rows.append(row + [_show(specs[m], float(values[m][i])) for m in metrics])
    notes = ["* failed or missing: the worst score."] if scores.failures else []
    return TextTable("Per clip, fractions in %", columns, rows, notes)


def all_means(scores: ScoreTable) -> TextTable:
    """Every metric: mean, median and pooled over clips, sd over seeds, 95 % interval."""
    rows = []
    for name, metric in all_metrics().items():
        summary = scores.summary(name)
        values = [summary.mean, summary.median, summary.pooled]
        spread = _ABSENT if summary.seed_sd is None else _show(metric, summary.seed_sd)
        low, high = summary.interval
        interval = f"{_show(metric, low)} to {_show(metric, high)}"
        rows.append([metric.title, metric.better, *(_show(metric, v) for v in values), spread, interval])
    columns = ["metric", "better", "mean", "median", "pooled", "sd over seeds", "95 % over clips"]
    return TextTable("Over all clips scored, fractions in %", columns, rows)


def davis_files(scores: ScoreTable) -> dict[str, str]:
    """Name and content of the two files that DAVIS scripts look for: fractions, one row per clip."""
    name, metrics = scores.benchmark.name, scores.metrics
    means = [f"{scores[m]:.6f}" for m in metrics]
    rows = [[clip, *(f"{scores.per_clip(m)[i]:.6f}" for m in metrics)] for i, clip in enumerate(scores.names)]
    titles = [f"{m}-Mean" for m in metrics]
    return {
        f"global_results-{name}.csv": TextTable("", titles, [means]).csv(),
        f"per-sequence_results-{name}.csv": TextTable("", ["Sequence", *titles], rows).csv(),
    }


def published_for(scores: ScoreTable, group: Group) -> dict[str, dict[str, float]]:
    """Return the published mean and median (in %) of each method on a group of the benchmark."""
    found = {m: dict(parts.get(group.name, {})) for m, parts in scores.benchmark.published.items()}
    return {method: values for method, values in found.items() if values}


def _own_row(scores: ScoreTable, groups: list[tuple[Group, list[str]]]) -> list[str]:
    row = [scores.meta.method]
    for _, names in groups:
        if not names:
            row += [_ABSENT, _ABSENT]
            continue
        summary = scores.summary("error", names)
        sd = "" if summary.seed_sd is None else f" ±{100 * summary.seed_sd:.2f}"
        row += [f"{100 * summary.mean:.2f}{sd}", f"{100 * summary.median:.2f}"]
    return row


def _published_rows(scores: ScoreTable, groups: list[tuple[Group, list[str]]]) -> list[list[str]]:
    rows = []
    for method in scores.benchmark.published:
        row = [f"{method} (published, all {scores.benchmark.n_clips})"]
        for group, _ in groups:
            values = published_for(scores, group).get(method, {})
            row += [f"{values[k]:.2f}" if k in values else _ABSENT for k in ("mean", "median")]
        rows.append(row)
    return rows


def _groups_present(scores: ScoreTable) -> str:
    groups = list(scores.groups())
    if len(groups) == 1:
        return ""
    parts = []
    for group, names in groups:
        count = "which clips is not published" if group.unknown else f"{len(names)} of {group.n_clips}"
        parts.append(f"{group.title} {count}")
    return " (" + ", ".join(parts) + ")"


def _spread(scores: ScoreTable, summary: Summary) -> str:
    low, high = summary.interval
    seeds = f"{len(scores.seeds)} seeds" if summary.seed_sd is not None else "1 seed"
    sd = f", sd over seeds {100 * summary.seed_sd:.2f}" if summary.seed_sd is not None else ""
    return (
        f"{seeds}{sd}; 95 % bootstrap interval over clips {100 * low:.2f} to {100 * high:.2f}; "
        f"all trajectories pooled {100 * summary.pooled:.2f}."
    )


def _show(metric: Metric, value: float) -> str:
    return f"{100 * value:.2f}" if metric.percent else f"{value:.2f}"


def meta_lines(scores: ScoreTable) -> list[tuple[str, str]]:
    """List what the submission says about itself and what it was scored on, as (name, value)."""
    meta, source = scores.meta, scores.provenance
    lines = [
        ("method", meta.method),
        ("authors", ", ".join(meta.authors)),
        ("link", meta.link),
        ("number of motions", "given" if meta.n_motions_given else "found by the method"),
        ("hardware", meta.hardware),
        ("time per seed", f"{meta.seconds:g} s" if meta.seconds else ""),
        ("parameters", ", ".join(f"{k} = {v}" for k, v in meta.parameters.items())),
        ("dataset version", source.dataset_version),
        ("dataset sha256", source.dataset_sha256[:16]),
        ("submission sha256", source.submission_sha256[:16]),
        ("toolkit", source.toolkit_version),
    ]
    return [(name, value) for name, value in lines if value]
