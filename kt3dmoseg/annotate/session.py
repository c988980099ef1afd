"""Editing an annotation: every edit can be undone, without limit.

An edit makes a new immutable annotation; the session remembers the ones before it.

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
from typing import Any

from kt3dmoseg.annotate.checks import Motion
from kt3dmoseg.annotate.document import load_annotation
from kt3dmoseg.annotate.model import AnnotatedObject, Annotation, KeyFrame, Mark, Visibility
from kt3dmoseg.annotate.motion import ImageMotion
from kt3dmoseg.annotate.regions import propagate_keys
from kt3dmoseg.annotate.store import save_revision
from kt3dmoseg.errors import InvalidValueError

Drawn = Sequence[Sequence[Sequence[float]]]


class AnnotationSession:
    """An annotation being edited.

    Parameters
    ----------
    annotation : Annotation
        Where to start.
    """

    def __init__(self, annotation: Annotation) -> None:
        self._now = annotation
        self._done: list[Annotation] = []
        self._undone: list[Annotation] = []

    @classmethod
    def new(
        cls, clip: str, *, image_size: tuple[int, int], n_frames: int, annotator: str = ""
    ) -> AnnotationSession:
        """Start with an empty annotation; see `Annotation` for the parameters."""
        return cls(Annotation(clip, image_size, n_frames, annotator=annotator))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> AnnotationSession:
        """Start with the annotation in a file; errors as in `load_annotation`."""
        return cls(load_annotation(path))

    @property
    def annotation(self) -> Annotation:
        """The annotation as it is now."""
        return self._now

    def add_object(
        self,
        name: str,
        frame: int,
        polygons: Drawn,
        *,
        motion: Motion,
        kind: str = "car",
        note: str = "",
    ) -> int:
        """Add an object with its first key frame and return its id.

        Raises
        ------
        InvalidValueError
            The message names the field; the annotation stays as it was. This holds for every edit.
        """
        number = max((item.id for item in self._now.objects), default=0) + 1
        item = AnnotatedObject(number, name, kind, motion, (_key(frame, polygons),), note)
        self.replace(replace(self._now, objects=(*self._now.objects, item)))
        return number

    def update_object(self, object_id: int, **fields: Any) -> None:  # noqa: ANN401
        """Change the `name`, `kind`, `motion` or `note` of an object."""
        unknown = set(fields) - {"name", "kind", "motion", "note"}
        if unknown:
            raise InvalidValueError("update_object", expected="name, kind, motion, note", found=min(unknown))
        self.replace(self._now.with_object(replace(self._now.object(object_id), **fields)))

    def remove_object(self, object_id: int) -> None:
        """Remove an object from the whole clip."""
        gone = self._now.object(object_id)
        self.replace(replace(self._now, objects=tuple(o for o in self._now.objects if o is not gone)))

    def set_key_frame(
        self, object_id: int, frame: int, polygons: Drawn = (), visibility: Visibility = "visible"
    ) -> None:
        """Draw an object in one frame, or say that it is occluded or outside from there on."""
        item = self._now.object(object_id)
        others = tuple(key for key in item.key_frames if key.frame != frame)
        changed = replace(item, key_frames=(*others, _key(frame, polygons, visibility)))
        self.replace(self._now.with_object(changed))

    def remove_key_frame(self, object_id: int, frame: int) -> None:
        """Forget what was said about an object in one frame; its only key frame cannot be removed."""
        item = self._now.object(object_id)
        if item.key_at(frame) is None:
            raise InvalidValueError(f"key frame {frame} of {item.name}", expected="a key frame", found="none")
        kept = tuple(key for key in item.key_frames if key.frame != frame)
        self.replace(self._now.with_object(replace(item, key_frames=kept)))

    def pin(self, object_id: int, frame: int, motion: ImageMotion) -> None:
        """Make the propagated region of a frame a key frame: copy by motion."""
        item = self._now.object(object_id)
        region = propagate_keys(item.key_frames, self._now.n_frames, motion)[frame]
        self.set_key_frame(object_id, frame, [p.tolist() for p in region.polygons], region.visibility)

    def add_mark(self, frame: int, polygon: Sequence[Sequence[float]], *, motion: Motion) -> None:
        """Lasso the trajectories that lie inside the polygon in that frame; see `Mark`."""
        mark = Mark(frame, motion, tuple((x, y) for x, y in polygon))
        self.replace(replace(self._now, marks=(*self._now.marks, mark)))

    def remove_mark(self, index: int) -> None:
        """Remove the mark at an index of ``annotation.marks``."""
        if not 0 <= index < len(self._now.marks):
            found = f"{index} of {len(self._now.marks)}"
            raise InvalidValueError("mark", expected="the index of a mark", found=found)
        marks = self._now.marks
        self.replace(replace(self._now, marks=marks[:index] + marks[index + 1 :]))

    def replace(self, annotation: Annotation) -> None:
        """Make any annotation the present one, as one edit."""
        if annotation != self._now:
            self._done.append(self._now)
            self._undone.clear()
            self._now = annotation

    def undo(self) -> bool:
        """Take back the last edit; False when there is none."""
        return self._step(self._done, self._undone)

    def redo(self) -> bool:
        """Repeat the edit that was taken back last; False when there is none."""
        return self._step(self._undone, self._done)

    def save(self, path: str | os.PathLike[str]) -> int:
        """Write the annotation as the next revision of the file and return that revision.

        Raises
        ------
        StaleRevisionError
            When the file holds another revision than the one that this session started from or
            saved last: somebody else saved in between.
        """
        self._now = save_revision(path, self._now)
        return self._now.revision

    def _step(self, source: list[Annotation], target: list[Annotation]) -> bool:
        if not source:
            return False
        target.append(self._now)
        # The revision counts saves; undo must not turn it back.
        self._now = replace(source.pop(), revision=self._now.revision)
        return True


def _key(frame: int, polygons: Drawn, visibility: Visibility = "visible") -> KeyFrame:
    return KeyFrame(frame, visibility, tuple(tuple((p[0], p[1]) for p in polygon) for polygon in polygons))
