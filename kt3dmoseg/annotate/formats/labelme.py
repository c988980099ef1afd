"""LabelMe: a zip of JSON files, one per frame and named as the frame, with polygons.

Kept: each object's polygons in every frame to 1/100 pixel, whether it is occluded, its id, name, kind and
motion. Not kept: which frames are key frames (every frame becomes one), occluded objects without a
position, notes, marks. An object without a shape in a frame is outside there. Reading, shapes with the same
``group_id``, or without one the same label, are one object.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

from kt3dmoseg.annotate.formats import AnnotationFormat
from kt3dmoseg.annotate.formats.foreign import (
    ForeignObject,
    assemble,
    motion_from,
    unzip_frames,
    with_centre_origin,
    with_corner_origin,
)
from kt3dmoseg.annotate.model import Annotation, Polygon, within
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


def _parse(content: bytes, like: Annotation, names: Sequence[str] = ()) -> Annotation:
    found: dict[int | str, ForeignObject] = {}
    for frame, text in sorted(unzip_frames(content, ".json", like, names, "LabelMe").items()):
        try:
            for k, shape in enumerate(json.loads(text)["shapes"]):
                with within(f"frame {frame}: shapes[{k}]"):
                    _read_shape(shape, frame, found)
        except InvalidValueError:
            raise
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            expected, where = "shapes with label and points", f"LabelMe frame {frame}"
            raise FileFormatError(where, expected=expected, found=repr(error)[:80]) from error
    if all(isinstance(key, int) for key in found):
        found = dict(sorted(found.items()))
    return assemble(found, like)


LABELME = AnnotationFormat(".zip", "application/zip", _dump, _parse)


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


def _read_shape(shape: dict[str, Any], frame: int, found: dict[int | str, ForeignObject]) -> None:
    points = _outline(shape)
    label, group = str(shape["label"]), shape.get("group_id")
    key = label if group is None else int(group)
    if key not in found:
        ours = _DESCRIPTION.search(str(shape.get("description") or ""))
        kind, motion = ours.groups() if ours else (label.lower(), "")
        found[key] = ForeignObject(label, kind, motion_from(motion))
    hidden = (shape.get("flags") or {}).get("occluded") or found[key].visibility.get(frame) == "occluded"
    found[key].add(frame, [points], "occluded" if hidden else "visible")


def _outline(shape: dict[str, Any]) -> Polygon:
    form, points = shape.get("shape_type", "polygon"), shape["points"]
    if form == "rectangle" and len(points) == 2:
        (left, top), (right, bottom) = points
        points = [(left, top), (right, top), (right, bottom), (left, bottom)]
    elif form not in ("polygon", "rectangle"):
        raise InvalidValueError("shape_type", expected="'polygon' or 'rectangle'", found=repr(form)[:40])
    return with_centre_origin(points, "points")
