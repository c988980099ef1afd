"""KITTI MOTS: an id per pixel, ``1000 * class + instance``, as 16-bit PNGs in a zip or as a text file.

Classes are 1 = vehicles and 2 = people, 10 = ignore (id 10000); 3 is used here for all else. The instance is
the motion. A text line is ``frame id class height width rle``; frames count from 0.

Kept: which pixels have which motion in which frame, and the class. Not kept: names, objects of one class that
share a motion, key frames, what is hidden, marks. Motions above 999 cannot be written. Ids whose instance
numbers repeat in another class are different objects in MOTS: they come back as motions of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import numpy.typing as npt

from kt3dmoseg.annotate.formats import rle
from kt3dmoseg.annotate.formats.instances import Instances, from_images
from kt3dmoseg.annotate.formats.masks import check_frame, check_shape, label_image
from kt3dmoseg.annotate.model import MAX_OBJECTS, REJECT, AnnotatedObject, Annotation, Motion
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import zip_bytes
from kt3dmoseg.types import BoolArray

_IGNORE = 10_000
_STEP = 1000
_LARGEST = (1 << 16) - 1
_CLASS = {"pedestrian": 2, "cyclist": 2, "animal": 3, "other": 3}
_KIND = {1: "car", 2: "pedestrian", 3: "other"}


class MotsPng:
    """A zip of 16-bit PNGs, ``000000.png`` on; see the module."""

    suffix = ".zip"
    media_type = "application/zip"

    def dump(
        self, annotation: Annotation, regions: Mapping[int, list[Region]], names: Sequence[str] = ()
    ) -> bytes:
        """Write one PNG per frame; see `AnnotationFormat`."""
        del names
        images = (image.astype(np.uint16) for image in _images(annotation, regions))
        return zip_bytes(
            {f"{k:06d}.png": cv2.imencode(".png", image)[1].tobytes() for k, image in enumerate(images)}
        )

    def parse(self, content: bytes, like: Annotation, names: Sequence[str] = ()) -> Annotation:
        """Read a zip of PNGs; see `AnnotationFormat`."""
        return _annotation(from_images(content, like, names, "MOTS masks", bits=16, largest=_LARGEST))


class MotsText:
    """A text file of run-length encoded masks; see the module."""

    suffix = ".txt"
    media_type = "text/plain"

    def dump(
        self, annotation: Annotation, regions: Mapping[int, list[Region]], names: Sequence[str] = ()
    ) -> bytes:
        """Write one line per object and frame; see `AnnotationFormat`."""
        del names
        width, height = annotation.image_size
        lines = [
            f"{frame} {value} {value // _STEP} {height} {width} {rle.encode(image == value)}\n"
            for frame, image in enumerate(_images(annotation, regions))
            for value in np.unique(image[image > 0]).tolist()
        ]
        return "".join(lines).encode()

    def parse(self, content: bytes, like: Annotation, names: Sequence[str] = ()) -> Annotation:
        """Read a text file; see `AnnotationFormat`."""
        del names
        found = Instances(like)
        lines = content.decode("ascii", "replace").splitlines()
        most = MAX_OBJECTS * like.n_frames
        if len(lines) > most:
            raise FileFormatError("MOTS text", expected=f"at most {most} lines", found=str(len(lines)))
        for number, line in enumerate(lines, start=1):
            if line.strip():
                frame, value, mask = _line(line, like, f"line {number}")
                found.add(value, frame, mask, "MOTS text")
        return _annotation(found)


MOTS_PNG = MotsPng()
MOTS_TXT = MotsText()


def _images(annotation: Annotation, regions: Mapping[int, list[Region]]) -> list[npt.NDArray[np.int64]]:
    values = {item.id: _value(item) for item in annotation.objects}
    return [label_image(annotation, regions, frame, values) for frame in range(annotation.n_frames)]


def _value(item: AnnotatedObject) -> int:
    if item.motion == REJECT:
        return _IGNORE
    if item.motion >= _STEP:
        raise InvalidValueError("motion", expected=f"below {_STEP}, as MOTS can hold", found=str(item.motion))
    return _STEP * _CLASS.get(item.kind, 1) + item.motion if item.motion else 0


def _line(line: str, like: Annotation, where: str) -> tuple[int, int, BoolArray]:
    try:
        frame, value, _, height, width, text = line.split()
        numbers = [int(frame), int(value), int(height), int(width)]
        if min(numbers) < 0:
            raise ValueError
    except ValueError:
        expected = "frame id class height width rle"
        raise FileFormatError(where, expected=expected, found=repr(line[:60])) from None
    check_frame(numbers[0], like, where)
    check_shape((numbers[2], numbers[3]), like, where)
    return numbers[0], numbers[1], rle.decode(text, numbers[2], numbers[3], where)


def _annotation(found: Instances) -> Annotation:
    values = found.numbers
    instances = [value % _STEP for value in values if value // _STEP != _IGNORE // _STEP]
    unique = len(set(instances)) == len(instances) and min(instances, default=1) > 0
    motions: dict[int, Motion] = {}
    for value in values:
        if value // _STEP == _IGNORE // _STEP:
            motions[value] = REJECT
        else:
            motions[value] = value % _STEP if unique else len(motions) + 1
    kinds = {value: _KIND.get(value // _STEP, "other") for value in values}
    names = {value: "rejected" if motions[value] == REJECT else f"{kinds[value]} {value}" for value in values}
    return found.annotation(motions, kinds=kinds, names=names)
