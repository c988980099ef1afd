"""Annotations of many clips: import, export, check, compare. A clip that fails does not stop the others."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kt3dmoseg import io
from kt3dmoseg.annotate import formats
from kt3dmoseg.annotate.agreement import Agreement, agree, match_regions, overlaps
from kt3dmoseg.annotate.formats.foreign import Choices
from kt3dmoseg.annotate.labelling import LabelledTracks, label_tracks_detailed
from kt3dmoseg.annotate.model import BACKGROUND, REJECT, Annotation, load_annotation, save_revision
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.errors import InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import check_target, listed, read_bytes, write_bytes, zip_bytes
from kt3dmoseg.frames import find_clips
from kt3dmoseg.io.fields import clip_name
from kt3dmoseg.io.formats import CLIP_SUFFIXES
from kt3dmoseg.io.images import picture_size
from kt3dmoseg.types import Trajectories

_MAX_FILE = 128 << 20
_SAME_OBJECT = 0.5


@dataclass(frozen=True)
class ClipReport:
    """What became of one clip: whether all is well, and what to read about it."""

    clip: str
    ok: bool
    lines: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two annotations of a clip.

    Parameters
    ----------
    clip : str
        Its name.
    agreement : Agreement or None
        Of the labels that both give its trajectories; None without trajectories.
    objects : list of (str, str, float)
        Objects of the first and the second that overlap most, and their intersection over union in all
        frames; an empty name and 0 where one has no counterpart.
    """

    clip: str
    agreement: Agreement | None
    objects: list[tuple[str, str, float]]


@dataclass(frozen=True)
class _Clip:
    """What is known of a clip without its annotation; no size where its file does not state it."""

    name: str
    names: list[str]
    size: tuple[int, int] | None
    annotation: Path
    trajectories: Trajectories | None

    def annotated(self, folder: Path | None = None) -> Annotation:
        """Read the clip's annotation, from another folder or its own; it must be of this clip."""
        path = self.annotation if folder is None else folder / self.annotation.name
        found = load_annotation(path)
        wanted = {"clip": self.name, "n_frames": len(self.names), "image_size": self.size or found.image_size}
        for field, value in wanted.items():
            if getattr(found, field) != value:
                where, shown = f"{path}: {field}", repr(getattr(found, field))
                raise InvalidValueError(where, expected=repr(value), found=shown)
        return found

    def current(self) -> Annotation:
        """Read the clip's annotation, an empty one when there is none."""
        if self.annotation.exists():
            return self.annotated()
        if self.size is None:
            where, fix = f"size of the frames of {self.name}", "give their folder"
            raise InvalidValueError(where, expected="width and height", found="none", fix=fix)
        return Annotation(self.name, self.size, len(self.names))

    def labelled(self, annotation: Annotation, regions: Mapping[int, list[Region]]) -> LabelledTracks | None:
        if self.trajectories is None:
            return None
        return label_tracks_detailed(self.trajectories, annotation, regions=regions)


def import_annotations(
    source: str | os.PathLike[str],
    clips: str | os.PathLike[str],
    *,
    format: str,  # the name of the option
    annotations: str | os.PathLike[str] = "annotations",
    merge: bool = False,
    replace: bool = False,
    shift: int | None = None,
    scale: float | None = None,
    force: bool = False,
    dry_run: bool = False,
    report: Callable[[ClipReport], object] | None = None,
) -> list[ClipReport]:
    """Import files of another tool as annotations.

    Parameters
    ----------
    source : path
        A file, which may hold several clips, or a folder with a file or folder per clip, named as the clip.
    clips : path
        A folder of frames, a clip file, or a folder with one of these per clip.
    format : str
        A name of `kt3dmoseg.annotate.formats.FORMATS`.
    annotations : path
        Folder of the files ``<clip>.json``.
    merge, replace : bool
        Add to an annotation that exists, or write over it; by default it is refused.
    shift, scale : int, float, optional
        As in `Choices`.
    force : bool
        Import also what a plan calls doubtful.
    dry_run : bool
        Only report what would be done.
    report : callable, optional
        Called with each clip's report as it comes.

    Returns
    -------
    list of ClipReport
        Of every clip for which the source has something.

    Raises
    ------
    InputFileError, InvalidValueError, UnknownNameError
        When there are no such files or clips, or an option is wrong.
    """
    if merge and replace:
        raise InvalidValueError("merge, replace", expected="one of them", found="both")
    suffix, choices, root = formats.load(format).suffix, Choices(shift, scale), Path(source)
    if not root.exists():
        raise InputFileError(f"{root}", expected="a file or folder", found="nothing")

    def work(clip: _Clip) -> ClipReport | None:
        content = _content(root, clip.name, suffix)
        if content is None:
            return None
        current = clip.current()
        plan = formats.plan(format, content, current, clip.names, choices)
        if dry_run:
            return ClipReport(clip.name, not plan.doubts, (*plan.lines(), "nothing written"))
        if plan.doubts and not force:
            raise InvalidValueError("; ".join(plan.doubts), fix="correct it by a shift or scale, or force it")
        _check_empty(clip.annotation, current, decided=merge or replace)
        new = merged(current if merge else current.emptied(), plan.annotation)
        saved = save_revision(clip.annotation, new)  # refused when somebody else saved meanwhile
        done = f"wrote {clip.annotation}, revision {saved.revision}"
        return ClipReport(clip.name, ok=True, lines=(*plan.lines(), done))

    found = _for_each(clips, annotations, work, report)
    if not found:
        expected = f"a file or folder named as a clip in {clips}"
        raise InputFileError(f"{root}", expected=expected, found="none")
    return found


