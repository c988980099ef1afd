"""One self-contained page about one submission or several: tables, bars, confusions, overlays.

Pages are jinja2 templates of ``static/`` with automatic escaping, and pictures inside; here is what
``report.html`` computes with.
"""

import base64
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.draw.palette import css_palette
from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.files import PathLike, check_target, write_text
from kt3dmoseg.types import ByteArray, Clip, IntArray
from mseg.evaluation import results
from mseg.evaluation.axes import AXES
from mseg.evaluation.comparison import compare, comparison_table, signed
from mseg.evaluation.contingency import Contingency
from mseg.evaluation.scoring import ScoreTable, clip_json, score_validated
from mseg.evaluation.validation import Validation, load_clips, validate_submission

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"  # of the methods
_ENDINGS = {"latex": "tex", "markdown": "md", "csv": "csv", "json": "json"}
_MISSING = -32768
_CLIP_CHARACTERS = 2_900_000  # of the pictures and positions of one clip
_PICTURE_CHARACTERS = 9_000_000  # of the pictures of all clips, so that the page opens in a second
_POSITION_CHARACTERS = 1_200_000  # of positions and labels, so that pictures find room
_STEPS = (0.01, 0.02, 0.05, 0.10, 0.15, 0.20, 0.25)
# Width and JPEG quality of pictures: the first with which all of a clip fit.
_SIZES = ((960, 72), (800, 65), (640, 60), (480, 55), (320, 50))


def render(template: str, **values: object) -> str:
    """Fill in a template of ``static/``."""
    return str(_environment().get_template(template).render(palette=css_palette(), **values))


@cache
def _environment() -> Any:  # noqa: ANN401  # a jinja2 environment
    from jinja2 import Environment, FileSystemLoader

    loader = FileSystemLoader(Path(__file__).with_name("static"))
    made = Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    made.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    made.filters["mean"] = np.mean
    made.filters["percent"] = lambda value, digits=2: f"{100 * value:.{digits}f}"
    made.filters["points"] = signed
    # The round distance of the lines of a bar's axis, four of which hold all values, and where a value lies.
    made.filters["step"] = lambda top: next((step for step in _STEPS if 4 * step >= top), _STEPS[-1])
    made.filters["along"] = lambda value, step: f"{25 * min(4.0, value / step):.2f}%"
    return made


def write_report(
    submission: PathLike | Sequence[PathLike],
    data: PathLike | Mapping[str, Clip] | Iterable[Clip],
    path: PathLike,
    *,
    frames: PathLike | None = None,
    benchmark: str = "",
    force: bool = False,
    extras: Sequence[str] = (),
) -> list[Path]:
    """Validate and score one submission or several, and write the page about them.

    Parameters
    ----------
    submission : path or sequence of paths
        Folders or zips; several are shown side by side.
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
        Tables to write next to the page, per submission; "csv" includes the two DAVIS-style files.

    Returns
    -------
    list of Path
        The files written, the page first.

    Raises
    ------
    RejectedSubmissionError, InputFileError, InvalidValueError
        When a submission is invalid and not `force`; when the frames of a clip are incomplete, or there are
        none of any clip; when several are not of the same clips, or `path` does not end in .html.
    """
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise InvalidValueError(os.fspath(path), expected="a page, ending in .html", found="another ending")
    page, given = Path(path), [submission] if isinstance(submission, (str, os.PathLike)) else [*submission]
    if len(given) > len(LETTERS):
        raise InvalidValueError(
            "report", expected=f"at most {len(LETTERS)} submissions", found=str(len(given))
        )
    check_target(page)
    clips = load_clips(data)
    checked = [validate_submission(each, clips, benchmark=benchmark) for each in given]
    scores = [score_validated(each, force=force) for each in checked]
    contents = {page.name: report_html(checked, scores, frames=frames)}
    stems = [re.sub(r"[^\w.=-]+", "-", f"{page.stem}-{name}") for name in results.unique_names(scores)]
    for letter, stem, table in zip(LETTERS, stems, scores, strict=False):
        own = stem if stems.count(stem) == 1 else f"{stem}-{letter}"
        name = page.stem if len(given) == 1 else own
        for form in (each for each in _ENDINGS if each in extras):
            contents[f"{name}.{_ENDINGS[form]}"] = results.rendered(table, form) + "\n"
        if "csv" in extras:
            contents |= results.davis_files(table, "" if name == "report" else f"-{name}")
    for name, content in contents.items():
        write_text(page.with_name(name), content)
    return [page.with_name(name) for name in contents]


