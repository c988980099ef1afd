"""One clip of the report: its confusion, its motions, its overlay."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path

import numpy as np

from mseg.evaluation.contingency import Contingency
from mseg.evaluation.layout import count
from mseg.evaluation.metrics.motions import (
    f_per_motion,
    iou_per_motion,
    precision_per_motion,
    recall_per_motion,
)
from mseg.evaluation.report.viewer import group_colours, shown_groups, viewer
from mseg.evaluation.results import ScoreTable
from mseg.evaluation.validate import Validation


def clip_section(checked: Validation, scores: ScoreTable, name: str, frames: Path | None) -> str:
    """Make the section of a clip; tables are of the first seed, the overlay offers all."""
    runs = [scores.of(name, seed) for seed in scores.seeds]
    first = next((run for run in runs if run.table is not None), None)
    errors = [100 * run.values["error"] for run in runs]
    spread = f" (seeds {min(errors):.2f} to {max(errors):.2f})" if len(runs) > 1 else ""
    head = (
        f"<header><h3>{escape(name)}</h3><span>error <b>{np.mean(errors):.2f} %</b>{spread}</span>"
        f"<span class='quiet'>{runs[0].n} trajectories, {runs[0].n_motions} motions, "
        f"prevalence {100 * runs[0].prevalence:.2f}\u00a0%</span></header>"
    )
    bad = "".join(f"<p class='bad'>seed {r.seed}: {escape(r.reason)}</p>" for r in runs if r.reason)
    details = ""
    if first is not None and first.table is not None:
        note = f", seed {first.seed}" if len(runs) > 1 else ""
        titles = _motion_titles(first.table, checked.clips[name].labels.names)
        confusion, motions = _confusion(first.table, titles, note), _motions(first.table, titles, note)
        details = f"<div class='tables'>{confusion}{motions}</div>"
    overlay = viewer(checked, scores, name, frames)
    return f"<section class='clip' id='clip-{escape(name)}'>{head}{bad}{overlay}{details}</section>"


def _confusion(table: Contingency, titles: list[str], note: str) -> str:
    """Show the counts of motions (rows) in groups (columns), assigned groups first and outlined."""
    order = shown_groups(table)
    colours = group_colours(table)
    head = "".join(
        f"<th scope='col'><span class='dot' data-colour='{colours[j]}'></span>{table.groups[j]}</th>"
        for j in order
    )
    outliers = bool(table.unassigned.any())
    head += "<th scope='col'>outlier</th>" if outliers else ""
    rows = ""
    for i, title in enumerate(titles):
        cells = "".join(
            f"<td{' class=match' if table.assignment[i] == j else ''} "
            f"style='--h:{table.counts[i, j] / table.sizes[i]:.3f}'>{table.counts[i, j]}</td>"
            for j in order
        )
        cells += f"<td style='--h:0'>{table.unassigned[i]}</td>" if outliers else ""
        rows += f"<tr><th scope='row'>{title}</th>{cells}</tr>"
    return (
        "<div class='scroll'><table class='confusion'><caption>Confusion: true motions in predicted groups"
        f"{note}; outlined = assigned</caption><thead><tr><th></th>{head}</tr></thead><tbody>{rows}</tbody>"
        "</table></div>"
    )


def _motions(table: Contingency, titles: list[str], note: str) -> str:
    columns = [f(table) for f in (precision_per_motion, recall_per_motion, f_per_motion, iou_per_motion)]
    rows = ""
    for i, title in enumerate(titles):
        cells = "".join(f"<td>{100 * column[i]:.1f}</td>" for column in columns)
        rows += f"<tr><th scope='row'>{title}</th><td>{table.sizes[i]}</td>{cells}</tr>"
    head = "".join(f"<th scope='col'>{c}</th>" for c in ("", "n", "precision", "recall", "F", "IoU"))
    found = count(len(table.groups), "group")
    return (
        f"<div class='scroll'><table><caption>Per motion, %{note}; {found} found</caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _motion_titles(table: Contingency, names: Mapping[int, str]) -> list[str]:
    """Give the head of every motion's row: its colour, number and name."""
    called = {i: names.get(int(motion), "") for i, motion in enumerate(table.motions)}
    if table.background is not None:
        called[table.background] = called[table.background] or "background"
    return [
        f"<span class='dot' data-colour='{i + 1}'></span>{motion} {escape(called[i])}".rstrip()
        for i, motion in enumerate(table.motions)
    ]
