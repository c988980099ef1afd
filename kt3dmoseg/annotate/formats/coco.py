"""COCO: one JSON file, a run-length encoded mask per object and frame.

Kept: each object's pixels in every frame, its id, name, kind, motion, note. Not kept: key frames (every
frame becomes one), what is hidden, marks. ``pycocotools`` reads it; files of polygons are read too.
Reading, images that are named as the clip's frames are those; others are its frames in the order of their
ids. Annotations with the same ``track_id`` (else each alone) are one object.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

import cv2
import numpy as np

from kt3dmoseg.annotate.formats import AnnotationFormat
from kt3dmoseg.annotate.formats.foreign import (
    ForeignObject,
    assemble,
    check_frame,
    check_shape,
    frame_indices,
    with_centre_origin,
)
from kt3dmoseg.annotate.formats.masks import add_mask, decode_rle, encode_rle, mask_of
from kt3dmoseg.annotate.model import KINDS, MAX_OBJECTS, AnnotatedObject, Annotation
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.types import BoolArray


def _dump(annotation: Annotation, regions: Mapping[int, list[Region]], names: Sequence[str] = ()) -> bytes:
    width, height = annotation.image_size
    images = [
        {"id": k, "file_name": picture, "width": width, "height": height, "video": annotation.clip}
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


def _parse(content: bytes, like: Annotation, names: Sequence[str] = ()) -> Annotation:
    try:
        data = json.loads(content)
        frames = _frames(data["images"], names)
        kinds = {int(c["id"]): str(c["name"]).lower() for c in data.get("categories", [])}
        masks = list(data["annotations"])
        most = MAX_OBJECTS * like.n_frames
        if len(masks) > most:
            raise FileFormatError("COCO", expected=f"at most {most} annotations", found=str(len(masks)))
        found: dict[int, ForeignObject] = {}
        for number, mask in enumerate(masks):
            _read_mask(mask, number, frames, kinds, like, found)
    except (FileFormatError, InvalidValueError):
        raise
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        problem = f"{type(error).__name__}: {error}"[:100]
        raise FileFormatError("COCO", expected="images, annotations, categories", found=problem) from error
    return assemble(dict(sorted(found.items())), like)


COCO = AnnotationFormat(".json", "application/json", _dump, _parse)


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


def _frames(images: Sequence[Mapping[str, Any]], names: Sequence[str]) -> dict[int, int]:
    """Image id to frame."""
    ordered = sorted(images, key=lambda image: int(image["id"]))
    files = [str(image.get("file_name", "")) for image in ordered]
    stems = {PurePosixPath(name).stem for name in names}
    by_name = all(PurePosixPath(file).stem in stems for file in files)
    indices = frame_indices(files, names, "COCO") if by_name else range(len(files))
    return {int(image["id"]): k for image, k in zip(ordered, indices, strict=True)}


def _read_mask(
    mask: dict[str, Any],
    number: int,
    frames: Mapping[int, int],
    kinds: Mapping[int, str],
    like: Annotation,
    found: dict[int, ForeignObject],
) -> None:
    where = f"annotations[{number}]"
    frame = frames[int(mask["image_id"])]
    check_frame(frame, like, where)
    instance = int(mask["track_id"]) if "track_id" in mask else -1 - number
    known = instance in found
    item = add_mask(found, instance, frame, _pixels(mask["segmentation"], like, where), where)
    if item is not None and not known:
        about = mask.get("attributes", {})
        item.kind = kinds.get(int(mask.get("category_id", 0)), "other")
        item.name, item.note = str(about.get("name", "")), str(about.get("note", ""))
        item.motion = about.get("motion")


def _pixels(segmentation: Any, like: Annotation, where: str) -> BoolArray:  # noqa: ANN401
    if isinstance(segmentation, list):
        polygons = [with_centre_origin(zip(p[::2], p[1::2], strict=True), where) for p in segmentation]
        return mask_of([np.array(polygon) for polygon in polygons], like.image_size)
    height, width = (int(v) for v in segmentation["size"])
    check_shape((height, width), like, where)
    counts = segmentation["counts"]
    runs = [int(count) for count in counts] if isinstance(counts, list) else str(counts)
    return decode_rle(runs, height, width, where)
