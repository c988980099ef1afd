"""CVAT for video 1.1: one XML file with a track per polygon of an object.

Written: the polygon of every frame, with ``keyframe="1"`` where a person drew it; id, name, motion and note
of the object as attributes, so that several tracks are put together again. Read: key frames only; a track
that starts later than frame 0 is outside before.

Kept: all objects, key frames and visibilities, polygons to 1/100 pixel. Not kept: marks; the number of
polygons of an object that is occluded at an unknown place.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from xml.etree import ElementTree as ET

from kt3dmoseg.annotate.formats import safe_xml
from kt3dmoseg.annotate.formats.archive import only_entry
from kt3dmoseg.annotate.formats.corner import from_corner, to_corner
from kt3dmoseg.annotate.formats.masks import check_frame
from kt3dmoseg.annotate.formats.objects import known_kind, own_motions
from kt3dmoseg.annotate.model import (
    KINDS,
    REJECT,
    AnnotatedObject,
    Annotation,
    KeyFrame,
    Motion,
    Polygon,
    Visibility,
    within,
)
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.types import FloatArray

_WHAT = "CVAT XML"
_DECLARATION = '<?xml version="1.0" encoding="utf-8"?>\n'
# Characters that XML 1.0 cannot hold, not even escaped.
_UNWRITABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")
_UNKNOWN = "\ufffd"
# CVAT needs points where an object is hidden; these say "somewhere".
_NOWHERE = "0.00,0.00;1.00,0.00;0.00,1.00"


@dataclass
class _Found:
    """One object put together from its tracks."""

    attributes: dict[str, str]
    label: str
    keys: dict[int, Visibility] = field(default_factory=dict)
    polygons: dict[int, list[Polygon]] = field(default_factory=lambda: defaultdict(list))


class Cvat:
    """See the module."""

    suffix = ".xml"
    media_type = "application/xml"

    def dump(
        self, annotation: Annotation, regions: Mapping[int, list[Region]], names: Sequence[str] = ()
    ) -> bytes:
        """Write one XML file; see `AnnotationFormat`."""
        del names
        root = ET.Element("annotations")
        ET.SubElement(root, "version").text = "1.1"
        _meta(root, annotation)
        number = 0
        for item in annotation.objects:
            parts = max(1, *(len(region.polygons) for region in regions[item.id]))
            for part in range(parts):
                track = {"id": str(number), "label": item.kind, "source": "manual"}
                _track(ET.SubElement(root, "track", track), item, regions[item.id], part)
                number += 1
        ET.indent(root)
        text = ET.tostring(root, encoding="unicode")
        return f"{_DECLARATION}{_UNWRITABLE.sub(_UNKNOWN, text)}\n".encode()

    def parse(self, content: bytes, like: Annotation, names: Sequence[str] = ()) -> Annotation:
        """Read one XML file, or the zip file with one that CVAT offers; see `AnnotationFormat`."""
        del names
        text = only_entry(content, ".xml", _WHAT) if content.startswith(b"PK") else content
        root = safe_xml.parse(text, _WHAT)
        if root.tag != "annotations":
            raise FileFormatError(_WHAT, expected="<annotations>", found=f"<{root.tag[:40]}>")
        found: dict[str, _Found] = {}
        for k, track in enumerate(root.findall("track")):
            with within(f"track[{k}]"):
                _read_track(track, k, like, found)
        return replace(like, objects=_objects(found))


CVAT = Cvat()


def _meta(root: ET.Element, annotation: Annotation) -> None:
    task = ET.SubElement(ET.SubElement(root, "meta"), "task")
    ET.SubElement(task, "name").text = annotation.clip
    ET.SubElement(task, "size").text = str(annotation.n_frames)
    ET.SubElement(task, "mode").text = "interpolation"
    labels = ET.SubElement(task, "labels")
    for kind in KINDS:
        label = ET.SubElement(labels, "label")
        ET.SubElement(label, "name").text = kind
        attributes = ET.SubElement(label, "attributes")
        for name in ("object", "name", "motion", "note"):
            attribute = ET.SubElement(attributes, "attribute")
            ET.SubElement(attribute, "name").text = name
            ET.SubElement(attribute, "mutable").text = "False"
            ET.SubElement(attribute, "input_type").text = "text"
    size = ET.SubElement(task, "original_size")
    ET.SubElement(size, "width").text, ET.SubElement(size, "height").text = map(str, annotation.image_size)


def _track(track: ET.Element, item: AnnotatedObject, regions: list[Region], part: int) -> None:
    points = _NOWHERE
    for frame, region in enumerate(regions):
        drawn = part < len(region.polygons)
        somewhere = region.visibility == "occluded" and part == 0
        if drawn:
            points = _points(region.polygons[part])
        shape = ET.SubElement(
            track,
            "polygon",
            {
                "frame": str(frame),
                "outside": str(int(not drawn and not somewhere)),
                "occluded": str(int(region.visibility == "occluded")),
                "keyframe": str(int(region.key)),
                "points": points if drawn else _NOWHERE,
                "z_order": "0",
            },
        )
        values = {"object": str(item.id), "name": item.name, "motion": str(item.motion), "note": item.note}
        for name, value in values.items():
            ET.SubElement(shape, "attribute", {"name": name}).text = value


def _points(polygon: FloatArray) -> str:
    return ";".join(f"{x:.2f},{y:.2f}" for x, y in to_corner(polygon))


def _read_track(track: ET.Element, number: int, like: Annotation, found: dict[str, _Found]) -> None:
    shapes = track.findall("polygon")
    if not shapes:
        other = next((child.tag for child in track if child.tag != "attribute"), "nothing")
        raise InvalidValueError("shapes", expected="polygons", found=other[:40])
    attributes = {a.get("name", ""): a.text or "" for a in shapes[0].findall("attribute")}
    item = found.setdefault(
        attributes.get("object") or f"track {number}", _Found(attributes, track.get("label", ""))
    )
    first = min(_number(shape, "frame") for shape in shapes)
    if first > 0:
        item.keys.setdefault(0, "outside")
    for shape in shapes:
        frame = _number(shape, "frame")
        check_frame(frame, like, _WHAT)
        if shape.get("keyframe", "1") == "1":
            _read_shape(shape, frame, item)


def _read_shape(shape: ET.Element, frame: int, item: _Found) -> None:
    if shape.get("outside", "0") == "1":
        item.keys.setdefault(frame, "outside")
        return
    item.keys[frame] = "occluded" if shape.get("occluded", "0") == "1" else "visible"
    if shape.get("points", "") == _NOWHERE:
        return
    with within(f"frame {frame}"):
        try:
            pairs = [tuple(float(v) for v in pair.split(",")) for pair in shape.get("points", "").split(";")]
        except ValueError:
            found = repr(shape.get("points"))[:60]
            raise InvalidValueError("points", expected="x,y;x,y;...", found=found) from None
        item.polygons[frame].append(from_corner(pairs, "points"))


def _objects(found: Mapping[str, _Found]) -> tuple[AnnotatedObject, ...]:
    numbered = all(name.isdigit() and int(name) >= 1 for name in found)
    motions = own_motions(map(_motion, found.values()))
    out = []
    for number, ((name, item), motion) in enumerate(zip(found.items(), motions, strict=True), start=1):
        keys = tuple(KeyFrame(f, v, tuple(item.polygons[f])) for f, v in sorted(item.keys.items()))
        out.append(
            AnnotatedObject(
                int(name) if numbered else number,
                item.attributes.get("name") or f"{item.label or 'object'} {number}",
                known_kind(item.label.lower()),
                motion,
                keys,
                item.attributes.get("note", ""),
            )
        )
    return tuple(out)


def _motion(item: _Found) -> Motion | None:
    """Return the motion that an attribute tells; None when it does not."""
    told = item.attributes.get("motion", "")
    if told == REJECT:
        return REJECT
    return int(told) if told.isdigit() and len(told) <= 4 else None


def _number(shape: ET.Element, name: str) -> int:
    value = shape.get(name, "")
    if not value.isdigit() or len(value) > 9:
        raise InvalidValueError(name, expected="a number", found=repr(value)[:40])
    return int(value)
