"""Annotations as JSON: see annotations/SCHEMA.json.

Readers accept what the schema accepts and say which field is wrong; writers are deterministic, one
polygon a line, so that a revision reads well in a diff.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from kt3dmoseg.annotate.checks import within
from kt3dmoseg.annotate.model import FORMAT, VERSION, AnnotatedObject, Annotation, KeyFrame, Mark
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import read_bytes, write_text
from kt3dmoseg.registry import unknown_name

T = TypeVar("T")
MAX_BYTES = 32 << 20
_DECIMALS = 2


def load_annotation(path: str | os.PathLike[str]) -> Annotation:
    """Read the annotation of a clip.

    Parameters
    ----------
    path : path
        A JSON file as written by `save_annotation`.

    Raises
    ------
    InputFileError
        When it cannot be read, or is larger than 32 MiB.
    FileFormatError
        When it is not an annotation; the message names the field.
    """
    name = os.fspath(path)
    content = read_bytes(path, MAX_BYTES)
    try:
        return from_json(json.loads(content))
    except InvalidValueError as error:
        raise FileFormatError(
            f"{name}: {error.where}", expected=error.expected, found=error.found, fix=error.fix
        ) from error
    except (ValueError, RecursionError) as error:
        raise FileFormatError(name, expected="an annotation in JSON", found=str(error)[:100]) from error


def save_annotation(path: str | os.PathLike[str], annotation: Annotation) -> None:
    """Write an annotation atomically.

    Raises
    ------
    InputFileError
        When the file cannot be written.
    """
    write_text(path, dumps(annotation))


def dumps(annotation: Annotation) -> str:
    """Return the JSON text of an annotation, one polygon a line."""
    return _indented(to_json(annotation), 0) + "\n"


def to_json(annotation: Annotation) -> dict[str, Any]:
    """Return an annotation as JSON-able values; coordinates rounded to 1/100 pixel."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "clip": annotation.clip,
        "revision": annotation.revision,
        "protocol": annotation.protocol,
        "annotator": annotation.annotator,
        "image_size": list(annotation.image_size),
        "n_frames": annotation.n_frames,
        "objects": [_object_to_json(item) for item in annotation.objects],
        "marks": [
            {"frame": m.frame, "motion": m.motion, "polygon": _polygon_to_json(m.polygon)}
            for m in annotation.marks
        ],
    }


def from_json(data: object) -> Annotation:
    """Build an annotation from parsed JSON.

    Raises
    ------
    InvalidValueError
        When a field is missing, unknown, or of a wrong type or value; the message names it.
    """
    fields = _mapping(data, "annotation", _TOP, optional=("marks",))
    if fields["format"] != FORMAT:
        raise InvalidValueError("format", expected=repr(FORMAT), found=repr(fields["format"])[:80])
    if fields["version"] != VERSION:
        fix = "read it with a newer kt3dmoseg"
        raise InvalidValueError("version", expected=f"{VERSION}", found=repr(fields["version"])[:80], fix=fix)
    size = _list(fields["image_size"], "image_size")
    if len(size) != 2:
        raise InvalidValueError("image_size", expected="[width, height]", found=repr(size)[:80])
    return Annotation(
        clip=fields["clip"],
        image_size=(size[0], size[1]),
        n_frames=fields["n_frames"],
        objects=_each(fields["objects"], "objects", object_from_json),
        marks=_each(fields.get("marks", []), "marks", _mark_from_json),
        annotator=fields["annotator"],
        protocol=fields["protocol"],
        revision=fields["revision"],
    )


def object_from_json(data: object) -> AnnotatedObject:
    """Build one object from parsed JSON; raises as `from_json`."""
    fields = _mapping(data, "object", ("id", "name", "kind", "motion", "key_frames"), optional=("note",))
    keys = _each(fields.pop("key_frames"), "key_frames", _key_from_json)
    return AnnotatedObject(**fields, key_frames=keys)


_TOP = (
    "format",
    "version",
    "clip",
    "revision",
    "protocol",
    "annotator",
    "image_size",
    "n_frames",
    "objects",
)


def _indented(value: Any, depth: int) -> str:  # noqa: ANN401  # whatever JSON holds
    """Lay JSON out one entry a line, but lists of numbers and of points on one line each."""
    inner, outer = "\n" + " " * (depth + 1), "\n" + " " * depth
    if isinstance(value, dict) and value:
        entries = [f"{json.dumps(key)}: {_indented(entry, depth + 1)}" for key, entry in value.items()]
        return "{" + inner + f",{inner}".join(entries) + outer + "}"
    if isinstance(value, list) and value and not _is_flat(value):
        return "[" + inner + f",{inner}".join(_indented(entry, depth + 1) for entry in value) + outer + "]"
    return json.dumps(value, ensure_ascii=False)


def _is_flat(value: list[Any]) -> bool:
    first = value[0]
    return isinstance(first, (int, float)) or (isinstance(first, list) and not isinstance(first[0], list))


def _object_to_json(item: AnnotatedObject) -> dict[str, Any]:
    keys = [
        {
            "frame": key.frame,
            "visibility": key.visibility,
            "polygons": [_polygon_to_json(polygon) for polygon in key.polygons],
        }
        for key in item.key_frames
    ]
    out: dict[str, Any] = {"id": item.id, "name": item.name, "kind": item.kind, "motion": item.motion}
    if item.note:
        out["note"] = item.note
    return out | {"key_frames": keys}


def _polygon_to_json(polygon: tuple[tuple[float, float], ...]) -> list[list[float]]:
    return [[round(x, _DECIMALS), round(y, _DECIMALS)] for x, y in polygon]


def _key_from_json(data: object) -> KeyFrame:
    fields = _mapping(data, "key frame", ("frame",), optional=("visibility", "polygons"))
    polygons = _list(fields.get("polygons", []), "polygons")
    points = tuple(_points(polygon, f"polygons[{i}]") for i, polygon in enumerate(polygons))
    return KeyFrame(fields["frame"], fields.get("visibility", "visible"), points)


def _mark_from_json(data: object) -> Mark:
    fields = _mapping(data, "mark", ("frame", "motion", "polygon"))
    return Mark(fields["frame"], fields["motion"], _points(fields["polygon"], "polygon"))


def _points(data: object, where: str) -> Any:  # noqa: ANN401  # pairs, whose numbers the model checks
    return tuple(tuple(_list(point, f"{where}[{i}]")) for i, point in enumerate(_list(data, where)))


def _each(data: object, where: str, build: Callable[[object], T]) -> tuple[T, ...]:
    out = []
    for i, entry in enumerate(_list(data, where)):
        with within(f"{where}[{i}]"):
            out.append(build(entry))
    return tuple(out)


def _list(data: object, where: str) -> list[Any]:
    if not isinstance(data, list):
        raise InvalidValueError(where, expected="a list", found=repr(data)[:80])
    return data


def _mapping(
    data: object, what: str, required: tuple[str, ...], *, optional: tuple[str, ...] = ()
) -> dict[str, Any]:
    if not isinstance(data, Mapping):
        raise InvalidValueError(what, expected="a JSON object", found=repr(data)[:80])
    for name in required:
        if name not in data:
            raise InvalidValueError(name, expected="this field", found="nothing")
    for name in data:
        if name not in required and name not in optional:
            raise InvalidValueError(str(unknown_name("field", name, (*required, *optional), where=str(name))))
    return dict(data)
