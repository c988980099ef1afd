"""Annotations of many clips: import, export, check, compare. A clip that fails does not stop the others.

The functions are the commands `kt3dmoseg annotations`; what they need is imported when they are called.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from kt3dmoseg import annotate
from kt3dmoseg.app import AnyEither, AnyFolder, AnyPath, Flag, Name, Whole, group
from kt3dmoseg.errors import InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.text import count, several, text_table

if TYPE_CHECKING:
    from kt3dmoseg.annotate import Annotation, LabelledTracks, Region
    from kt3dmoseg.annotate.agreement import Comparison
    from kt3dmoseg.types import Trajectories

notes = group("annotations", "Import, export, check and compare the annotations of clips.")

_SAME_OBJECT = 0.5
_SHOWN = {"agreement": ".2%", "both": ".2%", "kappa": ".3f"}


@dataclass(frozen=True)
class ClipReport:
    """What became of one clip: whether all is well, and what to read about it."""

    clip: str
    ok: bool
    lines: tuple[str, ...]

    def print(self) -> None:
        """Print it."""
        print(f"{self.clip}:" + ("" if self.ok else " failed"), *self.lines, sep="\n  ")


class Reports(list[ClipReport]):
    """Reports of clips."""

    @property
    def exit_code(self) -> int:
        """What a command ends with."""
        return 0 if all(report.ok for report in self) else KT3DMoSegError.exit_code


_Clips = Annotated[AnyEither, Parameter(help="Frames, a video, a clip file, or a folder of these.")]
_Notes = Annotated[AnyFolder, Parameter(help="Folder of <clip>.json.")]
_Format = Annotated[Name, Parameter(help="One of cvat, coco, labelme, davis, mots_png or mots_txt.")]
_Tracks = Annotated[AnyEither | None, Parameter(help="Clip file or folder of them with trajectories.")]
_Report = Annotated[Callable[[ClipReport], object], Parameter(parse=False)]


@dataclass(frozen=True)
class _Clip:
    """What is known of a clip without its annotation; no size where its file does not state it."""

    name: str
    names: list[str]
    size: tuple[int, int] | None
    annotation: Path
    trajectories: Trajectories | None

    def read(self, folder: AnyPath | None = None) -> Annotation | None:
        """Read the annotation, which must be of this clip, from a folder; None when there is none."""
        path = self.annotation if folder is None else Path(folder, self.annotation.name)
        if not path.exists():
            return None
        found = annotate.load_annotation(path)
        return found.expect(f"{path}: ", clip=self.name, n_frames=len(self.names), image_size=self.size)

    def current(self) -> Annotation:
        """Read the annotation, an empty one when there is none."""
        if (found := self.read()) is not None:
            return found
        if self.size is None:
            where, fix = f"size of the frames of {self.name}", "give their folder"
            raise InvalidValueError(where, expected="width and height", found="none", fix=fix)
        return annotate.Annotation(self.name, self.size, len(self.names))

    def labelled(self, annotation: Annotation, regions: Mapping[int, list[Region]]) -> LabelledTracks | None:
        if self.trajectories is None:
            return None
        return annotate.label_tracks_detailed(self.trajectories, annotation, regions=regions)


@notes.command(name="import")
def import_annotations(
    source: AnyEither,
    clips: _Clips,
    /,
    *,
    format: _Format,
    annotations: _Notes = "annotations",
    merge: Flag = False,
    replace: Flag = False,
    shift: Whole | None = None,
    scale: float | None = None,
    force: Flag = False,
    dry_run: Flag = False,
    report: _Report = ClipReport.print,
) -> Reports:
    """Import files of another tool; what is done is printed, clip by clip.

    Exit code 2 when a clip failed, after the others. Doubtful imports, and those onto an annotation that
    exists, are refused unless an option decides.

    Parameters
    ----------
    source : path
        A file, or a folder with a file or folder named as each clip.
    clips : path
        A folder of frames, a video, a clip file, or a folder with one of these per clip.
    format : str
        A name of `kt3dmoseg.annotate.formats.FORMATS`.
    annotations : path
        Folder of the files ``<clip>.json``.
    merge : bool
        Add to annotations that exist.
    replace : bool
        Write over annotations that exist.
    shift : int, optional
        Add this to the frame numbers in the files.
    scale : float, optional
        Factor from the files' coordinates to pixels of the frames.
    force : bool
        Import also what is doubtful.
    dry_run : bool
        Only print what would be done.
    report : callable, optional
        Called with each clip's report as it comes; by default it is printed.

    Returns
    -------
    list of ClipReport
        Of every clip for which the source has something, and of the source what it lacks or has in addition.

    Raises
    ------
    InputFileError, InvalidValueError, UnknownNameError
        When there are no such files or clips, or an option is wrong.
    """
    if merge and replace:
        raise InvalidValueError("merge, replace", expected="one of them", found="both")
    suffix, root = annotate.formats.load(format).suffix, Path(source)
    choices = annotate.model.Choices(shift=shift, scale=scale)
    if not root.exists():
        raise InputFileError(f"{root}", expected="a file or folder", found="nothing")

    every = list(_clips(clips, annotations))

    def work(clip: _Clip) -> ClipReport | None:
        content = annotate.formats.content_of(root, clip.name, suffix)
        if content is None:
            return None
        current = clip.current()
        plan = annotate.formats.plan(format, content, current, clip.names, choices)
        plan.doubts.extend(_of_one_file(root, content, clip.name, len(every)))
        if dry_run:
            return ClipReport(clip.name, not plan.doubts, (*plan.lines(), "nothing written"))
        if plan.doubts and not force:
            raise InvalidValueError("; ".join(plan.doubts), fix="correct it, or force it if it is right")
        drawn = len(current.objects) + len(current.marks)
        if drawn and not (merge or replace):
            found, fix = f"{drawn} objects and lassos", "merge with them, or replace them"
            raise InvalidValueError(f"{clip.annotation}", expected="no annotation", found=found, fix=fix)
        base = current if merge else current.emptied()
        objects = (*base.objects, *base.with_free_numbers(plan.annotation.objects))
        new = dataclasses.replace(base, objects=objects)
        plan.note(annotate.agreement.same_place(new))
        saved = annotate.save_revision(clip.annotation, new)  # refused when somebody else saved meanwhile
        done = f"wrote {clip.annotation}, revision {saved.revision}"
        return ClipReport(clip.name, ok=True, lines=(*plan.lines(), done))

    reports = _for_each(every, work, report, root, "a file or folder")
    _report_rest(reports, root, [clip.name for clip in every], report)
    return reports


@notes.command(name="export")
def export_annotations(
    clips: _Clips,
    /,
    output: Annotated[AnyFolder, Parameter(alias="-o", help="Folder of the files.")],
    *,
    format: _Format,
    annotations: _Notes = "annotations",
    tracks: _Tracks = None,
    report: _Report = ClipReport.print,
) -> Reports:
    """Write annotations as files of another tool.

    Trajectories carry the regions between key frames; without any they go in straight lines.

    See Also
    --------
    import_annotations : Other parameters, result and errors are alike.
    """
    from kt3dmoseg.files import check_target, write_bytes

    chosen = annotate.formats.load(format)

    def work(clip: _Clip) -> ClipReport | None:
        if (annotation := clip.read()) is None:
            return None
        target = Path(output, clip.name + chosen.suffix)
        check_target(target)
        regions = annotate.formats.regions(annotation, clip.trajectories)
        write_bytes(target, chosen.dump(annotation, regions, clip.names))
        return ClipReport(clip.name, ok=True, lines=(f"wrote {target}",))

    return _for_each(_clips(clips, annotations, tracks), work, report, annotations)


@notes.command(name="check")
def check_annotations(
    clips: _Clips,
    /,
    *,
    annotations: _Notes = "annotations",
    tracks: _Tracks = None,
    report: _Report = ClipReport.print,
) -> Reports:
    """Check annotations against their clips; exit code 2 when something is wrong.

    That is also what is probably a mistake: an object that is seen nowhere or lies off the picture, two
    objects of different motions in the same place, and, with trajectories, a motion that labels none of them.

    See Also
    --------
    import_annotations : Other parameters, result and errors are alike.
    """

    def work(clip: _Clip) -> ClipReport | None:
        if (annotation := clip.read()) is None:
            return None
        regions = annotate.formats.regions(annotation, clip.trajectories)
        overlap = annotate.agreement.overlaps(regions, regions, annotation.image_size)
        problems = []
        for i, item in enumerate(annotation.objects):
            if not overlap[i, i]:  # no pixel
                shown = any(region.visibility == "visible" for region in regions[item.id])
                wrong = "lies off the picture" if shown else "is seen nowhere"
                problems.append(f"{item.name} (object {item.id}) {wrong}")
            for other, shared in zip(annotation.objects[:i], overlap[i, :i], strict=True):
                if shared > _SAME_OBJECT and item.motion != other.motion:
                    problems.append(f"{other.name} and {item.name} have different motions in the same place")
        lines = [f"{count(len(annotation.objects), 'object')}, {count(len(annotation.motions), 'motion')}"]
        if (labelled := clip.labelled(annotation, regions)) is not None:
            counts = ", ".join(f"{count} {name}" for name, count in labelled.counts().items() if count)
            lines[0] += f"; trajectories: {counts}"
            missing = set(annotation.motions) - {int(m) - 1 for m in labelled.labels.motions}
            problems += [f"motion {motion} labels no trajectory" for motion in sorted(missing)]
        return ClipReport(clip.name, not problems, (*lines, *problems))

    return _for_each(_clips(clips, annotations, tracks), work, report, annotations)


def compare_annotations(
    first: AnyPath, second: AnyPath, clips: AnyPath, *, tracks: AnyPath | None = None
) -> list[Comparison]:
    """Compare the annotations of two people, by the labels of trajectories and object by object.

    Parameters
    ----------
    first, second : path
        Folders of ``<clip>.json``.
    clips, tracks : path
        As for `export_annotations`.

    Raises
    ------
    InputFileError
        When no clip has annotations in both.
    """
    found, names = [], []
    for clip in _clips(clips, first, tracks):
        names.append(clip.name)
        one, two = clip.read(), clip.read(second)
        if one is None or two is None:
            continue
        a, b = (annotate.formats.regions(annotation, clip.trajectories) for annotation in (one, two))
        of_one, of_two = clip.labelled(one, a), clip.labelled(two, b)
        labels = (of_one.labels.label, of_two.labels.label) if of_one and of_two else None
        found.append(annotate.agreement.compare((one, two), (a, b), labels))
    if not found:
        expected, fix = "<clip>.json in both, named as a clip", f"the clips are {several(names)}"
        raise InputFileError(f"{first} and {second}", expected=expected, found="none", fix=fix)
    return found


@notes.command
def compare(
    first: Annotated[AnyFolder, Parameter(help="Folder of <clip>.json of the one.")],
    second: Annotated[AnyFolder, Parameter(help="Folder of <clip>.json of the other.")],
    clips: _Clips,
    /,
    *,
    tracks: _Tracks = None,
    json: Annotated[Flag, Parameter(help="Print JSON.")] = False,
) -> None:
    """Compare two annotators: labels of trajectories (agreement, Cohen's kappa) and objects (IoU)."""
    comparisons = compare_annotations(first, second, clips, tracks=tracks)
    shown = [comparison.to_json("the first", "the second") for comparison in comparisons]
    if json:
        print(dumps(shown, indent=1, ensure_ascii=False))
        return
    rows = []
    for c in shown:
        cells = [f"{c[name]:{form}}" if name in c else "" for name, form in _SHOWN.items()]
        mean = sum(o["iou"] for o in c["objects"]) / max(1, len(c["objects"]))
        rows.append([c["clip"], *cells, f"{mean:.3f}", ""])
        for o in c["objects"]:
            differ = "" if o["different"] is None else str(o["different"])
            rows.append([f"  {o['verdict']}", *[""] * 3, f"{o['iou']:.3f}", differ])
    print(text_table(rows, ["clip, objects", "agreement", "both labelled", "kappa", "IoU", "differ"]))


def _for_each(
    clips: Iterable[_Clip],
    work: Callable[[_Clip], ClipReport | None],
    report: Callable[[ClipReport], object],
    searched: AnyPath,
    wanted: str = "<clip>.json",
) -> Reports:
    from kt3dmoseg.files import names_in

    out, names = Reports(), []
    for clip in clips:
        names.append(clip.name)
        try:
            done = work(clip)
        except KT3DMoSegError as error:
            done = ClipReport(clip.name, ok=False, lines=(str(error),))
        if done is not None:
            out.append(done)
            report(done)
    if not out:
        found = several(names_in(Path(searched))) or "none"
        fix = f"the clips are {several(names)}"
        raise InputFileError(f"{searched}", expected=f"{wanted} named as a clip", found=found, fix=fix)
    return out


def _of_one_file(root: Path, content: bytes, clip: str, count: int) -> list[str]:
    """Doubt that one file that is read for several clips is of this one, unless it names it."""
    doubtful = root.is_file() and count > 1 and clip.encode() not in content
    return [f"{root} is one file for {count} clips, and does not name {clip}"] * doubtful


def _report_rest(
    reports: Reports, source: Path, clips: Sequence[str], report: Callable[[ClipReport], object]
) -> None:
    """Report of which clips a source has nothing, and what it has of none."""
    from kt3dmoseg.files import names_in

    found = {each.clip for each in reports}
    rest = {
        "it has nothing of": [clip for clip in clips if clip not in found],
        "left out, of no clip:": [n for n in names_in(source) if {n, Path(n).stem}.isdisjoint(clips)],
    }
    if lines := tuple(f"{words} {several(names)}" for words, names in rest.items() if names):
        reports.append(ClipReport(f"{source}", ok=True, lines=lines))
        report(reports[-1])


def _clips(given: AnyPath, annotations: AnyPath, tracks: AnyPath | None = None) -> Iterator[_Clip]:
    """Give the clips of frames, a video, a clip file or a folder of these; clip files need no frames."""
    from kt3dmoseg import io
    from kt3dmoseg.frames import clip_paths, find_clips
    from kt3dmoseg.io.images import picture_size

    root = Path(given)
    files = clip_paths(root)
    others = clip_paths(Path(tracks)) if files and tracks is not None else {}
    if files and tracks is not None and not files.keys() & others.keys():
        found = several(others) or "none"
        raise InputFileError(f"{tracks}", expected=f"tracks of {several(files)}", found=found)
    for name, file in files.items():
        clip = io.load(others.get(name, file))
        names = [f"{number:06d}.png" for number in clip.frame_numbers.tolist()]
        yield _Clip(name, names, clip.dense.image_size, Path(annotations, f"{name}.json"), clip.dense)
    for source in find_clips(root, annotations=annotations, tracks=tracks).values() if not files else ():
        size = picture_size(source.frames[0])
        dense = io.load(source.tracks).dense if source.tracks else None
        if dense is not None:
            dense = dataclasses.replace(dense, image_size=size)
        yield _Clip(source.name, [frame.name for frame in source.frames], size, source.annotation, dense)
