"""Annotations in the formats of other tools, and the table of their names.

Third parties add a format through an entry point: an object with `suffix`, `media_type`, `dump` and `parse`
as an `AnnotationFormat` has.
"""

from collections.abc import Sequence
from pathlib import Path

from kt3dmoseg.annotate.formats.foreign import AnnotationFormat, Import
from kt3dmoseg.annotate.model import Annotation, Choices
from kt3dmoseg.annotate.propagation import Region, TrackMotion, propagate
from kt3dmoseg.files import listed, read_bytes, zip_bytes
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
_MAX_FILE = 128 << 20


def load(name: str) -> AnnotationFormat:
    """Return the format of that name; raises UnknownNameError with the nearest name."""
    found: AnnotationFormat = FORMATS.load(name)
    return found


def plan(
    name: str, content: bytes, like: Annotation, names: Sequence[str] = (), choices: Choices | None = None
) -> Import:
    """Return what importing a file in a format would do, and what of it is doubtful; see `Import`.

    FileFormatError or InvalidValueError when nothing of it can be imported, or it does not fit the clip.
    """
    chosen = load(name)
    if hasattr(chosen, "plan"):
        found = chosen.plan(content, like, names, choices)
    else:
        found = Import(like, names, choices)
        found.annotation = chosen.parse(content, found.like, names)  # of a third party
    from kt3dmoseg.annotate.agreement import same_place  # which uses the masks of this package

    found.note(same_place(found.annotation))
    return found


def content_of(source: Path, clip: str, suffix: str) -> bytes | None:
    """Return what a path has of a clip: itself, a file or a folder (zipped) of that name, or None."""
    for file in (source, source / f"{clip}{suffix}", source / f"{clip}.zip"):
        if file.is_file():
            return read_bytes(file, _MAX_FILE)
    folder = source / clip
    if not folder.is_dir():
        return None
    return zip_bytes({file.name: read_bytes(file, _MAX_FILE) for file in listed(folder) if file.is_file()})


def regions(annotation: Annotation, trajectories: Trajectories | None = None) -> dict[int, list[Region]]:
    """Return the regions of every frame for `dump`, carried by trajectories when there are any."""
    return propagate(annotation, None if trajectories is None else TrackMotion(trajectories))
