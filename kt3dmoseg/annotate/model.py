"""The annotation of a clip: objects whose regions are drawn on key frames, and single marks; as JSON.

Everything is immutable and hashable, so that one edit shares all that it did not touch with the
annotation before it. pydantic checks the fields, wherever they come from, and InvalidValueError names the
one that is wrong; the bounds are those of what a person draws, and keep a hostile file from costing memory
or time. annotations/SCHEMA.json is `json_schema`.
Writing is deterministic, one polygon a line, so that a revision reads well in a diff.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import wraps
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, TypeVar, dataclass_transform, get_args

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    FailFast,
    Field,
    PlainSerializer,
    TypeAdapter,
    ValidationError,
)
from pydantic.dataclasses import dataclass
from pydantic_core import ErrorDetails

from kt3dmoseg.errors import FileFormatError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import PathLike, hold_folder, parse_json, read_bytes, write_text
from kt3dmoseg.registry import nearest, unknown_name

T = TypeVar("T")

FORMAT = "kt3dmoseg-annotation"
PROPOSALS = "kt3dmoseg-proposals"  # the same content, which nobody has checked: no annotation
BUILT = ".proposals.json"  # after the clip's name, in the folder of annotations
VERSION = 1
PROTOCOL = 1
BACKGROUND = 0
REJECT: Literal["reject"] = "reject"

MAX_FRAMES = 100_000
MAX_OBJECTS = 1_000
MAX_POLYGONS = 200
MAX_POINTS = 5_000
MAX_SIDE = 100_000
MAX_CLICKS = 100
LEAST_BOX = 3
_MAX_BYTES = 32 << 20
_MAX_VALUES = 1_500_000
_OTHERS = {"segmentations": "YouTube-VIS", "result": "JSON of Label Studio"}
_DECIMALS = 2
_ORDER = ("clip", "revision", "protocol", "annotator", "image_size", "n_frames", "objects", "marks")


def _check_motion(value: object) -> object:
    if value != REJECT and (type(value) is not int or not 0 <= value <= MAX_OBJECTS):
        raise InvalidValueError(
            "", expected=f"a whole number in 0..{MAX_OBJECTS} or 'reject'", found=repr(value)
        )
    return value


def _in_order(keys: tuple[KeyFrame, ...]) -> tuple[KeyFrame, ...]:
    ordered = tuple(sorted(keys, key=lambda key: key.frame))
    for before, after in pairwise(ordered):
        if before.frame == after.frame:
            raise InvalidValueError("", expected="different frames", found=f"frame {after.frame} twice")
    return ordered


Visibility: TypeAlias = Literal["visible", "occluded", "outside"]
Kind: TypeAlias = Literal[
    "car", "van", "truck", "bus", "tram", "motorcycle", "cyclist", "pedestrian", "animal", "other"
]
KINDS: tuple[Kind, ...] = get_args(Kind)
Motion: TypeAlias = Annotated[
    Annotated[int, Field(ge=0, le=MAX_OBJECTS)] | Literal["reject"], BeforeValidator(_check_motion)
]
Coordinate: TypeAlias = Annotated[float, Field(strict=True, ge=-MAX_SIDE, le=MAX_SIDE, allow_inf_nan=False)]
Point: TypeAlias = tuple[Coordinate, Coordinate]
Box: TypeAlias = tuple[Coordinate, Coordinate, Coordinate, Coordinate]
"""Left, top, right and bottom in pixels."""
Click: TypeAlias = tuple[Coordinate, Coordinate, Annotated[bool, Field(strict=True)]]
"""x and y in pixels, and whether it adds or takes away."""
Polygon: TypeAlias = Annotated[
    tuple[Point, ...],
    Field(min_length=3, max_length=MAX_POINTS),
    FailFast(),
    PlainSerializer(lambda polygon: [[round(x, _DECIMALS), round(y, _DECIMALS)] for x, y in polygon]),
]
_Frame: TypeAlias = Annotated[int, Field(strict=True, ge=0, le=MAX_FRAMES)]
_Count: TypeAlias = Annotated[int, Field(strict=True, ge=1, le=MAX_FRAMES)]
_Side: TypeAlias = Annotated[int, Field(strict=True, ge=1, le=MAX_SIDE)]
_Text: TypeAlias = Annotated[str, Field(strict=True, max_length=500)]
_Name: TypeAlias = Annotated[_Text, Field(min_length=1, pattern=r"\S")]


@dataclass_transform(frozen_default=True)
def _checked(cls: type[T]) -> type[T]:
    """Make a frozen dataclass whose fields pydantic checks, with errors of this package."""
    made: Any = dataclass(frozen=True, config=ConfigDict(extra="forbid", regex_engine="python-re"))(cls)
    plain = made.__init__

    @wraps(plain)
    def init(self: object, *args: Any, **kwargs: Any) -> None:  # noqa: ANN401  # whatever is to be checked
        with within():
            plain(self, *args, **kwargs)

    made.__init__ = init
    return made  # type: ignore[no-any-return]


@_checked
class KeyFrame:
    """What a person drew of one object in one frame; it holds until the next key frame.

    Parameters
    ----------
    frame : int
        0-based index in the clip.
    visibility : {"visible", "occluded", "outside"}
        Whether the object is seen there, is hidden by something else, or is not in the picture.
    polygons : sequence of sequences of (x, y)
        The region in pixels, the union of the polygons; at least one where visible, none outside.
        In an occluded frame it may show where the hidden object is.
    """

    frame: _Frame
    visibility: Visibility = "visible"
    polygons: Annotated[tuple[Polygon, ...], Field(max_length=MAX_POLYGONS), FailFast()] = ()

    def __post_init__(self) -> None:
        if self.visibility == "visible" and not self.polygons:
            raise InvalidValueError("polygons", expected="at least one where visible", found="none")
        if self.visibility == "outside" and self.polygons:
            raise InvalidValueError("polygons", expected="none where outside", found=f"{len(self.polygons)}")


@_checked
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

    id: Annotated[int, Field(strict=True, ge=1, le=1_000_000_000)]
    name: _Name
    kind: Kind
    motion: Motion
    key_frames: Annotated[
        tuple[KeyFrame, ...],
        Field(min_length=1, max_length=MAX_FRAMES),
        FailFast(),
        AfterValidator(_in_order),
    ]
    note: _Text = ""


@_checked
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

    frame: _Frame
    motion: Motion
    polygon: Polygon


@_checked
class Clicks:
    """Where a frame was clicked, to outline what moves there; alone, the first click adds.

    The box, at least 3 pixels wide and high, is around what moves; `like` is the shape to expect in it, or
    without a box that to correct.
    """

    frame: _Frame
    clicks: Annotated[tuple[Click, ...], Field(max_length=MAX_CLICKS), FailFast()]
    box: Box | None = None
    like: Annotated[tuple[Polygon, ...], Field(max_length=MAX_POLYGONS), FailFast()] = ()

    def __post_init__(self) -> None:
        if self.box is not None:
            left, top, right, bottom = self.box
            if right - left < LEAST_BOX or bottom - top < LEAST_BOX:
                expected = f"left, top, right and bottom, {LEAST_BOX} pixels apart"
                raise InvalidValueError("box", expected=expected, found=repr(self.box))
        elif not self.clicks:
            raise InvalidValueError("clicks", expected="one, or a box", found="none")
        elif not (self.clicks[0][2] or self.like):
            raise InvalidValueError("clicks[0][2]", expected="true: the first click adds", found="false")


@_checked
class Stroke:
    """A stroke of a round brush, by its middle, that adds to the outline or takes away; all in pixels."""

    polygons: Annotated[tuple[Polygon, ...], Field(max_length=MAX_POLYGONS), FailFast()]
    stroke: Annotated[tuple[Point, ...], Field(min_length=1, max_length=MAX_POINTS), FailFast()]
    radius: Annotated[float, Field(strict=True, ge=0.5, le=200)]
    adds: Annotated[bool, Field(strict=True)]


@_checked
class Choices:
    """What a person adds to frame numbers of a file, and its pixels are multiplied by; None = as it says."""

    shift: Annotated[int, Field(ge=-MAX_FRAMES, le=MAX_FRAMES)] | None = None
    scale: Annotated[float, Field(ge=0.001, le=1000, allow_inf_nan=False)] | None = None


@_checked
class Annotation:
    """What a person drew of the motions of a clip, in pixels, independent of any tracker.

    Parameters
    ----------
    clip : str
        Name of the clip.
    image_size : (W, H)
        Of the frames, in pixels: x right, y down, (0, 0) is the centre of the top-left pixel.
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
    """

    clip: _Name
    image_size: tuple[_Side, _Side]
    n_frames: _Count
    objects: Annotated[tuple[AnnotatedObject, ...], Field(max_length=MAX_OBJECTS), FailFast()] = ()
    marks: Annotated[tuple[Mark, ...], FailFast()] = ()
    annotator: _Text = ""
    protocol: _Count = PROTOCOL
    revision: Annotated[int, Field(strict=True, ge=0, le=2**53)] = 0

    def __post_init__(self) -> None:
        first: dict[int, int] = {}
        frames = [(f"marks[{i}].frame", mark.frame) for i, mark in enumerate(self.marks)]
        for i, item in enumerate(self.objects):
            if first.setdefault(item.id, i) != i:
                raise InvalidValueError(f"objects[{i}].id", expected="unique ids", found=f"{item.id} twice")
            # They are in order.
            last = len(item.key_frames) - 1
            frames.append((f"objects[{i}].key_frames[{last}].frame", item.key_frames[last].frame))
        for where, frame in frames:
            if frame >= self.n_frames:
                expected = f"a whole number in 0..{self.n_frames - 1}"
                raise InvalidValueError(where, expected=expected, found=str(frame))

    @property
    def motions(self) -> list[int]:
        """The motion numbers (>= 1) in use, ascending."""
        used = {item.motion for item in self.objects} | {mark.motion for mark in self.marks}
        return sorted(m for m in used if m != REJECT and m >= 1)

    def with_free_numbers(self, objects: Iterable[AnnotatedObject]) -> list[AnnotatedObject]:
        """Return objects from elsewhere under ids and motions that this annotation does not use yet."""
        first, used = max((item.id for item in self.objects), default=0) + 1, max(self.motions, default=0)
        return [
            replace(
                o, id=number, motion=o.motion if o.motion in (BACKGROUND, REJECT) else int(o.motion) + used
            )
            for number, o in enumerate(objects, first)
        ]

    def expect(self, where: str = "", **wanted: object) -> Annotation:
        """Return the annotation; InvalidValueError names, after `where`, what is not as wanted; None: any."""
        for name, value in wanted.items():
            if value is not None and (found := getattr(self, name)) != value:
                raise InvalidValueError(f"{where}{name}", expected=repr(value), found=repr(found))
        return self

    def emptied(self) -> Annotation:
        """Return the annotation of the same clip without objects and marks."""
        return replace(self, objects=(), marks=())


def load_annotation(path: PathLike, form: str = FORMAT) -> Annotation:
    """Read the annotation of a clip.

    Parameters
    ----------
    path : path
        A JSON file as written by `save_annotation`.
    form : str
        The format that the file must state: `PROPOSALS` for a file of proposals.

    Raises
    ------
    InputFileError
        When it cannot be read, or is larger than 32 MiB.
    FileFormatError
        When it is not an annotation; the message names the field.
    """
    name = os.fspath(path)
    try:
        return from_json(parse_document(read_bytes(path, _MAX_BYTES), name), form)
    except InvalidValueError as error:
        raise _moved(error, f"{name}: {error.where}", FileFormatError) from error


def parse_document(content: bytes, where: str) -> Any:  # noqa: ANN401  # whatever JSON holds
    """Parse JSON of at most 32 MiB and 150 MB of values; FileFormatError names `where` or the wrong tool."""
    found = part = parse_json(content, where, _MAX_BYTES, values=_MAX_VALUES)
    while part and isinstance(part, list | dict):
        for tool in (_OTHERS[key] for key in _OTHERS if key in part):
            fix = "write COCO, one annotation per object and frame, with track_id"
            raise FileFormatError(where, expected="another format", found=tool, fix=fix)
        part = part[0] if isinstance(part, list) else part.get("annotations")
    return found


def save_annotation(path: PathLike, annotation: Annotation, form: str = FORMAT) -> None:
    """Write an annotation atomically; raises InputFileError when the file cannot be written."""
    write_text(path, dumps(annotation, form))


class StaleRevisionError(KT3DMoSegError):
    """The file was saved by somebody else since it was read; `current` is what they saved."""

    current: Annotation

    @classmethod
    def check(cls, where: str, mine: int, current: Annotation) -> None:
        """Raise the error where `current` is of another revision than mine."""
        if mine != current.revision:
            theirs, fix = f"revision {current.revision}", "read it again and merge the edits"
            stale = cls(where, expected=f"revision {mine}", found=theirs, fix=fix)
            stale.current = current
            raise stale


def save_revision(path: PathLike, annotation: Annotation) -> Annotation:
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
        if current is not None:
            StaleRevisionError.check(f"{target}", annotation.revision, current)
        saved = replace(annotation, revision=annotation.revision + 1)
        save_annotation(target, saved)
    return saved


def dumps(annotation: Annotation, form: str = FORMAT) -> str:
    """Return the JSON text of an annotation, one polygon a line."""
    return _indented(to_json(annotation) | {"format": form}, "\n") + "\n"


def _indented(value: Any, line: str) -> str:  # noqa: ANN401  # whatever JSON holds
    first = value[0] if isinstance(value, list) and value else None
    if isinstance(value, dict):
        parts = [f"{json.dumps(key)}: {_indented(item, line + ' ')}" for key, item in value.items()]
    elif isinstance(first, dict) or (isinstance(first, list) and isinstance(first[0], list)):
        parts = [_indented(item, line + " ") for item in value]
    else:
        return json.dumps(value, ensure_ascii=False)
    opening, closing = "{}" if isinstance(value, dict) else "[]"
    return f"{opening}{line} " + f",{line} ".join(parts) + line + closing


def to_json(annotation: Annotation) -> dict[str, Any]:
    """Return an annotation as JSON-able values; coordinates rounded to 1/100 pixel."""
    data = _ANNOTATION.dump_python(annotation, mode="json")
    for item in data["objects"]:
        note, keys = item.pop("note"), item.pop("key_frames")
        item |= {"note": note, "key_frames": keys} if note else {"key_frames": keys}
    return {"format": FORMAT, "version": VERSION} | {name: data[name] for name in _ORDER}


def from_json(data: object, form: str = FORMAT) -> Annotation:
    """Build an annotation from parsed JSON; raises InvalidValueError, which names the field."""
    if not isinstance(data, Mapping):
        raise InvalidValueError("annotation", expected="a JSON object", found=repr(data)[:80])
    rest = dict(data)
    if missing := [name for name in _REQUIRED if name not in rest]:
        raise InvalidValueError(missing[0], expected="this field", found="nothing")
    for name, expected in (("format", form), ("version", VERSION)):
        found, fix = rest.pop(name), "" if name == "format" else "read it with a newer kt3dmoseg"
        if found == PROPOSALS:
            fix = "nobody has checked them: 'kt3dmoseg label' shows them, to be accepted one by one"
        if found != expected:
            raise InvalidValueError(name, expected=repr(expected), found=repr(found)[:80], fix=fix)
    with within():
        return _ANNOTATION.validate_python(rest)


def checked(kind: type[T], data: object) -> T:
    """Build `Clicks`, a `Stroke` or `Choices` from parsed JSON; an InvalidValueError names the field."""
    with within():
        return TypeAdapter(kind).validate_python(data)


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of annotation files, which annotations/SCHEMA.json holds."""
    schema = _ANNOTATION.json_schema()
    constants = {"format": {"const": FORMAT}, "version": {"const": VERSION}}
    beyond = "Beyond this schema, key frames of an object have different frames below n_frames."
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": f"KT3DMoSeg annotation of one clip, version {VERSION}",
        "description": f"{schema['description']}\n\n{beyond}",
        "properties": constants | schema["properties"],
        "required": _REQUIRED,
    }


