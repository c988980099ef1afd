"""Annotations in the formats of other tools: one file each, and this table of their names.

A format is a module-level object with ``suffix``, ``media_type``,
``dump(annotation, regions, names) -> bytes`` and ``parse(content, like, names) -> Annotation``. Third
parties add one through an entry point.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from kt3dmoseg.annotate.model import Annotation
from kt3dmoseg.annotate.propagation import NoMotion, Region, TrackMotion, propagate
from kt3dmoseg.registry import Registry
from kt3dmoseg.types import Trajectories

FORMATS = Registry(
    "annotation format",
    {
        "cvat": "kt3dmoseg.annotate.formats.cvat:CVAT",
        "davis": "kt3dmoseg.annotate.formats.davis:DAVIS",
        "mots_txt": "kt3dmoseg.annotate.formats.mots:MOTS_TXT",
        "mots_png": "kt3dmoseg.annotate.formats.mots:MOTS_PNG",
        "coco": "kt3dmoseg.annotate.formats.coco:COCO",
        "labelme": "kt3dmoseg.annotate.formats.labelme:LABELME",
    },
    group="kt3dmoseg.annotation_formats",
)


class AnnotationFormat(Protocol):
    """Another tool's format."""

    suffix: str
    media_type: str

    def dump(
        self, annotation: Annotation, regions: Mapping[int, list[Region]], names: Sequence[str] = ()
    ) -> bytes:
        """Return the file's content.

        Parameters
        ----------
        annotation : Annotation
            What to write.
        regions : mapping of int to list of Region
            The objects' regions in every frame, as `propagate` gives them.
        names : sequence of str
            File names of the clip's frames, for formats that name them; by default 000000.png on.
        """
        ...

    def parse(self, content: bytes, like: Annotation, names: Sequence[str] = ()) -> Annotation:
        """Read a file's content.

        Parameters
        ----------
        content : bytes
            The file.
        like : Annotation
            An empty annotation of the clip: its name, frames and image size.
        names : sequence of str
            File names of the clip's frames. Files and images that all bear such names belong to
            those frames; otherwise the numbers in their names count from 0.

        Raises
        ------
        FileFormatError
            When the content is not of this format, or does not fit the clip.
        """
        ...


def load(name: str) -> AnnotationFormat:
    """Return the format of that name; raises UnknownNameError with the nearest name."""
    found: AnnotationFormat = FORMATS.load(name)
    return found


def regions(annotation: Annotation, trajectories: Trajectories | None = None) -> dict[int, list[Region]]:
    """Return the regions of every frame for `dump`, carried by trajectories when there are any."""
    return propagate(annotation, NoMotion() if trajectories is None else TrackMotion(trajectories))
