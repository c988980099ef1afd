"""Editing and saving an annotation: every edit can be undone, and no save overwrites a newer one.

>>> session = AnnotationSession.new("clip", image_size=(1242, 375), n_frames=20)
>>> van = session.add_object("van", 0, [[(10, 10), (60, 10), (60, 40)]], kind="van", motion=1)
>>> session.set_key_frame(van, 12, visibility="outside")
>>> session.undo()
True
>>> len(session.annotation.object(van).key_frames)
1
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from kt3dmoseg.annotate.model import (
    AnnotatedObject,
    Annotation,
    KeyFrame,
    Kind,
    Mark,
    Motion,
    Polygon,
    Visibility,
    load_annotation,
    save_annotation,
)
from kt3dmoseg.errors import KT3DMoSegError
from kt3dmoseg.files import hold_folder

Drawn = Sequence[Sequence[Sequence[float]]]


class StaleRevisionError(KT3DMoSegError):
    """The file was saved by somebody else since it was read; `current` is what they saved."""

    current: Annotation


def save_revision(path: str | os.PathLike[str], annotation: Annotation) -> Annotation:
    """Write `annotation` as the next revision of a file, and return what was written.

    A file that does not exist, or no longer, is written whatever the revision.

    Raises
    ------
    StaleRevisionError
        When the file holds another revision than that which `annotation` was made from.
    InputFileError, FileFormatError
        When the file cannot be written, or what is there is no annotation.
    """
    target = Path(path)
    with hold_folder(target.parent):
        current = load_annotation(target) if target.exists() else None
        if current is not None and current.revision != annotation.revision:
            mine, theirs = f"revision {annotation.revision}", f"revision {current.revision}"
            fix = "read it again and merge the edits"
            stale = StaleRevisionError(f"{target}", expected=mine, found=theirs, fix=fix)
            stale.current = current
            raise stale
        saved = replace(annotation, revision=annotation.revision + 1)
        save_annotation(target, saved)
    return saved


class AnnotationSession:
    """An annotation being edited; an edit that raises InvalidValueError leaves it as it was."""

    def __init__(self, annotation: Annotation) -> None:
        self._now = annotation
        self._before: list[Annotation] = []

    @classmethod
    def new(
        cls, clip: str, *, image_size: tuple[int, int], n_frames: int, annotator: str = ""
    ) -> AnnotationSession:
        """Start with an empty annotation; see `Annotation` for the parameters."""
        return cls(Annotation(clip, image_size, n_frames, annotator=annotator))

    @property
    def annotation(self) -> Annotation:
        """The annotation as it is now."""
        return self._now

    def add_object(
        self, name: str, frame: int, polygons: Drawn, *, motion: Motion, kind: Kind = "car", note: str = ""
    ) -> int:
        """Add an object with its first key frame and return its id; see `AnnotatedObject`."""
        number = max((item.id for item in self._now.objects), default=0) + 1
        key = KeyFrame(frame, polygons=_polygons(polygons))
        item = AnnotatedObject(number, name, kind, motion, (key,), note)
        self.replace(replace(self._now, objects=(*self._now.objects, item)))
        return number

    def set_key_frame(
        self, object_id: int, frame: int, polygons: Drawn = (), visibility: Visibility = "visible"
    ) -> None:
        """Draw an object in one frame, or make it occluded or outside from there on."""
        item = self._now.object(object_id)
        others = (key for key in item.key_frames if key.frame != frame)
        changed = replace(item, key_frames=(*others, KeyFrame(frame, visibility, _polygons(polygons))))
        objects = tuple(changed if other is item else other for other in self._now.objects)
        self.replace(replace(self._now, objects=objects))

    def add_mark(self, frame: int, polygon: Sequence[Sequence[float]], *, motion: Motion) -> None:
        """Lasso the trajectories that lie inside the polygon in that frame; see `Mark`."""
        (checked,) = _polygons([polygon])
        self.replace(replace(self._now, marks=(*self._now.marks, Mark(frame, motion, checked))))

    def replace(self, annotation: Annotation) -> None:
        """Make any annotation the present one, as one edit."""
        if annotation != self._now:
            self._before.append(self._now)
            self._now = annotation

    def undo(self) -> bool:
        """Take back the last edit; False when there is none."""
        if not self._before:
            return False
        # The revision counts saves; undo must not turn it back.
        self._now = replace(self._before.pop(), revision=self._now.revision)
        return True

    def save(self, path: str | os.PathLike[str]) -> int:
        """Write the annotation as the next revision of the file and return that; see `save_revision`."""
        self._now = save_revision(path, self._now)
        return self._now.revision


def _polygons(drawn: Drawn) -> tuple[Polygon, ...]:
    return tuple(tuple((point[0], point[1]) for point in polygon) for polygon in drawn)