def report_html(
    checked: Sequence[Validation],
    scores: Sequence[ScoreTable],
    *,
    frames: PathLike | None = None,
    overlays: bool = True,
) -> str:
    """Make the page from validated and scored submissions.

    Without `overlays` it holds scores only: nothing from which true labels could be read.
    """
    first, comparison = scores[0], compare(scores) if len(scores) > 1 else None
    methods = list(zip(LETTERS, results.unique_names(scores), scores, strict=False))
    errors = dict(zip(first.names, zip(*(table.matrix() for table in scores), strict=True), strict=True))
    order = sorted(errors, key=lambda name: -np.mean([run.mean() for run in errors[name]]))
    clips = [checked[0].clips[name] for name in order]
    pictures = _pictures(clips, Path(frames)) if frames is not None else {}
    sections = [_section(checked, scores, n, pictures.get(n, [])) for n in order] if overlays else []
    return render(
        "report.html",
        all_scores=scores,
        methods=methods,
        method_names=[f"{letter} {name}" if comparison else name for letter, name, _ in methods],
        highest=max(table.summary().interval.high for table in scores),
        top=max(float(table.matrix().max()) for table in scores),
        comparison=comparison,
        errors={name: errors[name] for name in order},
        prevalence={name: first.of(name).prevalence for name in order},
        sections=sections,
        axes=_by_track_axis(sections),
        axis_titles={axis.name: [axis.title, *axis.titles, "not known"] for axis in AXES},
        tables=[make(*scores) for make in (results.headline, results.by_axis, results.all_means)],
        clip_table=comparison_table(comparison) if comparison else results.per_clip(first),
    )


