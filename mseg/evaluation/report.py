"""One self-contained page about a submission: tables, bars, confusions, overlays.

The page is ``static/report.html``, a jinja2 template with automatic escaping; here is what it computes with.
"""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.draw.palette import css_palette
from kt3dmoseg.errors import InputFileError
from kt3dmoseg.files import check_target, write_text
from kt3dmoseg.types import ByteArray, Clip
from mseg.evaluation import results
from mseg.evaluation.contingency import Contingency
from mseg.evaluation.scoring import ScoreTable, clip_json, score_validated, to_json
from mseg.evaluation.validation import Validation, validate_submission

_STEPS = (0.01, 0.02, 0.05, 0.10, 0.15, 0.20, 0.25)
_MISSING = -32768
_MAX_WIDTH = 960
_QUALITY = 72


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
        Tables to write next to the page; "csv" includes the two DAVIS-style files.

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
    page = Path(path)
    check_target(page)
    checked = validate_submission(submission, data, benchmark=benchmark)
    scores = score_validated(checked, force=force)
    contents = {page.name: report_html(checked, scores, frames=frames)}
    if "latex" in extras:
        contents[f"{page.stem}.tex"] = results.headline(scores).latex() + "\n"
    if "markdown" in extras:
        contents[f"{page.stem}.md"] = results.headline(scores).markdown() + "\n"
    if "csv" in extras:
        contents[f"{page.stem}.csv"] = results.per_clip(scores, scores.metrics).csv()
        contents |= results.davis_files(scores, "" if page.stem == "report" else f"-{page.stem}")
    if "json" in extras:
        contents[f"{page.stem}.json"] = json.dumps(to_json(scores), indent=1) + "\n"
    for name, content in contents.items():
        write_text(page.with_name(name), content)
    return [page.with_name(name) for name in contents]


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
    errors = dict(zip(scores.names, scores.matrix(), strict=True))
    order = sorted(errors, key=lambda name: -errors[name].mean())
    pictures = _pictures([checked.clips[name] for name in order], Path(frames)) if frames is not None else {}
    prevalence = {name: scores.of(name).prevalence for name in order}
    published = []  # per group of the benchmark, the mean error among the published means, best first
    for group, names in scores.groups():
        parts = {method: parts.get(group.name) for method, parts in scores.benchmark.published.items()}
        rows = [(known["mean"] / 100, method, "") for method, known in parts.items() if known]
        if names and rows:
            own = (scores.summary("error", names).mean, f"{scores.meta.method} (this submission)", "own")
            published.append((group.title, sorted([own, *rows])))
    return render(
        "report.html",
        scores=scores,
        palette=css_palette(),
        errors={name: errors[name] for name in order},
        prevalence=prevalence,
        published=published,
        sections=[_section(checked, scores, n, pictures.get(n, [])) for n in order if overlays],
        headline=results.headline(scores),
        by_axis=results.by_axis(scores),
        all_means=results.all_means(scores),
        per_clip=results.per_clip(scores),
    )


def render(template: str, **values: object) -> str:
    """Fill in a template of ``static/``."""
    return str(_environment().get_template(template).render(**values))


@cache
def _environment() -> Any:  # noqa: ANN401  # a jinja2 environment
    from jinja2 import Environment, FileSystemLoader

    loader = FileSystemLoader(Path(__file__).with_name("static"))
    made = Environment(loader=loader, autoescape=True, trim_blocks=True)
    made.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    made.filters["mean"] = np.mean
    made.filters["percent"] = lambda value, digits=2: f"{100 * value:.{digits}f}"
    # The round distance of the lines of a bar's axis, four of which hold all values, and where a value lies.
    made.filters["step"] = lambda top: next((step for step in _STEPS if 4 * step >= top), _STEPS[-1])
    made.filters["along"] = lambda value, step: f"{25 * min(4.0, value / step):.2f}%"
    return made


def _pictures(clips: Sequence[Clip], folder: Path) -> dict[str, list[ByteArray]]:
    """Read the frames of every clip that has some in the folder, (H, W) gray."""
    from kt3dmoseg.frames import frame_folder, frames_of

    found = {clip.name: frames_of(clip, folder) for clip in clips if frame_folder(clip, folder)}
    if not found:
        names = f"a folder of pictures per clip, such as {clips[0].name}"
        expected = f"{names}, or the KITTI raw root of the build"
        raise InputFileError(f"{folder}", expected=expected, found="none of any clip")
    return found


