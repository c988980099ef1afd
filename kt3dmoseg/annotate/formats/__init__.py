"""Annotations in the formats of other tools, and the table of their names.

Third parties add a format through an entry point: an object with the fields of `AnnotationFormat`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from kt3dmoseg.annotate.formats.foreign import Choices, Import, ImportPlan, plan_of
from kt3dmoseg.annotate.model import Annotation
from kt3dmoseg.annotate.propagation import Region, TrackMotion, propagate
from kt3dmoseg.registry import Registry
from kt3dmoseg.types import Trajectories

FORMATS = Registry(
    "annotation format",
    {
        "cvat": "kt3dmoseg.annotate.formats.cvat:CVAT",
        "davis": "kt3dmoseg.annotate.formats.masks:DAVIS",
        "mots_txt": "kt3dmoseg.annotate.formats.masks:MOTS_TXT",
        "mots_png": "kt3dmoseg.annotate.formats.masks:MOTS_PNG",
        "coco": "kt3dmoseg.annotate.formats.coco:COCO",
        "labelme": "kt3dmoseg.annotate.formats.labelme:LABELME",
    },
    group="kt3dmoseg.annotation_formats",
)


@dataclass(frozen=True)
class AnnotationFormat:
    """Another tool's format.

    Parameters
    ----------
    suffix, media_type : str
        Of the files.
    dump : callable
        ``dump(annotation, regions, names=()) -> bytes`` gives the file's content: `regions` are the objects'
        in every frame, as `propagate` gives them; `names` the file names of the clip's frames, by
        default 000000.png on. It raises InvalidValueError for what the format cannot hold.
    parse : callable
        ``parse(content, like, names=()) -> Annotation`` reads a file's content: `like` is an empty annotation
        of the clip. Files and images belong to frames by name, else by number (`match_frames`). It raises
        FileFormatError or InvalidValueError when the content is not of this format, does not fit the clip,
        or leaves a doubt that `plan` describes.
    read : callable, optional
        Hands what the content shows to an `Import`; without it a plan says no more than `parse` does.
    """

    suffix: str
    media_type: str
    dump: Callable[[Annotation, Mapping[int, list[Region]], Sequence[str]], bytes]
    parse: Callable[[bytes, Annotation, Sequence[str]], Annotation]
    read: Callable[[bytes, Import], None] | None = None


def load(name: str) -> AnnotationFormat:
    """Return the format of that name; raises UnknownNameError with the nearest name."""
    found: AnnotationFormat = FORMATS.load(name)
    return found


def plan(
    name: str, content: bytes, like: Annotation, names: Sequence[str] = (), choices: Choices | None = None
) -> ImportPlan:
    """Return what importing a file would do, and what of it is doubtful.

    Parameters
    ----------
    name : str
        The format, a name of `FORMATS`.
    content : bytes
        The file.
    like : Annotation
        An annotation of the clip; its objects do not matter.
    names : sequence of str
        File names of the clip's frames, by default 000000.png on.
    choices : Choices, optional
        What a person decided.

    Raises
    ------
    FileFormatError, InvalidValueError
        When nothing of the file can be imported, or it does not fit the clip.
    """
    chosen = load(name)
    if (read := getattr(chosen, "read", None)) is None:
        return ImportPlan(chosen.parse(content, like.emptied(), names))
    return plan_of(read, content, like, names, choices)


def regions(annotation: Annotation, trajectories: Trajectories | None = None) -> dict[int, list[Region]]:
    """Return the regions of every frame for `dump`, carried by trajectories when there are any."""
    return propagate(annotation, None if trajectories is None else TrackMotion(trajectories))
