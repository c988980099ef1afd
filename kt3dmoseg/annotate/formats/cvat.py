"""CVAT for video 1.1: one XML file with a track per polygon of an object.

Written: the polygon of every frame, with ``keyframe="1"`` where a person drew it; id, name, motion and note
of the object as attributes, so that several tracks are put together again. Read: key frames only; a track
that starts later than frame 0 is outside before.

Kept: all objects, key frames and visibilities, polygons to 1/100 pixel. Not kept: marks; the number of
polygons of an object that is occluded somewhere unknown.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as ET

from kt3dmoseg.annotate.formats import AnnotationFormat
from kt3dmoseg.annotate.formats.foreign import (
    ForeignObject,
    assemble,
    check_frame,
    motion_from,
    unzip_only,
    with_centre_origin,
    with_corner_origin,
)
from kt3dmoseg.annotate.model import KINDS, AnnotatedObject, Annotation, Visibility, within
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.errors import FileFormatError, InvalidValueError

_WHAT = "CVAT XML"
_DECLARATION = '<?xml version="1.0" encoding="utf-8"?>\n'
# Characters that XML 1.0 cannot hold, not even escaped.
_UNWRITABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")
_UNKNOWN = "\ufffd"
_DIGITS = 9
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


def _parse(content: bytes, like: Annotation, names: Sequence[str] = ()) -> Annotation:
    """Read one XML file, or the zip file with one that CVAT offers."""
    root = _root(unzip_only(content, ".xml", _WHAT) if content.startswith(b"PK") else content)
    if root.tag != "annotations":
        raise FileFormatError(_WHAT, expected="<annotations>", found=f"<{root.tag[:40]}>")
    found: dict[int | str, ForeignObject] = {}
    for k, track in enumerate(root.findall("track")):
        with within(f"track[{k}]"):
            _read_track(track, k, like, found)
    return assemble(found, like, outside_between=False)


CVAT = AnnotationFormat(".xml", "application/xml", _dump, _parse)


def _root(content: bytes) -> ET.Element:
    """Parse XML that has no document type, hence no entities, internal or external."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    try:
        root: ET.Element = fromstring(content, forbid_dtd=True)
    except DefusedXmlException as error:
        found = "<!DOCTYPE"
        raise FileFormatError(_WHAT, expected="XML without a document type", found=found) from error
    except (ParseError, ValueError, LookupError, RecursionError) as error:
        raise FileFormatError(_WHAT, expected="XML", found=str(error)[:100]) from error
    return root


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


def _read_track(
    track: ET.Element, number: int, like: Annotation, found: dict[int | str, ForeignObject]
) -> None:
    shapes = track.findall("polygon")
    if not shapes:
        other = next((child.tag for child in track if child.tag != "attribute"), "nothing")
        raise InvalidValueError("shapes", expected="polygons", found=other[:40])
    attributes = {a.get("name", ""): a.text or "" for a in shapes[0].findall("attribute")}
    label, given = track.get("label", ""), attributes.get("object", "")
    key = int(given) if given.isdecimal() and len(given) <= _DIGITS else given or f"track {number}"
    if key not in found:
        name = attributes.get("name") or f"{label or 'object'} {len(found) + 1}"
        motion = motion_from(attributes.get("motion", ""))
        found[key] = ForeignObject(name, label.lower(), motion, attributes.get("note", ""))
    if min(_number(shape, "frame") for shape in shapes) > 0:
        found[key].visibility.setdefault(0, "outside")
    for shape in shapes:
        frame = _number(shape, "frame")
        check_frame(frame, like, _WHAT)
        if shape.get("keyframe", "1") == "1":
            _read_shape(shape, frame, found[key])


def _read_shape(shape: ET.Element, frame: int, item: ForeignObject) -> None:
    if shape.get("outside", "0") == "1":
        item.visibility.setdefault(frame, "outside")
        return
    visibility: Visibility = "occluded" if shape.get("occluded", "0") == "1" else "visible"
    text = shape.get("points", "")
    if text == _NOWHERE:
        item.add(frame, [], visibility)
        return
    with within(f"frame {frame}"):
        try:
            pairs = [tuple(float(v) for v in pair.split(",")) for pair in text.split(";")]
        except ValueError:
            raise InvalidValueError("points", expected="x,y;x,y;...", found=repr(text)[:60]) from None
        item.add(frame, [with_centre_origin(pairs, "points")], visibility)


def _number(shape: ET.Element, name: str) -> int:
    value = shape.get(name, "")
    if not value.isdecimal() or len(value) > _DIGITS:
        raise InvalidValueError(name, expected="a number", found=repr(value)[:40])
    return int(value)
