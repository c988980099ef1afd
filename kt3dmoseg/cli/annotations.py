"""Commands for annotations: those of other tools in and out, checks, two annotators."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from kt3dmoseg.app import Either, Flag, Folder, Name, Whole, group

if TYPE_CHECKING:
    from kt3dmoseg.annotate.exchange import ClipReport, Comparison

notes = group("annotations", "Import, export, check and compare the annotations of clips.")
Notes = Annotated[Folder, Parameter(help="Folder of <clip>.json.")]
Format = Annotated[Name, Parameter(help="One of cvat, coco, labelme, davis, mots_png or mots_txt.")]
Tracks = Annotated[Either | None, Parameter(help="Clip file or folder of them with trajectories.")]
_NOTES = Path("annotations")
_FAILED = 2


@notes.command(name="import")
def import_(
    source: Either,
    clips: Either,
    /,
    *,
    format: Format,
    annotations: Notes = _NOTES,
    merge: Flag = False,
    replace: Flag = False,
    shift: Whole | None = None,
    scale: float | None = None,
    force: Flag = False,
    dry_run: Flag = False,
) -> int:
    """Import files of another tool; what is done is printed, clip by clip.

    Exit code 2 when a clip failed, after the others. Doubtful imports, and those onto an annotation that
    exists, are refused unless an option decides.

    Parameters
    ----------
    source : path
        A file, or a folder with a file or folder named as each clip.
    clips : path
        A folder of frames, a clip file, or a folder with one of these per clip.
    merge : bool
        Add to annotations that exist.
    replace : bool
        Write over annotations that exist.
    shift : int
        Add this to the frame numbers in the files.
    scale : float
        Factor from the files' coordinates to pixels of the frames.
    force : bool
        Import also what is doubtful.
    dry_run : bool
        Only print what would be done.
    """
    from kt3dmoseg.annotate.exchange import import_annotations

    found = import_annotations(
        source,
        clips,
        format=format,
        annotations=annotations,
        merge=merge,
        replace=replace,
        shift=shift,
        scale=scale,
        force=force,
        dry_run=dry_run,
        report=_print,
    )
    return _code(found)


@notes.command
def export(
    clips: Either,
    /,
    *,
    output: Annotated[Folder, Parameter(alias="-o", help="Folder of the files.")],
    format: Format,
    annotations: Notes = _NOTES,
    tracks: Tracks = None,
) -> int:
    """Write annotations as files of another tool.

    Parameters
    ----------
    clips : path
        A folder of frames, a clip file, or a folder with one of these per clip.
    """
    from kt3dmoseg.annotate.exchange import export_annotations

    return _code(
        export_annotations(
            clips, output, format=format, annotations=annotations, tracks=tracks, report=_print
        )
    )


@notes.command
def check(clips: Either, /, *, annotations: Notes = _NOTES, tracks: Tracks = None) -> int:
    """Check annotations against their clips; exit code 2 when something is wrong.

    Parameters
    ----------
    clips : path
        A folder of frames, a clip file, or a folder with one of these per clip.
    """
    from kt3dmoseg.annotate.exchange import check_annotations

    return _code(check_annotations(clips, annotations=annotations, tracks=tracks, report=_print))


@notes.command
def compare(
    first: Folder, second: Folder, clips: Either, /, *, tracks: Tracks = None, json: Flag = False
) -> None:
    """Compare two annotators: the labels of trajectories (agreement, Cohen's kappa), and each object (IoU).

    Parameters
    ----------
    first : path
        Folder of <clip>.json of the one.
    second : path
        Folder of <clip>.json of the other.
    clips : path
        A folder of frames, a clip file, or a folder with one of these per clip.
    json : bool
        Print JSON.
    """
    from json import dumps

    from kt3dmoseg.annotate.exchange import compare_annotations
    from kt3dmoseg.tables import text_table

    found = compare_annotations(first, second, clips, tracks=tracks)
    if json:
        entries = [_entry(comparison) for comparison in found]
        print(dumps(entries, indent=1, ensure_ascii=False))
        return
    rows = []
    for c in found:
        a = c.agreement
        shown = ["", "", ""] if a is None else [f"{a.agreement:.2%}", f"{a.both:.2%}", f"{a.kappa:.3f}"]
        rows.append([c.clip, *shown, f"{sum(o[2] for o in c.objects) / max(1, len(c.objects)):.3f}", ""])
        rows += [["", "", "", "", f"{iou:.3f}", f"{a or '-'} / {b or '-'}"] for a, b, iou in c.objects]
    print(text_table(rows, ["clip", "agreement", "both labelled", "kappa", "IoU", "first / second"]))


def _entry(c: Comparison) -> dict[str, object]:
    keys = ("first", "second", "iou")
    a, objects = c.agreement, [dict(zip(keys, values, strict=True)) for values in c.objects]
    labels = {} if a is None else {"agreement": a.agreement, "both": a.both, "kappa": a.kappa}
    return {"clip": c.clip, **labels, "objects": objects}


def _print(report: ClipReport) -> None:
    print(f"{report.clip}:" + ("" if report.ok else " failed"))
    for line in report.lines:
        print(f"  {line}")


def _code(reports: list[ClipReport]) -> int:
    return 0 if all(report.ok for report in reports) else _FAILED
