"""CVAT 1.1: one XML file with a track per polygon of an object (for video), or the shapes of each image.

Written: the polygon of every frame, with ``keyframe="1"`` where a person drew it; id, name, motion and note
of the object as attributes, so that several tracks are put together again. Read: key frames only; a track
that starts later than frame 0 is outside before; one that begins where another of its label ends, in the
same place, is its continuation. Of a project, the task of the clip's name.

Kept: all objects, key frames and visibilities, polygons to 1/100 pixel. Not kept: marks; the number of
polygons of an object that is occluded somewhere unknown.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from xml.etree import ElementTree as ET

import numpy as np

from kt3dmoseg.annotate.formats import AnnotationFormat
from kt3dmoseg.annotate.formats.foreign import (
    ForeignObject,
    Import,
    Key,
    Shape,
    ellipse,
    identity_in,
    kind_of,
    motion_from,
    strict,
    unzip_only,
    with_corner_origin,
)
from kt3dmoseg.annotate.formats.masks import decode_rle, mask_of, outlines_of
from kt3dmoseg.annotate.model import (
    KINDS,
    MAX_FRAMES,
    MAX_POINTS,
    AnnotatedObject,
    Annotation,
    Polygon,
    Visibility,
)
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.matching import number_in, several, stem

_WHAT = "CVAT XML"
_DECLARATION = '<?xml version="1.0" encoding="utf-8"?>\n'
# Characters that XML 1.0 cannot hold, not even escaped.
_UNWRITABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")
_UNKNOWN = "\ufffd"
_DIGITS = 9
_STEP = re.compile(r"step\s*=\s*(\d{1,6})")
# Elements of a file, and their nesting.
_MOST_NODES, _DEEPEST = 400_000, 12
# Overlap of two outlines from which on they are of one object, as intersection over union.
_SAME_PLACE = 0.3
_COARSE = 128
# CVAT needs points where an object is hidden; these mean "somewhere".
_NOWHERE = "0.00,0.00;1.00,0.00;0.00,1.00"


def _dump(annotation: Annotation, regions: Mapping[int, list[Region]], names: Sequence[str] = ()) -> bytes:
    root = ET.Element("annotations")
    _put(root, "version", "1.1")
    _put_task(_put(_put(root, "meta"), "task"), annotation)
    tracks = (
        (item, part)
        for item in annotation.objects
        for part in range(max(1, *(len(region.polygons) for region in regions[item.id])))
    )
    for number, (item, part) in enumerate(tracks):
        track = _put(root, "track", id=str(number), label=item.kind, source="manual")
        for frame, region in enumerate(regions[item.id]):
            _put_shape(track, item, frame, region, part)
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    return f"{_DECLARATION}{_UNWRITABLE.sub(_UNKNOWN, text)}\n".encode()


def _read(content: bytes, into: Import) -> None:
    """Read one XML file, or the zip file with one that CVAT offers."""
    xml = unzip_only(content, ".xml", _WHAT) if content.startswith(b"PK") else content
    file = _File()
    for node in _children(xml):
        if node.tag == "meta":
            file.tasks = [_Task.of(task) for task in node.iter() if task.tag in ("task", "job")]
        elif node.tag == "track":
            file.tracks.append(_Track.of(node, len(file.tracks), into))
        elif node.tag == "image":
            file.images.append(_Picture.of(node))
    task = file.choose(into)
    if file.tracks:
        _place_tracks(file.tracks, task, into)
    if file.images:
        _place_images(file.images, into)


CVAT = AnnotationFormat(".xml", "application/xml", _dump, strict(_read), _read)


class _Blocks(BytesIO):
    """Content in large blocks: of small ones, the parser reads a long attribute again with each."""

    def read(self, size: int | None = -1) -> bytes:
        return super().read(max(size or 0, 1 << 22))


def _children(content: bytes) -> Iterator[ET.Element]:
    """Give the elements right below <annotations>, one at a time; there are no entities, nor deep nesting."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, iterparse

    above: list[ET.Element] = []
    count = 0
    try:
        for event, node in iterparse(_Blocks(content), ("start", "end"), forbid_dtd=True):
            if event == "start":
                above.append(node)
                count += 1
                if len(above) == 1 and node.tag != "annotations":
                    raise FileFormatError(_WHAT, expected="<annotations>", found=f"<{node.tag[:40]}>")
                if len(above) > _DEEPEST or count > _MOST_NODES:
                    raise FileFormatError(_WHAT, expected="the elements of a task", found="very many")
                continue
            above.pop()
            if len(above) == 1:
                yield node
                above[0].clear()
    except DefusedXmlException as error:
        found = "<!DOCTYPE"
        raise FileFormatError(_WHAT, expected="XML without a document type", found=found) from error
    except (ParseError, LookupError, RecursionError) as error:
        raise FileFormatError(_WHAT, expected="XML", found=str(error)[:100]) from error


