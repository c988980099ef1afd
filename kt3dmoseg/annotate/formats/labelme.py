"""LabelMe: a zip of JSON files, one per frame, with polygons.

Kept: each object's polygons in every frame to 1/100 pixel, whether it is occluded, its id, name, kind and
motion. Not kept: which frames are key frames (every frame becomes one), occluded objects without a
place, notes, marks. An object without a shape in a frame is outside there.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath
from typing import Any

from kt3dmoseg.annotate.formats.archive import unpack
from kt3dmoseg.annotate.formats.corner import from_corner, to_corner
from kt3dmoseg.annotate.formats.objects import key_frames_of, known_kind, own_motions
from kt3dmoseg.annotate.model import (
    REJECT,
    AnnotatedObject,
    Annotation,
    KeyFrame,
    Kind,
    Motion,
    Polygon,
    Visibility,
    within,
)
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import zip_bytes

_DESCRIPTION = re.compile(r"kind=(\w+) motion=(\d{1,4}|reject)")
_MAX_SHAPES = 10_000


@dataclass
class _Found:
    """What the frames read so far tell about one object."""

    name: str
    kind: Kind
    motion: Motion | None
    shapes: dict[int, list[Polygon]] = field(default_factory=dict)
    occluded: set[int] = field(default_factory=set)


class LabelMe:
    """See the module."""

    suffix = ".zip"
    media_type = "application/zip"

    def dump(
        self, annotation: Annotation, regions: Mapping[int, list[Region]], names: Sequence[str] = ()
    ) -> bytes:
        """Write one JSON file per frame, named as the frame; see `AnnotationFormat`."""
        pictures = names or [f"{frame:06d}.png" for frame in range(annotation.n_frames)]
        return zip_bytes(
            {
                f"{PurePosixPath(picture).stem}.json": _frame_file(annotation, regions, frame, picture)
                for frame, picture in enumerate(pictures)
            }
        )

    def parse(self, content: bytes, like: Annotation, names: Sequence[str] = ()) -> Annotation:
        """Read a zip of JSON files; see `AnnotationFormat`.

        Shapes with the same ``group_id``, or without one the same label, are one object.
        """
        found: dict[object, _Found] = {}
        for frame, text in sorted(unpack(content, ".json", like, names, "LabelMe").items()):
            try:
                shapes = json.loads(text)["shapes"]
                for k, shape in enumerate(shapes[:_MAX_SHAPES]):
                    with within(f"frame {frame}: shapes[{k}]"):
                        _read_shape(shape, frame, found)
            except (ValueError, KeyError, TypeError, RecursionError) as error:
                if isinstance(error, InvalidValueError):
                    raise
                raise FileFormatError(
                    f"LabelMe frame {frame}", expected="shapes with label and points", found=repr(error)[:80]
                ) from error
        return _annotation(found, like)


LABELME = LabelMe()


def _frame_file(
    annotation: Annotation, regions: Mapping[int, list[Region]], frame: int, picture: str
) -> bytes:
    width, height = annotation.image_size
    shapes = [
        {
            "label": item.name,
            "points": to_corner(polygon),
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


def _read_shape(shape: dict[str, Any], frame: int, found: dict[object, _Found]) -> None:
    points = _outline(shape)
    label, group = str(shape["label"]), shape.get("group_id")
    told = _DESCRIPTION.search(str(shape.get("description") or ""))
    kind = told.group(1) if told else label.lower()
    motion: Motion | None = None
    if told:
        motion = REJECT if told.group(2) == REJECT else int(told.group(2))
    item = found.setdefault(label if group is None else int(group), _Found(label, known_kind(kind), motion))
    item.shapes.setdefault(frame, []).append(points)
    if (shape.get("flags") or {}).get("occluded"):
        item.occluded.add(frame)


def _outline(shape: dict[str, Any]) -> Polygon:
    form, points = shape.get("shape_type", "polygon"), shape["points"]
    if form == "rectangle" and len(points) == 2:
        (left, top), (right, bottom) = points
        return from_corner([(left, top), (right, top), (right, bottom), (left, bottom)], "points")
    if form not in ("polygon", "rectangle"):
        raise InvalidValueError("shape_type", expected="'polygon' or 'rectangle'", found=repr(form)[:40])
    return from_corner(points, "points")


def _annotation(found: Mapping[object, _Found], like: Annotation) -> Annotation:
    grouped = all(isinstance(key, int) and key >= 1 for key in found)
    motions = own_motions(item.motion for item in found.values())
    objects = []
    for number, ((key, item), motion) in enumerate(zip(found.items(), motions, strict=True), start=1):
        object_id = key if grouped and isinstance(key, int) else number
        keys = key_frames_of({frame: _key_frame(item, frame) for frame in item.shapes}, like.n_frames)
        objects.append(AnnotatedObject(object_id, item.name, item.kind, motion, keys))
    ordered = sorted(objects, key=lambda o: o.id)
    return replace(like, objects=tuple(ordered))


def _key_frame(item: _Found, frame: int) -> KeyFrame:
    visibility: Visibility = "occluded" if frame in item.occluded else "visible"
    return KeyFrame(frame, visibility, tuple(item.shapes[frame]))