def _section(
    checked: Validation, scores: ScoreTable, name: str, pictures: Sequence[ByteArray]
) -> dict[str, Any]:
    """Collect what is shown of a clip; tables are of the first seed, the overlay offers all."""
    clip = checked.clips[name]
    runs = [scores.of(name, seed) for seed in scores.seeds]
    tables = {run.seed: run.table for run in runs if run.table is not None}
    width, height = _size(clip, pictures)
    scale = min(10.0, 32000 / max(width, height))
    section: dict[str, Any] = {
        "name": name,
        "runs": runs,
        "drawn": list(tables),
        "payload": {
            "width": width,
            "height": height,
            "n_frames": clip.n_frames,
            "background": clip.labels.background or 0,
            "scale": scale,
            "numbers": clip.frame_numbers.tolist(),
            "xy": _packed_positions(clip, scale),
            "truth": _packed(clip.labels.label),
            "runs": [_drawn(checked, clip, seed, table) for seed, table in tables.items()],
            "frames": [_jpeg(picture) for picture in pictures],
        },
    }
    if not tables:
        return section
    seed, names = next(iter(tables)), dict(clip.labels.names)
    motions = clip_json(scores.of(name, seed))["motions"]
    for each in motions:
        names.setdefault(each["motion"], "background" if each["background"] else "")
    return section | {
        "seed": seed,
        "names": names,
        "motions": motions,
        "colours": _group_colours(tables[seed]),
    }


def _group_colours(table: Contingency) -> dict[int, int]:
    """Give an assigned group the colour number of its motion, the others, by size, numbers of their own."""
    motions, groups = table.motions.tolist(), table.groups.tolist()
    colours = {groups[j]: m for m, j in zip(motions, table.assignment, strict=True) if j >= 0}
    sizes = dict(zip(groups, table.counts.sum(axis=0).tolist(), strict=True))
    free = sorted(sizes.keys() - colours, key=lambda group: (-sizes[group], group))
    return colours | {group: i for i, group in enumerate(free, max(motions) + 1)}


# --- the overlay: positions, labels and frames packed for the page's script -------------------------


def _drawn(checked: Validation, clip: Clip, seed: int, table: Contingency) -> dict[str, str]:
    """Colours and errors of a run's trajectories."""
    labels, truth = checked.labels[seed, clip.name], clip.labels.label
    colour = np.zeros(int(labels.max(initial=0)) + 1, dtype=np.int64)
    for group, number in _group_colours(table).items():
        colour[group] = number
    shown = colour[labels]
    return {"shown": _packed(shown), "wrong": _packed((truth > 0) & (shown != truth))}


def _packed(values: npt.NDArray[Any]) -> str:
    return base64.b64encode(np.minimum(values, 255).astype(np.uint8).tobytes()).decode()


def _packed_positions(clip: Clip, scale: float) -> str:
    tracks = clip.evaluated_trajectories
    steps = np.rint(np.where(tracks.visible[..., None], tracks.xy, 0.0) * scale)
    small = np.clip(steps, -32767, 32767).astype("<i2")
    small[~tracks.visible] = _MISSING
    return base64.b64encode(small.tobytes()).decode()


def _size(clip: Clip, pictures: Sequence[ByteArray]) -> tuple[int, int]:
    """Width and height of the pictures; else of what holds all points."""
    if clip.dense.image_size is not None:
        return clip.dense.image_size
    if pictures:
        height, width = pictures[0].shape
        return width, height
    xy = clip.dense.xy[clip.dense.visible]
    width, height = np.maximum(1, np.ceil(xy.max(axis=0, initial=0)) + 1).astype(int).tolist()
    return width, height


def _jpeg(picture: ByteArray) -> str:
    import cv2

    height, width = picture.shape
    size = (_MAX_WIDTH, round(height * _MAX_WIDTH / width))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA) if width > _MAX_WIDTH else picture
    _, content = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return "data:image/jpeg;base64," + base64.b64encode(content.tobytes()).decode()