def _by_track_axis(sections: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Give of every bin of each property: the number of trajectories, errors of the methods, worst clips."""
    found = []
    for axis in AXES if sections else ():
        rows = []
        for k, title in enumerate((*axis.titles, "not known")):
            parts = {s["name"]: s["wrong"][:, s["scored"] & (s["bins"][axis.name] == k)] for s in sections}
            wrong = np.concatenate(list(parts.values()), axis=1)
            if not wrong.shape[1]:
                continue
            most = {
                name: round(float(part.sum(axis=1).max()), 1) for name, part in parts.items() if part.any()
            }
            worst = sorted(most.items(), key=lambda each: -each[1])[:8]
            row = {"title": title, "bin": k, "n": wrong.shape[1], "worst": worst}
            rows.append(row | {"errors": wrong.mean(axis=1).tolist()})
        found.append({"axis": axis, "rows": rows})
    return found


def _pictures(clips: Sequence[Clip], folder: Path) -> dict[str, list[ByteArray]]:
    """Read the frames of every clip that has some in the folder, (H, W) gray."""
    from kt3dmoseg.frames import frame_folder, frames_of  # scoring does without OpenCV

    found = {clip.name: frames_of(clip, folder) for clip in clips if frame_folder(clip, folder)}
    if not found:
        names = f"a folder of pictures per clip, such as {clips[0].name}"
        expected = f"{names}, or the KITTI raw root of the build"
        raise InputFileError(f"{folder}", expected=expected, found="none of any clip")
    return found


def _section(
    checked: Sequence[Validation], scores: Sequence[ScoreTable], name: str, pictures: Sequence[ByteArray]
) -> dict[str, Any]:
    """Collect what is shown of a clip; tables are of the first seed, the overlay offers all."""
    clip = checked[0].clips[name]
    truth, size = clip.labels.label, _size(clip, pictures)
    scale = min(10.0, 32000 / max(size))
    bins = {axis.name: axis.bins(clip, size) for axis in AXES}
    n_runs = sum(len(table.seeds) for table in scores)
    drawn = _drawn(truth, _POSITION_CHARACTERS // (6 * clip.n_frames + 3 * (n_runs + len(AXES)) + 24))
    runs, wrong = [], []
    for k, (check, table) in enumerate(zip(checked, scores, strict=True)):
        shown = {seed: _shown(check, table, clip, seed) for seed in table.seeds}
        off = {seed: (truth > 0) & (labels != truth) for seed, labels in shown.items()}
        wrong.append(np.mean(list(off.values()), axis=0))
        for seed in (s for s in table.seeds if not table.of(name, s).reason):
            packed = {"shown": _packed(shown[seed][drawn]), "wrong": _packed(off[seed][drawn])}
            runs.append({"method": k, "seed": seed, **packed})
    payload = {
        "width": size[0],
        "height": size[1],
        "n_frames": clip.n_frames,
        "background": clip.labels.background or 0,
        "scale": scale,
        "numbers": clip.frame_numbers.tolist(),
        "ids": clip.evaluated_trajectories.track_id[drawn].tolist(),
        "xy": _packed_positions(clip, drawn, scale),
        "truth": _packed(truth[drawn]),
        "bins": {name: _packed(values[drawn]) for name, values in bins.items()},
        "runs": runs,
    }
    room = min(_CLIP_CHARACTERS - len(json.dumps(payload)), _PICTURE_CHARACTERS // len(scores[0].names))
    return {
        "name": name,
        "thinned": "" if len(drawn) == len(truth) else f"{len(drawn)} of {len(truth)}",
        "payload": payload | {"frames": jpegs(pictures, room)},
        "seeds": sorted({run["seed"] for run in runs}),
        "wrong": np.array(wrong),  # (methods, n), mean over seeds
        "scored": truth > 0,
        "bins": bins,
        "methods": [_method_tables(table, clip) for table in scores],
    }


def _method_tables(scores: ScoreTable, clip: Clip) -> dict[str, Any]:
    """Collect the runs of a method on a clip, and the tables of the first with labels."""
    runs = [scores.of(clip.name, seed) for seed in scores.seeds]
    run = next((each for each in runs if each.table is not None), None)
    if run is None or run.table is None:
        return {"runs": runs}
    motions, names = clip_json(run)["motions"], dict(clip.labels.names)
    for each in motions:
        names.setdefault(each["motion"], "background" if each["background"] else "")
    colours = _group_colours(run.table)
    return {"runs": runs, "seed": run.seed, "names": names, "motions": motions, "colours": colours}


def _group_colours(table: Contingency) -> dict[int, int]:
    """Give an assigned group the colour number of its motion, the others, by size, numbers of their own."""
    motions, groups = table.motions.tolist(), table.groups.tolist()
    colours = {groups[j]: m for m, j in zip(motions, table.assignment, strict=True) if j >= 0}
    sizes = dict(zip(groups, table.counts.sum(axis=0).tolist(), strict=True))
    free = sorted(sizes.keys() - colours, key=lambda group: (-sizes[group], group))
    return colours | {group: i for i, group in enumerate(free, max(motions) + 1)}


# --- the overlay: positions, labels and frames packed for the page's script -------------------------


def _shown(checked: Validation, scores: ScoreTable, clip: Clip, seed: int) -> IntArray:
    """Give the colour numbers of a run, (n,): right where they equal the truth; -1 without labels."""
    table = scores.of(clip.name, seed).table
    if table is None:
        return np.full(len(clip.labels), -1)
    groups, of_group = np.unique(checked.labels[seed, clip.name], return_inverse=True)
    colours = _group_colours(table)
    return np.array([colours.get(group, 0) for group in groups.tolist()])[of_group]


def _packed(values: npt.NDArray[Any]) -> str:
    return base64.b64encode(np.minimum(values, 255).astype(np.uint8).tobytes()).decode()


def _drawn(truth: IntArray, most: int) -> IntArray:
    """Rows of at most so many trajectories to draw, the same share of each motion; sorted."""
    order = np.argsort(truth, kind="stable")
    chosen = np.linspace(0, len(order) - 1, min(max(1, most), len(order))).astype(np.int64)
    return np.sort(order[chosen])


def _packed_positions(clip: Clip, drawn: IntArray, scale: float) -> str:
    tracks = clip.evaluated_trajectories.select(drawn)
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
    from kt3dmoseg.draw.painting import extent  # Codabench scores without OpenCV

    return extent(clip.dense)


def jpegs(pictures: Sequence[ByteArray], most: int) -> list[str]:
    """Write pictures (H, W) or (H, W, 3) as addresses of data, one or more: at most so many characters.

    Where small pictures are too many as well, some are left empty: every second one, or more.
    """
    from kt3dmoseg.io.images import jpeg_address  # Codabench scores without OpenCV

    for width, quality in _SIZES:
        made = [jpeg_address(picture, width, quality) for picture in pictures]
        if sum(map(len, made)) <= most:
            return made
    fitting = (step for step in range(2, len(made)) if sum(map(len, made[::step])) <= most)
    step = next(fitting, len(made))  # at least one is shown
    return [address if i % step == 0 else "" for i, address in enumerate(made)]