def _put(parent: ET.Element, tag: str, text: str | None = None, **attributes: str) -> ET.Element:
    child = ET.SubElement(parent, tag, attributes)
    child.text = text
    return child


def _put_task(task: ET.Element, annotation: Annotation) -> None:
    _put(task, "name", annotation.clip)
    _put(task, "size", str(annotation.n_frames))
    _put(task, "mode", "interpolation")
    labels = _put(task, "labels")
    for kind in KINDS:
        label = _put(labels, "label")
        _put(label, "name", kind)
        attributes = _put(label, "attributes")
        for name in ("object", "name", "motion", "note"):
            attribute = _put(attributes, "attribute")
            _put(attribute, "name", name)
            _put(attribute, "mutable", "False")
            _put(attribute, "input_type", "text")
    size = _put(task, "original_size")
    _put(size, "width", str(annotation.image_size[0]))
    _put(size, "height", str(annotation.image_size[1]))


def _put_shape(track: ET.Element, item: AnnotatedObject, frame: int, region: Region, part: int) -> None:
    drawn = part < len(region.polygons)
    hidden = region.visibility == "occluded"
    points = _NOWHERE
    if drawn:
        points = ";".join(f"{x:.2f},{y:.2f}" for x, y in with_corner_origin(region.polygons[part]))
    shape = _put(
        track,
        "polygon",
        frame=str(frame),
        outside=str(int(not drawn and not (hidden and part == 0))),
        occluded=str(int(hidden)),
        keyframe=str(int(region.key)),
        points=points,
        z_order="0",
    )
    values = {"object": str(item.id), "name": item.name, "motion": str(item.motion), "note": item.note}
    for name, value in values.items():
        _put(shape, "attribute", value, name=name)


@dataclass(frozen=True)
class _Task:
    """What a file says of a task: numbers and size of its pictures."""

    id: str
    name: str
    size: int | None
    first: int
    step: int
    pictures: tuple[int, int] | None

    @classmethod
    def of(cls, node: ET.Element) -> _Task:
        def number(path: str) -> int | None:
            text = (node.findtext(path) or "").strip()
            return int(text) if text.isdecimal() and len(text) <= _DIGITS else None

        first, last = number("start_frame") or 0, number("stop_frame")
        stated = _STEP.search(node.findtext("frame_filter") or "")
        step = max(1, int(stated[1])) if stated else 1
        size = number("size") if last is None else (last - first) // step + 1
        sides = number("original_size/width"), number("original_size/height")
        pictures = None if None in sides else (sides[0] or 0, sides[1] or 0)
        return cls(node.findtext("id") or "", node.findtext("name") or "", size, first, step, pictures)

    def index(self, number: int) -> int | None:
        """Index of a frame in the task, None when it is not in it."""
        index, rest = divmod(number - self.first, self.step)
        return index if not rest and 0 <= index < (self.size or MAX_FRAMES) else None


@dataclass(frozen=True)
class _Track:
    where: str
    task: str
    label: str
    shapes: list[tuple[int, ET.Element]]

    @classmethod
    def of(cls, node: ET.Element, number: int, into: Import) -> _Track:
        where, shapes = f"track[{number}]", []
        for shape in (child for child in node if child.tag != "attribute"):
            with into.skipping(f"{where}.{shape.tag}"):
                shapes.append((_number(shape, "frame"), shape))
        if not shapes:
            into.skip(f"{where}: expected polygons, found nothing")
        return cls(where, node.get("task_id", ""), node.get("label", ""), shapes)


@dataclass(frozen=True)
class _Picture:
    name: str
    task: str
    size: tuple[int, int] | None
    shapes: list[ET.Element]

    @classmethod
    def of(cls, node: ET.Element) -> _Picture:
        sides = node.get("width", ""), node.get("height", "")
        known = all(side.isdecimal() and len(side) <= _DIGITS for side in sides)
        size = (int(sides[0]), int(sides[1])) if known else None
        shapes = [child for child in node if child.tag not in ("tag", "attribute")]
        return cls(node.get("name") or node.get("id") or "", node.get("task_id", ""), size, shapes)


