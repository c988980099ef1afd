"""One self-contained page about a submission: tables, bars, confusions, overlays."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path

from kt3dmoseg.errors import InputFileError
from kt3dmoseg.files import write_text
from kt3dmoseg.frames import frame_folder
from kt3dmoseg.types import Clip
from mseg.evaluation import tables
from mseg.evaluation.jsonform import to_json
from mseg.evaluation.page import html_table, page
from mseg.evaluation.report.bars import bars_per_clip, bars_published
from mseg.evaluation.report.clip import clip_section
from mseg.evaluation.results import ScoreTable
from mseg.evaluation.scoring import score_validated
from mseg.evaluation.validate import Validation, validate_submission

# What identifies a run rather than describes it: behind a click.
_ORIGIN = ("parameters", "dataset sha256", "submission sha256", "toolkit")


def write_report(
    submission: str | os.PathLike[str],
    data: str | os.PathLike[str] | Mapping[str, Clip] | Iterable[Clip],
    path: str | os.PathLike[str],
    *,
    frames: str | os.PathLike[str] | None = None,
    benchmark: str = "",
    force: bool = False,
    extras: Sequence[str] = (),
) -> list[Path]:
    """Validate and score a submission and write the page about it.

    Parameters
    ----------
    submission : path
        Folder or zip.
    data : path, mapping or iterable of Clip
        The clips with their labels.
    path : path
        The page, ``report.html``.
    frames : path, optional
        Folder with one sub-folder of numbered pictures per clip; without it points are drawn on
        a plain ground.
    benchmark : str
        Protocol; by default the submission's own.
    force : bool
        Report an invalid submission, its faulty clips counted as fully wrong.
    extras : sequence of {"latex", "markdown", "csv", "json"}
        Tables to write beside the page; "csv" includes the two DAVIS-style files.

    Returns
    -------
    list of Path
        The files written, the page first.

    Raises
    ------
    RejectedSubmissionError
        When the submission is invalid and not `force`.
    InputFileError
        When the frames of a clip are incomplete, or there are none of any clip.
    """
    checked = validate_submission(submission, data, benchmark=benchmark)
    scores = score_validated(checked, force=force)
    target = Path(path)
    write_text(target, report_html(checked, scores, frames=frames))
    return [target, *_write_extras(scores, target, extras)]


def report_html(
    checked: Validation,
    scores: ScoreTable,
    *,
    frames: str | os.PathLike[str] | None = None,
    overlays: bool = True,
) -> str:
    """Make the page from a validated and scored submission.

    Without `overlays` it holds scores only: nothing from which true labels could be read.
    """
    order = sorted(scores.names, key=lambda name: -scores.per_clip()[scores.names.index(name)])
    folder = Path(frames) if frames is not None else None
    if folder is not None and all(frame_folder(checked.clips[name], folder) is None for name in order):
        raise InputFileError(
            f"{folder}",
            expected=f"a folder of pictures per clip, such as {order[0]}, or the KITTI raw root of the build",
            found="none of any clip",
        )
    body = "".join(
        [
            _head(scores, overlays=overlays),
            _cards(scores),
            _failures(scores),
            "<h2 id='clips'>Per clip, worst first</h2>",
            bars_per_clip(scores, order, linked=overlays),
            bars_published(scores),
            _overlays(checked, scores, order, folder) if overlays else "",
            "<h2 id='table'>Benchmark table</h2>",
            html_table(tables.headline(scores), marks={0: "own"}),
            "<h2 id='metrics'>All metrics</h2>",
            html_table(tables.all_means(scores)),
            html_table(tables.per_clip(scores)),
        ]
    )
    return page(f"{scores.meta.method} on {scores.benchmark.title}", body, script="report")


def _overlays(checked: Validation, scores: ScoreTable, order: Sequence[str], folder: Path | None) -> str:
    clips = "".join(clip_section(checked, scores, name, folder) for name in order)
    return (
        "<h2 id='overlays'>Truth and prediction, worst first</h2>"
        "<p class='quiet'>Predicted groups have the colour of the motion they are assigned to; "
        f"errors are ringed in red. The slider takes arrow keys.</p>{clips}"
    )


def _head(scores: ScoreTable, *, overlays: bool) -> str:
    facts = {name: value for name, value in tables.meta_lines(scores) if name != "method"}
    origin = {name: facts.pop(name) for name in _ORIGIN if name in facts}
    links = {"clips": "Clips", **({"overlays": "Pictures"} if overlays else {})}
    links |= {"table": "Table", "metrics": "Metrics"}
    jump = "".join(f"<a href='#{key}'>{title}</a>" for key, title in links.items())
    return (
        f"<header class='head'><div><h1>{escape(scores.meta.method)}</h1>"
        f"<p>{escape(scores.benchmark.title)}, {escape(scores.benchmark.coverage(scores.names))}</p></div>"
        f"<nav class='jump' aria-label='Sections'>{jump}</nav></header>{_facts(facts)}"
        f"<details><summary class='quiet'>parameters and provenance</summary>{_facts(origin)}</details>"
    )


def _facts(facts: Mapping[str, str]) -> str:
    items = "".join(f"<li>{escape(name)} <b>{escape(value)}</b></li>" for name, value in facts.items())
    return f"<ul class='facts'>{items}</ul>"


def _failures(scores: ScoreTable) -> str:
    if not scores.failures:
        return ""
    lines = "".join(
        f"<p>{escape(c.clip)}, seed {c.seed}: {escape(c.reason)}</p>" for c in scores.failures[:30]
    )
    more = f"<p>and {len(scores.failures) - 30} more</p>" if len(scores.failures) > 30 else ""
    return f"<div class='notice' role='note'><p><b>Counted as fully wrong</b></p>{lines}{more}</div>"


def _cards(scores: ScoreTable) -> str:
    summary = scores.summary()
    low, high = summary.interval
    prevalence = sum(scores.of(n).prevalence for n in scores.names) / len(scores.names)
    cards = [
        (f"{100 * summary.mean:.2f} %", f"mean error, {scores.benchmark.coverage(scores.names)}"),
        (f"{100 * summary.median:.2f} %", "median error"),
        (f"{100 * low:.1f}–{100 * high:.1f} %", "95 % interval of the mean, over clips"),
        (f"{100 * prevalence:.2f} %", "prevalence baseline, same clips"),
    ]
    if summary.seed_sd is not None:
        cards.insert(2, (f"± {100 * summary.seed_sd:.2f}", f"sd over {len(scores.seeds)} seeds"))
    if scores.failures:
        cards.append((f"{len({c.clip for c in scores.failures})}", "failed or missing clips"))
    inner = "".join(
        f"<div class='card'><b>{escape(value)}</b><span>{escape(text)}</span></div>" for value, text in cards
    )
    return f"<div class='cards'>{inner}</div>"


def _write_extras(scores: ScoreTable, target: Path, extras: Sequence[str]) -> list[Path]:
    headline = tables.headline(scores)
    contents: dict[str, str] = {}
    if "latex" in extras:
        contents[f"{target.stem}.tex"] = headline.latex() + "\n"
    if "markdown" in extras:
        contents[f"{target.stem}.md"] = headline.markdown() + "\n"
    if "csv" in extras:
        contents[f"{target.stem}.csv"] = tables.per_clip(scores, scores.metrics).csv()
        contents |= tables.davis_files(scores)
    if "json" in extras:
        contents[f"{target.stem}.json"] = json.dumps(to_json(scores), indent=1) + "\n"
    for name, content in contents.items():
        write_text(target.with_name(name), content)
    return [target.with_name(name) for name in contents]
