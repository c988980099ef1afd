"""COCO: one JSON file, a run-length encoded mask per object and frame.

Kept: each object's pixels in every frame, its id, name, kind, motion, note. Not kept: key frames (every
frame becomes one), what is hidden, marks. ``pycocotools`` reads it; files of polygons are read too.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from kt3dmoseg.annotate.formats import rle
from kt3dmoseg.annotate.formats.archive import frame_indices
from kt3dmoseg.annotate.formats.corner import from_corner
from kt3dmoseg.annotate.formats.instances import Instances
from kt3dmoseg.annotate.formats.masks import check_frame, check_shape, mask_of
from kt3dmoseg.annotate.formats.objects import own_motions
from kt3dmoseg.annotate.model import KINDS, MAX_OBJECTS, AnnotatedObject, Annotation
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.types import BoolArray


class Coco:
    """See the module."""

    suffix = ".json"
    media_type = "application/json"

    def dump(
        self, annotation: Annotation, regions: Mapping[int, list[Region]], names: Sequence[str] = ()
    ) -> bytes:
        """Write one JSON file; see `AnnotationFormat`."""
        width, height = annotation.image_size
        images = [
            {"id": k, "file_name": picture, "width": width, "height": height, "video": annotation.clip}
            for k, picture in enumerate(names or [f"{k:06d}.png" for k in range(annotation.n_frames)])
        ]
        entries = [
            entry
            for item in annotation.objects
            for frame, region in enumerate(regions[item.id])
            if region.visibility == "visible" and (entry := _entry(item, frame, region, annotation))
        ]
        for number, entry in enumerate(entries, start=1):
            entry["id"] = number
        categories = [{"id": k, "name": kind} for k, kind in enumerate(KINDS, start=1)]
        info = {"description": annotation.clip, "version": str(annotation.revision)}
        data = {
            "info": info,
            "licenses": [],
            "images": images,
            "categories": categories,
            "annotations": entries,
        }
        return (json.dumps(data, separators=(",", ":")) + "\n").encode()

    def parse(self, content: bytes, like: Annotation, names: Sequence[str] = ()) -> Annotation:
        """Read one JSON file; see `AnnotationFormat`.

        Images that are named as the clip's frames are those; others are its frames in the order of
        their ids. Annotations with the same ``track_id`` (else each alone) are one object.
        """
        try:
            data = json.loads(content)
            frames = _frames(data["images"], names)
            kinds = {int(c["id"]): str(c["name"]).lower() for c in data.get("categories", [])}
            entries = list(data["annotations"])
            return _annotation(entries, frames, kinds, like)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            if isinstance(error, (FileFormatError, InvalidValueError)):
                raise
            found = f"{type(error).__name__}: {error}"[:100]
            raise FileFormatError("COCO", expected="images, annotations, categories", found=found) from error


COCO = Coco()


def _frames(images: Sequence[Mapping[str, Any]], names: Sequence[str]) -> dict[int, int]:
    """Image id to frame."""
    ordered = sorted(images, key=lambda image: int(image["id"]))
    files = [str(image.get("file_name", "")) for image in ordered]
    stems = {PurePosixPath(name).stem for name in names}
    by_name = all(PurePosixPath(file).stem in stems for file in files)
    indices = frame_indices(files, names, "COCO") if by_name else range(len(files))
    return {int(image["id"]): k for image, k in zip(ordered, indices, strict=True)}


def _entry(
    item: AnnotatedObject, frame: int, region: Region, annotation: Annotation
) -> dict[str, Any] | None:
    mask = mask_of(region.polygons, annotation.image_size)
    if not mask.any():
        return None
    rows, columns = np.nonzero(mask)
    left, top = int(columns.min()), int(rows.min())
    box = [left, top, int(columns.max()) - left + 1, int(rows.max()) - top + 1]
    return {
        "image_id": frame,
        "category_id": KINDS.index(item.kind) + 1,
        "track_id": item.id,
        "segmentation": {"size": list(mask.shape), "counts": rle.encode(mask)},
        "area": int(mask.sum()),
        "bbox": box,
        "iscrowd": 0,
        "attributes": {"name": item.name, "motion": item.motion, "note": item.note},
    }


def _annotation(
    entries: list[dict[str, Any]], frames: Mapping[int, int], kinds: Mapping[int, str], like: Annotation
) -> Annotation:
    most = MAX_OBJECTS * like.n_frames
    if len(entries) > most:
        raise FileFormatError("COCO", expected=f"at most {most} annotations", found=str(len(entries)))
    instances = Instances(like)
    kept: dict[int, dict[str, Any]] = {}
    for number, entry in enumerate(entries):
        where = f"annotations[{number}]"
        frame = frames[int(entry["image_id"])]
        check_frame(frame, like, where)
        instance = int(entry["track_id"]) if "track_id" in entry else -1 - number
        kept.setdefault(instance, entry)
        instances.add(instance, frame, _mask(entry["segmentation"], like, where), where)
    about = {i: entry.get("attributes", {}) for i, entry in sorted(kept.items())}
    found = instances.annotation(
        dict(zip(about, own_motions(told.get("motion") for told in about.values()), strict=True)),
        kinds={i: kinds.get(int(e.get("category_id", 0)), "other") for i, e in kept.items()},
        names={i: str(told.get("name", "")) for i, told in about.items()},
    )
    ids = instances.numbers
    given = all(i >= 1 for i in ids)
    return replace(
        found,
        objects=tuple(
            replace(item, id=i if given else item.id, note=str(about[i].get("note", "")))
            for item, i in zip(found.objects, ids, strict=True)
        ),
    )


def _mask(segmentation: Any, like: Annotation, where: str) -> BoolArray:  # noqa: ANN401
    if isinstance(segmentation, list):
        polygons = [from_corner(zip(p[::2], p[1::2], strict=True), where) for p in segmentation]
        return mask_of([np.array(polygon) for polygon in polygons], like.image_size)
    height, width = (int(v) for v in segmentation["size"])
    check_shape((height, width), like, where)
    counts = segmentation["counts"]
    if isinstance(counts, list):
        return rle.from_runs([int(c) for c in counts], height, width, where)
    return rle.decode(str(counts), height, width, where)