def _check_empty(path: Path, annotation: Annotation, *, decided: bool) -> None:
    drawn = len(annotation.objects) + len(annotation.marks)
    if drawn and not decided:
        found, fix = f"{drawn} objects and lassos", "merge with them, or replace them"
        raise InvalidValueError(f"{path}", expected="no annotation", found=found, fix=fix)


def merged(current: Annotation, added: Annotation) -> Annotation:
    """Return an annotation with the objects of another one, under free ids and motions."""
    if not current.objects:
        return replace(current, objects=added.objects)
    first = max(item.id for item in current.objects) + 1
    used = max(current.motions, default=0)
    objects = []
    for k, item in enumerate(added.objects):
        motion = item.motion if item.motion in (BACKGROUND, REJECT) else item.motion + used
        objects.append(replace(item, id=first + k, motion=motion))
    return replace(current, objects=(*current.objects, *objects))


def export_annotations(
    clips: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    format: str,
    annotations: str | os.PathLike[str] = "annotations",
    tracks: str | os.PathLike[str] | None = None,
    report: Callable[[ClipReport], object] | None = None,
) -> list[ClipReport]:
    """Write annotations as files ``<clip>.<suffix>`` of another tool's format, into the folder `output`.

    `tracks` are clip files whose trajectories carry the regions between key frames; without any they go in
    straight lines. Other parameters, result and errors as for `import_annotations`.
    """
    chosen = formats.load(format)

    def work(clip: _Clip) -> ClipReport | None:
        if not clip.annotation.exists():
            return None
        annotation = clip.annotated()
        target = Path(output, clip.name + chosen.suffix)
        check_target(target)
        regions = formats.regions(annotation, clip.trajectories)
        write_bytes(target, chosen.dump(annotation, regions, clip.names))
        return ClipReport(clip.name, ok=True, lines=(f"wrote {target}",))

    return _annotated(_for_each(clips, annotations, work, report, tracks), clips, annotations)


def check_annotations(
    clips: str | os.PathLike[str],
    *,
    annotations: str | os.PathLike[str] = "annotations",
    tracks: str | os.PathLike[str] | None = None,
    report: Callable[[ClipReport], object] | None = None,
) -> list[ClipReport]:
    """Check that annotations are of their clips, and look for what is probably a mistake.

    That is an object that is seen nowhere or lies off the picture, two objects of different motions in the
    same place, and, with trajectories, a motion that labels none of them. Parameters, result and errors as
    for `export_annotations`.
    """

    def work(clip: _Clip) -> ClipReport | None:
        if not clip.annotation.exists():
            return None
        annotation = clip.annotated()
        regions = formats.regions(annotation, clip.trajectories)
        problems = [*_problems(annotation, regions)]
        lines = [f"{len(annotation.objects)} objects, {len(annotation.motions)} motions"]
        if (labelled := clip.labelled(annotation, regions)) is not None:
            counts = {name: count for name, count in labelled.counts().items() if count}
            lines[0] += "; trajectories: " + ", ".join(f"{count} {name}" for name, count in counts.items())
            missing = set(annotation.motions) - {int(m) - 1 for m in labelled.labels.motions}
            problems += [f"motion {motion} labels no trajectory" for motion in sorted(missing)]
        return ClipReport(clip.name, not problems, (*lines, *problems))

    return _annotated(_for_each(clips, annotations, work, report, tracks), clips, annotations)