@dataclass
class _File:
    tasks: list[_Task] = field(default_factory=list)
    tracks: list[_Track] = field(default_factory=list)
    images: list[_Picture] = field(default_factory=list)

    def choose(self, into: Import) -> _Task | None:
        """Return the task of the clip, and leave out what is of others."""
        if len(self.tasks) < 2:
            return self.tasks[0] if self.tasks else None
        clip, names = into.like.clip, several(task.name for task in self.tasks)
        own = [task for task in self.tasks if stem(task.name).casefold() == clip.casefold()]
        if len(own) != 1:
            fix = "rename it, or export it alone"
            raise FileFormatError(_WHAT, expected=f"one task named {clip}", found=names, fix=fix)
        into.note(f"of the tasks {names}, {own[0].name} is read")
        if "" in {track.task for track in self.tracks} | {image.task for image in self.images}:
            into.doubts.append("the file has several tasks, and shapes that name none")
        self.tracks = [track for track in self.tracks if track.task in ("", own[0].id)]
        self.images = [image for image in self.images if image.task in ("", own[0].id)]
        return own[0]


def _place_tracks(tracks: Sequence[_Track], task: _Task | None, into: Import) -> None:
    frames = _frames(sorted({number for track in tracks for number, _ in track.shapes}), task, into)
    scale = into.scale(task.pictures if task else None, _WHAT)
    ends: dict[Key, int] = {}
    for number, track in enumerate(tracks):
        shapes = [(frames[n], shape) for n, shape in track.shapes if n in frames]
        read = [(frame, shape) for frame, shape in shapes if shape.get("keyframe", "1") == "1"]
        own: dict[int, tuple[Visibility | None, list[Polygon]]] = {}
        for frame, shape in sorted(read or shapes, key=lambda pair: pair[0]):
            with into.skipping(f"{track.where}: frame {frame}"):
                own[frame] = _shape(shape, scale, into)
        if not own:
            continue
        given = {a.get("name", ""): a.text or "" for a in shapes[0][1].findall("attribute")}
        key, _ = identity_in(given, ("object",))
        key = f"track {number}" if key is None else key
        if not given.get("object") and (before := _continued(track.label, own, ends, into)) is not None:
            into.note(f"{track.where} goes on where {before} ends: one object")
            key = before
        item = into.object(key, _about(track.label, given, len(into.found) + 1))
        if min(frame for frame, _ in shapes) > 0 and key not in ends:
            item.visibility.setdefault(0, "outside")
        for frame, (visibility, polygons) in own.items():
            if visibility is None:
                item.visibility.setdefault(frame, "outside")
            else:
                item.add(frame, polygons, visibility)
        ends[key] = max(own)
    into.note("ids are the tracks")


def _about(label: str, given: Mapping[str, str], number: int) -> ForeignObject:
    name = given.get("name") or f"{label or 'object'} {number}"
    return ForeignObject(name, label, motion_from(given.get("motion", "")), given.get("note", ""))


def _continued(
    label: str,
    own: Mapping[int, tuple[Visibility | None, list[Polygon]]],
    ends: Mapping[Key, int],
    into: Import,
) -> Key | None:
    """Find the object of that label that ends in the frame, and in the place, where this track begins."""
    start = min(own)
    for key, end in ends.items():
        item = into.found[key]
        ended = item.visibility.get(end) == "outside" and end == start and item.polygons
        if not ended or kind_of(item.kind) != kind_of(label):
            continue
        last = max(frame for frame in item.polygons)
        scale = _COARSE / max(into.like.image_size)
        left, right = (
            mask_of([scale * np.array(p) for p in polygons], (_COARSE, _COARSE))
            for polygons in (item.polygons[last], own[start][1])
        )
        if (left & right).sum() >= _SAME_PLACE * max(1, (left | right).sum()):
            del item.visibility[end]
            return key
    return None


def _frames(numbers: Sequence[int], task: _Task | None, into: Import) -> dict[int, int]:
    """Find the clip's frame of each frame number of CVAT; raises FileFormatError when none has one."""
    total, shift = into.like.n_frames, into.choices.shift
    if shift is not None:
        into.note(f"frames shifted by {shift}")
        found = {number: number + shift for number in numbers}
    elif task is None:
        found = {number: number for number in numbers}
    else:
        found = _frames_of_task(numbers, task, into)
    found = {number: frame for number, frame in found.items() if 0 <= frame < total}
    left = [number for number in numbers if number not in found]
    if left and not found:
        expected, fix = f"frames 0 to {total - 1} of the clip", f"a shift of {-left[0]} begins with frame 0"
        raise FileFormatError(_WHAT, expected=expected, found=f"frames {several(left)}", fix=fix)
    if left:
        into.doubts.append(f"frames {several(left)} are none of the clip's, 0 to {total - 1}")
    return found


