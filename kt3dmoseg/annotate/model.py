"""The annotation of a clip: objects whose regions are drawn on key frames, and single marks.

Everything is immutable and hashable, so that one edit shares all that it did not touch with the
annotation before it, and undo is nothing but remembering the former value.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, TypeAlias, get_args

from kt3dmoseg.annotate.checks import (
    MAX_FRAMES,
    MAX_OBJECTS,
    MAX_SIDE,
    REJECT,
    Motion,
    Polygon,
    check_motion,
    polygon_from,
    polygons_from,
    text,
    whole,
    within,
)
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.registry import unknown_name

FORMAT = "kt3dmoseg-annotation"
VERSION = 1
PROTOCOL = 1

Visibility: TypeAlias = Literal["visible", "occluded", "outside"]

BACKGROUND = 0
VISIBILITIES: tuple[str, ...] = get_args(Visibility)
KINDS = ("car", "van", "truck", "bus", "tram", "motorcycle", "cyclist", "pedestrian", "animal", "other")


@dataclass(frozen=True)
class KeyFrame:
    """What a person said about one object in one frame; it holds until the next key frame.

    Parameters
    ----------
    frame : int
        0-based index in the clip.
    visibility : {"visible", "occluded", "outside"}
        Whether the object is seen there, is hidden by something else, or is not in the picture.
    polygons : sequence of sequences of (x, y)
        The region in pixels, the union of the polygons; at least one where visible, none outside.
        In an occluded frame it may tell where the hidden object is.

    Raises
    ------
    InvalidValueError
        The message names the field.
    """

    frame: int
    visibility: Visibility = "visible"
    polygons: tuple[Polygon, ...] = ()

    def __post_init__(self) -> None:
        whole("frame", self.frame, 0, MAX_FRAMES)
        if self.visibility not in VISIBILITIES:
            expected = f"one of {', '.join(VISIBILITIES)}"
            raise InvalidValueError("visibility", expected=expected, found=repr(self.visibility))
        object.__setattr__(self, "polygons", polygons_from(self.polygons))
        if self.visibility == "visible" and not self.polygons:
            raise InvalidValueError("polygons", expected="at least one where visible", found="none")
        if self.visibility == "outside" and self.polygons:
            raise InvalidValueError("polygons", expected="none where outside", found=f"{len(self.polygons)}")


@dataclass(frozen=True)
class AnnotatedObject:
    """One object of a clip.

    Parameters
    ----------
    id : int
        Unique in the clip, at least 1.
    name : str
        What people call it: ``"white van"``.
    kind : str
        One of `KINDS`.
    motion : int or "reject"
        1, 2, ... = a motion, shared by all objects that move as one rigid body; 0 = a part of the
        static scene in front of a moving object; ``"reject"`` = ambiguous, nobody should be scored there.
    key_frames : sequence of KeyFrame
        At least one, at different frames; kept in ascending order.
    note : str
        Why, when it is not obvious.
    """

    id: int
    name: str
    kind: str
    motion: Motion
    key_frames: tuple[KeyFrame, ...]
    note: str = ""

    def __post_init__(self) -> None:
        whole("id", self.id, 1, 1_000_000_000)
        text("name", self.name)
        text("note", self.note, empty=True)
        if self.kind not in KINDS:
            raise InvalidValueError(str(unknown_name("kind", self.kind, KINDS, where="kind")))
        check_motion(self.motion)
        keys = tuple(sorted(self.key_frames, key=lambda key: key.frame))
        if not keys:
            raise InvalidValueError("key_frames", expected="at least one", found="none")
        for before, after in pairwise(keys):
            if before.frame == after.frame:
                found = f"frame {after.frame} twice"
                raise InvalidValueError("key_frames", expected="different frames", found=found)
        object.__setattr__(self, "key_frames", keys)

    def key_at(self, frame: int) -> KeyFrame | None:
        """Return the key frame at `frame`, or None."""
        return next((key for key in self.key_frames if key.frame == frame), None)


@dataclass(frozen=True)
class Mark:
    """A lasso: every trajectory inside the polygon in that one frame has this motion.

    Parameters
    ----------
    frame : int
        0-based index in the clip.
    motion : int or "reject"
        As for objects; 0 = background.
    polygon : sequence of (x, y)
        In pixels.
    """

    frame: int
    motion: Motion
    polygon: Polygon

    def __post_init__(self) -> None:
        whole("frame", self.frame, 0, MAX_FRAMES)
        check_motion(self.motion)
        object.__setattr__(self, "polygon", polygon_from(self.polygon, "polygon"))


@dataclass(frozen=True)
class Annotation:
    """What a person says about the motions of a clip, in pixels, independent of any tracker.

    Parameters
    ----------
    clip : str
        Name of the clip.
    image_size : (W, H)
        Of the frames, in pixels.
    n_frames : int
        Number of frames of the clip.
    objects : sequence of AnnotatedObject
        With unique ids.
    marks : sequence of Mark
        Lassoed trajectories; they overrule the regions, a later one an earlier one.
    annotator : str
        Who drew it.
    protocol : int
        Version of annotations/PROTOCOL.md that was followed.
    revision : int
        Grows with every save.

    Raises
    ------
    InvalidValueError
        The message names the field.
    """

    clip: str
    image_size: tuple[int, int]
    n_frames: int
    objects: tuple[AnnotatedObject, ...] = ()
    marks: tuple[Mark, ...] = ()
    annotator: str = ""
    protocol: int = PROTOCOL
    revision: int = 0

    def __post_init__(self) -> None:
        text("clip", self.clip)
        text("annotator", self.annotator, empty=True)
        whole("n_frames", self.n_frames, 1, MAX_FRAMES)
        whole("protocol", self.protocol, 1, MAX_FRAMES)
        whole("revision", self.revision, 0, 2**53)
        width, height = self.image_size
        whole("image_size[0]", width, 1, MAX_SIDE)
        whole("image_size[1]", height, 1, MAX_SIDE)
        object.__setattr__(self, "image_size", (width, height))
        object.__setattr__(self, "objects", tuple(self.objects))
        object.__setattr__(self, "marks", tuple(self.marks))
        _check_objects(self)
        for i, mark in enumerate(self.marks):
            with within(f"marks[{i}]"):
                whole("frame", mark.frame, 0, self.n_frames - 1)

    @property
    def motions(self) -> list[int]:
        """The motion numbers (>= 1) in use, ascending."""
        used = [item.motion for item in self.objects] + [mark.motion for mark in self.marks]
        return sorted({m for m in used if m != REJECT and m >= 1})

    def object(self, object_id: int) -> AnnotatedObject:
        """Return the object of that id.

        Raises
        ------
        InvalidValueError
            When there is none.
        """
        for candidate in self.objects:
            if candidate.id == object_id:
                return candidate
        known = ", ".join(str(o.id) for o in self.objects) or "none"
        raise InvalidValueError("object", expected=f"an id among: {known}", found=str(object_id))

    def emptied(self) -> Annotation:
        """Return the annotation of the same clip without objects and marks."""
        return replace(self, objects=(), marks=())

    def with_object(self, changed: AnnotatedObject) -> Annotation:
        """Return the annotation with `changed` in place of the object of the same id."""
        self.object(changed.id)
        return replace(self, objects=tuple(changed if o.id == changed.id else o for o in self.objects))


def _check_objects(annotation: Annotation) -> None:
    if len(annotation.objects) > MAX_OBJECTS:
        found = str(len(annotation.objects))
        raise InvalidValueError("objects", expected=f"at most {MAX_OBJECTS}", found=found)
    seen: set[int] = set()
    for i, item in enumerate(annotation.objects):
        with within(f"objects[{i}]"):
            if item.id in seen:
                raise InvalidValueError("id", expected="unique ids", found=f"{item.id} twice")
            seen.add(item.id)
            for k, key in enumerate(item.key_frames):
                with within(f"key_frames[{k}]"):
                    whole("frame", key.frame, 0, annotation.n_frames - 1)