@contextmanager
def within(path: str = "") -> Iterator[None]:
    """Put `path` before the field that an InvalidValueError names, or the first error of pydantic's."""
    try:
        yield
    except (ValidationError, InvalidValueError) as error:
        first = _refusal(error.errors(include_url=False)[0]) if isinstance(error, ValidationError) else error
        raise _moved(first, f"{path}.{first.where}".strip(".").replace(".[", "[")) from None


def _moved(
    error: KT3DMoSegError, where: str, kind: type[KT3DMoSegError] = InvalidValueError
) -> KT3DMoSegError:
    return kind(where, expected=error.expected, found=error.found, fix=error.fix)


_REQUIRED = ["format", "version", *(field.name for field in fields(Annotation) if field.name != "marks")]
_ANNOTATION = TypeAdapter(Annotation)
POLYGON: TypeAdapter[Polygon] = TypeAdapter(Polygon)
_MODELS = {"objects": AnnotatedObject, "key_frames": KeyFrame, "marks": Mark}
_EXPECTED = {
    "missing": "a value",
    "dataclass_type": "a JSON object",
    "tuple_type": "a list",
    "string_pattern_mismatch": "a text that is not blank",
    "string_unicode": "whole characters",
}


def _refusal(detail: ErrorDetails) -> KT3DMoSegError:
    where = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in detail["loc"]).strip(".")
    context = detail.get("ctx", {})
    cause = context.get("error")
    if isinstance(cause, InvalidValueError):
        return _moved(cause, f"{where}.{cause.where}".strip("."))
    if detail["type"] == "unexpected_keyword_argument":
        model = next((_MODELS[p] for p in reversed(detail["loc"][:-1]) if p in _MODELS), Annotation)
        known = [field.name for field in fields(model)] + ["format", "version"] * (model is Annotation)
        return InvalidValueError(str(unknown_name("field", detail["loc"][-1], known, where=where)))
    message = re.sub(r"^.* should (be |have )?| after validation.*", "", detail["msg"])
    expected = _EXPECTED.get(detail["type"], message)
    found = str(context.get("actual_length") or repr(detail["input"])[:80])
    meant = nearest(str(detail["input"]), KINDS) if detail["type"] == "literal_error" else ""
    found = "nothing" if detail["type"] == "missing" else found
    return InvalidValueError(where, expected=expected, found=found, fix=meant and f"did you mean {meant!r}?")