def _frames_of_task(numbers: Sequence[int], task: _Task, into: Import) -> dict[int, int]:
    """Find the clip's frames of a task.

    CVAT numbers the pictures of the task's source from 0, also those that the task leaves out. The task is
    the clip when it has as many frames; else its source may be the clip, or what the clip was cut from.
    """
    total = into.like.n_frames
    if task.size == total:
        found = {number: index for number in numbers if (index := task.index(number)) is not None}
        if not found:  # some versions count within the task
            return {number: number for number in numbers}
        if task.first or task.step > 1:
            into.note(
                f"frame {task.first} of the task is frame 0 of the clip, every {task.step}. is the next"
            )
        return found
    last = task.first + ((task.size or total) - 1) * task.step
    if last < total:
        if task.size:
            into.note(f"the task has {task.size} of the clip's {total} frames, {task.first} to {last}")
        return {number: number for number in numbers}
    known = {number_in(name): k for k, name in enumerate(into.names)}
    into.doubts.append(
        f"the task has frames {task.first} to {last}, the clip {total} frames; they are taken as the "
        f"numbers in {into.names[0]} to {into.names[-1]}"
    )
    return {number: known[number] for number in numbers if number in known}


def _place_images(images: Sequence[_Picture], into: Import) -> None:
    frames = into.match([image.name for image in images], "CVAT images")
    for image in (image for image in images if image.name in frames):
        scale = into.scale(image.size, image.name)
        for k, shape in enumerate(image.shapes):
            with into.skipping(f"{image.name}: shape {k}"):
                visibility, polygons = _shape(shape, scale, into)
                given = {a.get("name", ""): a.text or "" for a in shape.findall("attribute")}
                key, source = identity_in(given)
                if key is None:
                    key, source = identity_in(shape.attrib, ("group_id",))
                if key is not None:
                    into.note(f"ids come from {source}")
                label = shape.get("label", "")
                about = ForeignObject(given.get("name", ""), label, motion_from(given.get("motion", "")))
                into.add(Shape(frames[image.name], key, label, polygons, about, visibility or "visible"))
    into.list_frames(frames.values())


def _shape(
    shape: ET.Element, scale: tuple[float, float], into: Import
) -> tuple[Visibility | None, list[Polygon]]:
    """Visibility and outlines of a shape; None where it is outside."""
    if shape.get("outside", "0").lower() in ("1", "true"):
        return None, []
    if shape.tag not in _OUTLINES:
        raise InvalidValueError("", expected="polygons, masks or ellipses", found=f"a {shape.tag[:40]}")
    visibility: Visibility = "occluded" if shape.get("occluded", "0").lower() in ("1", "true") else "visible"
    text = shape.get("points", "")
    if text == _NOWHERE:
        return visibility, []
    return visibility, _OUTLINES[shape.tag](shape, scale, into)


def _polygon(shape: ET.Element, scale: tuple[float, float], into: Import) -> list[Polygon]:
    text = shape.get("points", "")
    if (points := text.count(";") + 1) > MAX_POINTS:
        raise InvalidValueError("points", expected=f"at most {MAX_POINTS}", found=str(points))
    try:
        pairs = [tuple(float(v) for v in pair.split(",")) for pair in text.split(";")]
    except ValueError:
        raise InvalidValueError("points", expected="x,y;x,y;...", found=repr(text)[:60]) from None
    return [into.outline(pairs, scale)]


def _ellipse(shape: ET.Element, scale: tuple[float, float], into: Import) -> list[Polygon]:
    x, y, width, height, turn = (_real(shape, name) for name in ("cx", "cy", "rx", "ry", "rotation"))
    return [into.outline(ellipse(x, y, width, height, turn), scale)]


def _mask(shape: ET.Element, scale: tuple[float, float], into: Import) -> list[Polygon]:
    """Run lengths, row by row, in a box."""
    left, top, width, height = (_number(shape, name) for name in ("left", "top", "width", "height"))
    columns, rows = into.like.image_size
    if scale != (1.0, 1.0) or left + width > columns or top + height > rows:
        expected, found = f"a mask in pictures of {columns}x{rows}", f"{width}x{height} at {left}, {top}"
        raise InvalidValueError("mask", expected=expected, found=found)
    runs = [int(run) for run in shape.get("rle", "").split(",") if len(run) <= _DIGITS]
    return outlines_of(decode_rle(runs, width, height, "rle").T, into, (left, top))


_OUTLINES = {"polygon": _polygon, "ellipse": _ellipse, "mask": _mask}


def _real(shape: ET.Element, name: str) -> float:
    try:
        return float(shape.get(name, "0"))
    except ValueError:
        raise InvalidValueError(name, expected="a number", found=repr(shape.get(name))[:40]) from None


def _number(shape: ET.Element, name: str) -> int:
    value = shape.get(name, "")
    if not value.isdecimal() or len(value) > _DIGITS:
        raise InvalidValueError(name, expected="a number", found=repr(value)[:40])
    return int(value)
