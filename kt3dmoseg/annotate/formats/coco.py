"""COCO: one JSON file, a run-length encoded mask per object and frame.

Kept: each object's pixels in every frame, its id, name, kind, motion, note. Not kept: key frames (every
frame becomes one), what is hidden, marks. ``pycocotools`` reads it; files of polygons are read too.
Reading, an image is the frame of its file name, else of its number. An object is what has one ``track_id``,
in the annotation or its attributes; without ids, what has one category, once an image. Boxes are no outlines.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from kt3dmoseg.annotate.formats import AnnotationFormat
from kt3dmoseg.annotate.formats.foreign import (
    ForeignObject,
    Import,
    Shape,
    check_shape,
    identity_in,
    motion_from,
    strict,
)
from kt3dmoseg.annotate.formats.masks import decode_rle, encode_rle, mask_of, outlines_of
from kt3dmoseg.annotate.model import KINDS, MAX_OBJECTS, AnnotatedObject, Annotation, Polygon, parse_document
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.types import BoolArray

_IDENTITIES = ("track_id", "instance_id", "object_id")
# A mask may be of a larger picture, by this factor.
_MOST_PIXELS = 16


def _dump(annotation: Annotation, regions: Mapping[int, list[Region]], names: Sequence[str] = ()) -> bytes:
    width, height = annotation.image_size
    images = [
        {"id": k, "file_name": picture, "width": width, "height": height, "annotated": True}
        for k, picture in enumerate(names or [f"{k:06d}.png" for k in range(annotation.n_frames)])
    ]
    masks = [
        (item, frame, mask)
        for item in annotation.objects
        for frame, region in enumerate(regions[item.id])
        if region.visibility == "visible" and (mask := mask_of(region.polygons, annotation.image_size)).any()
    ]
    data = {
        "info": {"description": annotation.clip, "version": str(annotation.revision)},
        "licenses": [],
        "images": images,
        "categories": [{"id": k, "name": kind} for k, kind in enumerate(KINDS, start=1)],
        "annotations": [
            _mask_to_json(item, frame, mask) | {"id": number}
            for number, (item, frame, mask) in enumerate(masks, start=1)
        ],
    }
    return (json.dumps(data, separators=(",", ":")) + "\n").encode()


def _read(content: bytes, into: Import) -> None:
    data = parse_document(content, "COCO")
    try:
        images = _images(data)
        kinds = {int(c["id"]): str(c["name"]) for c in data.get("categories", [])}
        shapes = list(data["annotations"])
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        problem = f"{type(error).__name__}: {error}"[:100]
        raise FileFormatError("COCO", expected="images, annotations, categories", found=problem) from error
    most = MAX_OBJECTS * into.like.n_frames
    if len(shapes) > most:
        raise FileFormatError("COCO", expected=f"at most {most} annotations", found=str(len(shapes)))
    frames = into.match([image.file for image in images.values()], "COCO images")
    for number, shape in enumerate(shapes):
        with into.skipping(f"annotations[{number}]"):
            image = images.get(int(shape["image_id"]))
            if image is None:
                raise InvalidValueError("image_id", expected="of images", found=str(shape["image_id"])[:40])
            if image.file in frames:
                _read_shape(shape, frames[image.file], image, kinds, into)
    surely = {image.file for image in images.values() if image.annotated}
    into.annotated |= {frame for file, frame in frames.items() if file in surely}
    into.list_frames([frame for file, frame in frames.items() if file not in surely])


COCO = AnnotationFormat(".json", "application/json", _dump, strict(_read), _read)


@dataclass(frozen=True)
class _Image:
    file: str
    size: tuple[int, int] | None
    annotated: bool


def _images(data: Mapping[str, Any]) -> dict[int, _Image]:
    """Images by id; one without a file name is the frame of its number, else of its id.

    Of several videos in one file, each is a folder.
    """
    videos = {video["id"]: str(video["name"]) for video in data.get("videos", [])}
    images: dict[int, _Image] = {}
    for image in data["images"]:
        number = int(image["id"])
        file = str(image.get("file_name") or image.get("frame_id", number))
        if len(videos) > 1:
            file = f"{videos[image['video_id']]}/{file}"
        sides = image.get("width"), image.get("height")
        size = None if None in sides else (int(sides[0]), int(sides[1]))
        images[number] = _Image(file, size, image.get("annotated") is True)
    if len({image.file for image in images.values()}) < len(data["images"]):
        raise ValueError("an image is listed twice")
    return images


def _mask_to_json(item: AnnotatedObject, frame: int, mask: BoolArray) -> dict[str, Any]:
    return {
        "image_id": frame,
        "category_id": KINDS.index(item.kind) + 1,
        "track_id": item.id,
        "segmentation": {"size": list(mask.shape), "counts": encode_rle(mask)},
        "area": int(mask.sum()),
        "bbox": list(cv2.boundingRect(mask.view(np.uint8))),
        "iscrowd": 0,
        "attributes": {"name": item.name, "motion": item.motion, "note": item.note},
    }


def _read_shape(
    shape: Mapping[str, Any], frame: int, image: _Image, kinds: Mapping[int, str], into: Import
) -> None:
    attributes = shape.get("attributes") or {}
    key, source = identity_in(shape, _IDENTITIES)
    if key is None:
        key, source = identity_in(attributes)
        source = f"attributes.{source}"
    if key is not None:
        into.note(f"ids come from {source}")
    kind = kinds.get(int(shape.get("category_id", 0)), "other")
    name, note = (str(attributes.get(field) or "") for field in ("name", "note"))
    about = ForeignObject(name, kind, motion_from(str(attributes.get("motion"))), note)
    polygons = _outlines(shape, image, into)
    if polygons:
        into.add(Shape(frame, key, kind, polygons, about))
    into.annotated.add(frame)


def _outlines(shape: Mapping[str, Any], image: _Image, into: Import) -> list[Polygon]:
    found = shape.get("segmentation")
    if not found:
        expected = "polygons or run lengths"
        raise InvalidValueError("segmentation", expected=expected, found="a box only" * ("bbox" in shape))
    scale = into.scale(image.size, image.file)
    if isinstance(found, list):
        return [into.outline(zip(p[::2], p[1::2], strict=True), scale) for p in found]
    height, width = (int(side) for side in found["size"])
    if (width, height) != image.size:
        check_shape((height, width), into.like, "segmentation.size")
    columns, rows = into.like.image_size
    if width * height > _MOST_PIXELS * columns * rows:
        raise InvalidValueError("segmentation.size", expected="a smaller mask", found=f"{width}x{height}")
    counts = found["counts"]
    runs = [int(run) for run in counts] if isinstance(counts, list) else str(counts)
    into.count_pixels(width * height // 8)  # decoding is cheap
    mask = decode_rle(runs, height, width, "segmentation")
    if (width, height) != (columns, rows):
        resized = cv2.resize(mask.view(np.uint8), (columns, rows), interpolation=cv2.INTER_NEAREST_EXACT)
        mask = resized.astype(np.bool_)
    return outlines_of(mask, into)
