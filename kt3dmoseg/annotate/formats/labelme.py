"""LabelMe: a zip of JSON files, one per frame and named as the frame, with polygons.

Kept: each object's polygons in every frame to 1/100 pixel, whether it is occluded, its id, name, kind and
motion. Not kept: which frames are key frames (every frame becomes one), occluded objects without a
position, notes, marks. Reading, shapes with the same ``group_id``, or without one the same label, are one
object; one without a shape in a file is outside there, and a frame without a file is not annotated.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

from kt3dmoseg.annotate.formats import AnnotationFormat
from kt3dmoseg.annotate.formats.foreign import (
    ForeignObject,
    Import,
    Shape,
    ellipse,
    identity_in,
    motion_from,
    strict,
    unzip_frames,
    with_corner_origin,
)
from kt3dmoseg.annotate.model import Annotation, parse_document
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import zip_bytes

_DESCRIPTION = re.compile(r"kind=(\w+) motion=(\d{1,4}|reject)")


def _dump(annotation: Annotation, regions: Mapping[int, list[Region]], names: Sequence[str] = ()) -> bytes:
    pictures = names or [f"{frame:06d}.png" for frame in range(annotation.n_frames)]
    return zip_bytes(
        {
            f"{PurePosixPath(picture).stem}.json": _frame_file(annotation, regions, frame, picture)
            for frame, picture in enumerate(pictures)
        }
    )


def _read(content: bytes, into: Import) -> None:
    """Read a zip of files, or a single one."""
    if content.lstrip()[:1] == b"{":
        data = parse_document(content, "LabelMe")
        path = data.get("imagePath")
        files = into.match([str(path)], "LabelMe imagePath")
        _read_file(data, str(path), files[str(path)], into)
        return
    for frame, file, text in unzip_frames(content, ".json", into, "LabelMe"):
        _read_file(parse_document(text, f"LabelMe: {file}"), file, frame, into)


LABELME = AnnotationFormat(".zip", "application/zip", _dump, strict(_read), _read)


def _read_file(data: Any, file: str, frame: int, into: Import) -> None:  # noqa: ANN401
    try:
        shapes = list(data["shapes"])
        sides = data.get("imageWidth"), data.get("imageHeight")
        size = None if None in sides else (int(sides[0]), int(sides[1]))
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        expected = "shapes with label and points"
        raise FileFormatError(f"LabelMe: {file}", expected=expected, found=repr(error)[:80]) from error
    scale = into.scale(size, f"LabelMe: {file}")
    into.annotated.add(frame)
    for k, shape in enumerate(shapes):
        with into.skipping(f"{file}: shapes[{k}]"):
            _read_shape(shape, frame, scale, into)


def _frame_file(
    annotation: Annotation, regions: Mapping[int, list[Region]], frame: int, picture: str
) -> bytes:
    width, height = annotation.image_size
    shapes = [
        {
            "label": item.name,
            "points": with_corner_origin(polygon),
            "group_id": item.id,
            "description": f"kind={item.kind} motion={item.motion}",
            "shape_type": "polygon",
            "flags": {"occluded": True} if regions[item.id][frame].visibility == "occluded" else {},
        }
        for item in annotation.objects
        for polygon in regions[item.id][frame].polygons
    ]
    data: dict[str, Any] = {
        "version": "5.5.0",
        "flags": {},
        "shapes": shapes,
        "imagePath": picture,
        "imageData": None,
        "imageHeight": height,
        "imageWidth": width,
    }
    return json.dumps(data, indent=1).encode()


def _read_shape(shape: dict[str, Any], frame: int, scale: tuple[float, float], into: Import) -> None:
    points = into.outline(_outline(shape), scale)
    label = str(shape["label"])
    key, source = identity_in(shape, ("group_id",))
    if key is not None:
        into.note(f"ids come from {source}")
    ours = _DESCRIPTION.search(str(shape.get("description") or ""))
    kind, motion = ours.groups() if ours else (label, "")
    hidden = (shape.get("flags") or {}).get("occluded")
    about = ForeignObject(label, kind, motion_from(motion))
    into.add(Shape(frame, key, label, [points], about, "occluded" if hidden else "visible"))


def _outline(shape: dict[str, Any]) -> Any:  # noqa: ANN401  # checked by the caller
    form, points = shape.get("shape_type", "polygon"), shape["points"]
    if form == "rectangle" and len(points) == 2:
        (left, top), (right, bottom) = points
        return [(left, top), (right, top), (right, bottom), (left, bottom)]
    if form == "circle" and len(points) == 2:
        (x, y), (edge_x, edge_y) = points
        radius = math.hypot(edge_x - x, edge_y - y)
        return ellipse(x, y, radius, radius)
    if form not in ("polygon", "rectangle"):
        expected = "a polygon, rectangle or circle"
        raise InvalidValueError("shape_type", expected=expected, found=repr(form)[:40])
    return points
