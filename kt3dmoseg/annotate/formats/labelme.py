"""LabelMe: a zip of JSON files, one per frame and named as the frame, with polygons.

Reading, shapes with the same ``group_id``, or without one the same label, are one object; one without a shape
in a file is outside there, and a frame without a file is not annotated.
"""

import json
import math
import re
from collections.abc import Sequence
from pathlib import PurePosixPath
from typing import Any

from kt3dmoseg.annotate.formats.foreign import AnnotationFormat, Import, Regions, ellipse, with_corner_origin
from kt3dmoseg.annotate.model import Annotation, Visibility, parse_document
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import zip_bytes
from kt3dmoseg.matching import stem

_DESCRIPTION = re.compile(r"kind=(\w+) motion=(\d{1,4}|reject)")


def _write(annotation: Annotation, regions: Regions, names: Sequence[str]) -> bytes:
    width, height = annotation.image_size
    files = {}
    for frame, picture in enumerate(names):
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
        files[f"{PurePosixPath(picture).stem}.json"] = json.dumps(data, indent=1).encode()
    return zip_bytes(files)


def _read(content: bytes, into: Import) -> None:
    if not content.startswith(b"PK"):
        data = parse_document(content, "LabelMe")
        if not isinstance(data, dict) or "imagePath" not in data:
            raise FileFormatError("LabelMe", expected="imagePath and shapes", found=repr(data)[:80])
        path = str(data["imagePath"])
        _read_file(data, path, into.match([path], "LabelMe imagePath")[path], into)
        return
    for frame, file, text in into.unzip(content, ".json", "LabelMe"):
        _read_file(parse_document(text, f"LabelMe: {file}"), file, frame, into)


LABELME = AnnotationFormat(".zip", "application/zip", _write, _read)


def _read_file(data: Any, file: str, frame: int, into: Import) -> None:  # noqa: ANN401
    if not isinstance(data, dict) or not isinstance(shapes := data.get("shapes"), list):
        expected, found = "shapes with label and points", repr(data)[:80]
        raise FileFormatError(f"LabelMe: {file}", expected=expected, found=found)
    scale = into.scale((data.get("imageWidth"), data.get("imageHeight")), f"LabelMe: {file}")
    named = stem(str(data.get("imagePath") or file))
    if named != stem(into.names[frame]) and named in map(stem, into.names) and not into.doubts:
        into.doubts.append(f"{file} is not named as its imagePath, {named}")
    into.annotated.add(frame)
    for k, shape in enumerate(shapes):
        with into.skipping(f"{file}: shapes[{k}]"):
            label = str(shape["label"])
            fields = {"name": label, "group_id": shape.get("group_id")}
            into.reading(frame, label, fields)
            points = into.outline(_corners(shape), scale)
            ours = _DESCRIPTION.search(str(shape.get("description") or ""))
            kind, motion = ours.groups() if ours else (label, "")
            hidden = (shape.get("flags") or {}).get("occluded")
            seen: Visibility = "occluded" if hidden else "visible"
            into.add(frame, label, [points], fields | {"motion": motion}, kind, seen)


def _corners(shape: dict[str, Any]) -> Any:  # noqa: ANN401  # checked by the caller
    form, points = shape.get("shape_type", "polygon"), shape["points"]
    if form == "polygon":
        return points
    if form not in ("rectangle", "circle"):
        expected = "a polygon, rectangle or circle"
        raise InvalidValueError("shape_type", expected=expected, found=repr(form)[:40])
    if form == "rectangle" and len(points) == 4:
        return points
    (left, top), (right, bottom) = points
    if form == "rectangle":
        return [(left, top), (right, top), (right, bottom), (left, bottom)]
    radius = math.hypot(right - left, bottom - top)
    return ellipse(left, top, radius, radius)
