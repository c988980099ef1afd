"""COCO: one JSON file, also zipped as CVAT does, with a run-length encoded mask per object and frame.

``pycocotools`` reads it; files of polygons are read too. Reading, an image is the frame of its file name,
else of its number. An object is what has one ``track_id``, in the annotation or its attributes; without ids,
what has one category, once an image. Boxes are no outlines.
"""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from kt3dmoseg.annotate.formats import foreign
from kt3dmoseg.annotate.formats.masks import decode_rle, encode_rle, mask_of, outlines_of
from kt3dmoseg.annotate.model import KINDS, MAX_OBJECTS, REJECT, Annotation, Polygon, parse_document
from kt3dmoseg.errors import FileFormatError, InvalidValueError


def _write(annotation: Annotation, regions: foreign.Regions, names: Sequence[str]) -> bytes:
    width, height = annotation.image_size
    shapes: list[dict[str, Any]] = []
    for item in annotation.objects:
        for frame, region in enumerate(regions[item.id]):
            mask = mask_of(region.polygons, annotation.image_size)
            if region.visibility == "visible" and mask.any():
                shape = {
                    "image_id": frame,
                    "category_id": KINDS.index(item.kind) + 1,
                    "track_id": item.id,
                    "segmentation": {"size": [height, width], "counts": encode_rle(mask)},
                    "area": int(mask.sum()),
                    "bbox": list(cv2.boundingRect(mask.view(np.uint8))),
                    "iscrowd": 0,
                    "attributes": {"name": item.name, "motion": item.motion, "note": item.note},
                    "id": len(shapes) + 1,
                }
                shapes.append(shape)
    data = {
        "info": {"description": annotation.clip, "version": str(annotation.revision)},
        "licenses": [],
        "images": [
            {"id": k, "file_name": picture, "width": width, "height": height, "annotated": True}
            for k, picture in enumerate(names)
        ],
        "categories": [{"id": k, "name": kind} for k, kind in enumerate(KINDS, start=1)],
        "annotations": shapes,
    }
    return (json.dumps(data, separators=(",", ":")) + "\n").encode()


def _read(content: bytes, into: foreign.Import) -> None:
    data = parse_document(foreign.unpacked(content, ".json", "COCO"), "COCO")
    if not isinstance(data, dict):
        raise FileFormatError("COCO", expected="images, annotations, categories", found=f"{data!r:.40}")
    try:
        into.count("images", len(data["images"]), 100 * MAX_OBJECTS)
        names, ids = _files(data), [_identity(image, "id") for image in data["images"]]
        images, files = (dict(zip(ids, values, strict=True)) for values in (data["images"], names))
        kinds = {_identity(c, "id"): str(c["name"]) for c in data.get("categories") or []}
        shapes = list(data["annotations"])
        crowds = {bool(shape.get("iscrowd")) for shape in shapes} == {True, False}
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        problem = (f"no {error}" if isinstance(error, KeyError) else f"{type(error).__name__}: {error}")[:100]
        raise FileFormatError("COCO", expected="images, annotations, categories", found=problem) from error
    if twice := [value for given in (ids, names) for value, number in Counter(given).items() if number > 1]:
        raise FileFormatError("COCO images", expected="each once", found=f"{twice[0]!r} twice")
    into.count("annotations", len(shapes), MAX_OBJECTS * into.like.n_frames)
    frames = into.match(files.values(), "COCO images")
    for number, shape in enumerate(shapes):
        with into.skipping(f"annotations[{number}]"):
            identity = _identity(shape, "image_id")
            if identity not in images:
                raise InvalidValueError("image_id", expected="of images", found=str(identity)[:40])
            if (file := files[identity]) in frames:
                label = kinds.get(_identity({"category_id": 0} | shape, "category_id"), "other")
                given = {key: shape[key] for key in foreign.OF_TRACKS if shape.get(key) is not None}
                fields = (shape.get("attributes") or {}) | given
                into.reading(frames[file], label, fields)
                polygons = _outlines(shape, images[identity], file, into)
                if crowds and shape.get("iscrowd") and foreign.identity_in(fields)[0] is None:
                    into.note("crowds are rejected: no trajectory in them is labelled")
                    label, fields = f"crowd of {label}", fields | {"motion": REJECT}
                hidden = fields.get("occluded") is True
                into.add(
                    frames[file], label, polygons, fields, visibility="occluded" if hidden else "visible"
                )
    surely = {files[key] for key, image in images.items() if image.get("annotated") is True}
    into.annotated |= {frame for file, frame in frames.items() if file in surely}
    into.list_frames([frame for file, frame in frames.items() if file not in surely])


COCO = foreign.AnnotationFormat(".json", "application/json", _write, _read)


def _identity(values: Mapping[str, Any], name: str) -> foreign.Key:
    key, _ = foreign.identity_in(values, (name,))
    if key is None:
        raise KeyError(name)
    return key


def _files(data: Mapping[str, Any]) -> list[str]:
    """Names of the images; one without a name is the frame of its number, else of its id.

    Of several videos in one file, each is a folder.
    """
    videos = {video["id"]: str(video["name"]) for video in data.get("videos", [])}
    files = []
    for image in data["images"]:
        file = str(image.get("file_name") or image.get("frame_id", image["id"]))
        files.append(f"{videos[image['video_id']]}/{file}" if len(videos) > 1 else file)
    return files


def _outlines(
    shape: Mapping[str, Any], image: Mapping[str, Any], file: str, into: foreign.Import
) -> list[Polygon]:
    found = shape.get("segmentation")
    if not found:
        expected = "polygons or run lengths"
        raise InvalidValueError("segmentation", expected=expected, found="a box only" * ("bbox" in shape))
    if isinstance(found, list):
        scale = into.scale((image.get("width"), image.get("height")), file)
        if any(not isinstance(p, list) or len(p) % 2 or list in map(type, p) for p in found):
            expected = "[[x, y, x, y, ...], ...]"
            raise InvalidValueError("segmentation", expected=expected, found=f"{found!r:.40}")
        return [into.outline(zip(p[::2], p[1::2], strict=True), scale) for p in found]
    height, width = (int(side) for side in found["size"])
    into.check_shape(height, width, "segmentation.size")
    counts = found["counts"]
    runs = [int(run) for run in counts] if isinstance(counts, list) else str(counts)
    into.count("pixels in masks", width * height // 8)  # decoding is cheap
    return outlines_of(into.fit(decode_rle(runs, height, width, "segmentation"), "segmentation"), into)