def _problems(annotation: Annotation, regions: Mapping[int, list[Region]]) -> Iterator[str]:
    width, height = annotation.image_size
    for item in annotation.objects:
        outlines = [polygon for region in regions[item.id] for polygon in region.polygons]
        if not outlines:
            yield f"{item.name} (object {item.id}) is seen nowhere"
        elif not any(
            (polygon.max(axis=0) >= -0.5).all() and (polygon.min(axis=0) <= (width - 0.5, height - 0.5)).all()
            for polygon in outlines
        ):
            yield f"{item.name} (object {item.id}) lies off the picture"
    overlap = overlaps(regions, regions, annotation.image_size)
    for i, j in np.argwhere(np.triu(overlap > _SAME_OBJECT, k=1)):
        first, second = annotation.objects[i], annotation.objects[j]
        if first.motion != second.motion:
            yield f"{first.name} and {second.name} have different motions in the same place"


def compare_annotations(
    first: str | os.PathLike[str],
    second: str | os.PathLike[str],
    clips: str | os.PathLike[str],
    *,
    tracks: str | os.PathLike[str] | None = None,
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
    found = []
    for clip in _clips(clips, first, tracks):
        if not (clip.annotation.exists() and (Path(second) / clip.annotation.name).exists()):
            continue
        one, two = clip.annotated(), clip.annotated(Path(second))
        regions = [formats.regions(annotation, clip.trajectories) for annotation in (one, two)]
        mine, theirs = (clip.labelled(a, r) for a, r in zip((one, two), regions, strict=True))
        labels = None if mine is None or theirs is None else agree(mine.labels.label, theirs.labels.label)
        names = [{item.id: item.name for item in annotation.objects} for annotation in (one, two)]
        objects = [
            (names[0].get(a, ""), names[1].get(b, ""), overlap)
            for a, b, overlap in match_regions(regions[0], regions[1], one.image_size)
        ]
        found.append(Comparison(clip.name, labels, objects))
    if not found:
        raise InputFileError(
            f"{first} and {second}", expected=f"both <clip>.json of a clip in {clips}", found="none"
        )
    return found


def _annotated(found: list[ClipReport], clips: object, annotations: object) -> list[ClipReport]:
    if not found:
        raise InputFileError(f"{annotations}", expected=f"<clip>.json of a clip in {clips}", found="none")
    return found


def _for_each(
    clips: str | os.PathLike[str],
    annotations: str | os.PathLike[str],
    work: Callable[[_Clip], ClipReport | None],
    report: Callable[[ClipReport], object] | None,
    tracks: str | os.PathLike[str] | None = None,
) -> list[ClipReport]:
    out = []
    for clip in _clips(clips, annotations, tracks):
        try:
            done = work(clip)
        except KT3DMoSegError as error:
            done = ClipReport(clip.name, ok=False, lines=(str(error),))
        if done is not None:
            out.append(done)
            if report is not None:
                report(done)
    return out


def _clips(
    given: str | os.PathLike[str],
    annotations: str | os.PathLike[str],
    tracks: str | os.PathLike[str] | None = None,
) -> Iterator[_Clip]:
    """Give the clips of a folder of frames, a clip file or a folder of these; clip files need no frames."""
    root = Path(given)
    files = {clip_name(root): root} if root.is_file() else {}
    if root.is_dir() and any(file.suffix in CLIP_SUFFIXES for file in root.iterdir()):
        files = io.dataset_paths(root)
    for name, file in files.items():
        clip = io.load(file)
        names = [f"{number:06d}.png" for number in clip.frame_numbers.tolist()]
        yield _Clip(name, names, clip.dense.image_size, Path(annotations, f"{name}.json"), clip.dense)
    if files:
        return
    for name, source in find_clips(root, annotations=annotations, tracks=tracks).items():
        size = picture_size(source.frames[0])
        dense = None if source.tracks is None else io.load(source.tracks).dense
        if dense is not None:
            dense = Trajectories(dense.xy, dense.visible, dense.track_id, size)
        yield _Clip(name, [frame.name for frame in source.frames], size, source.annotation, dense)


def _content(source: Path, clip: str, suffix: str) -> bytes | None:
    """Return what a source has of a clip: itself, a file or a folder of that name; None when nothing."""
    if source.is_file():
        return read_bytes(source, _MAX_FILE)
    for file in (source / f"{clip}{suffix}", source / f"{clip}.zip"):
        if file.is_file():
            return read_bytes(file, _MAX_FILE)
    folder = source / clip
    if not folder.is_dir():
        return None
    files = {file.name: read_bytes(file, _MAX_FILE) for file in listed(folder) if file.is_file()}
    return zip_bytes(files)
