"""CVAT 1.1: one XML file with a track per polygon of an object (for video), or the shapes of each image.

Written: the polygon of every frame, with ``keyframe="1"`` where a person drew it; id, name, motion and note
of the object as attributes, so that several tracks are put together again. Read: key frames only; a track
that starts later than frame 0 is outside before; one that begins where another of its label ends, in the
same place, is its continuation. Of a project, the task of the clip's name.

Not kept: marks; the number of polygons of an object that is occluded somewhere unknown.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias
from xml.etree import ElementTree as ET

import numpy as np

from kt3dmoseg.annotate.formats import foreign
from kt3dmoseg.annotate.formats.masks import decode_rle, mask_of, outlines_of
from kt3dmoseg.annotate.geometry import arrays
from kt3dmoseg.annotate.model import KINDS, MAX_OBJECTS, MAX_POINTS, Annotation, Kind, Polygon, Visibility
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.matching import number_in, stem
from kt3dmoseg.text import several

Drawn: TypeAlias = tuple[Visibility, list[Polygon]]

_WHAT = "CVAT XML"
_DECLARATION = '<?xml version="1.0" encoding="utf-8"?>\n'
# Characters that XML 1.0 cannot hold, not even escaped.
_UNWRITABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")
_UNKNOWN = "\ufffd"
_DIGITS = 9
_STEP = re.compile(r"step\s*=\s*(\d{1,6})")
_MOST_NODES = 100_000
# Overlap of two outlines from which on they are of one object, as intersection over union.
_SAME_PLACE = 0.3
_COARSE = 128
# CVAT needs points where an object is hidden; these mean "somewhere".
_NOWHERE = "0.00,0.00;1.00,0.00;0.00,1.00"


def _write(annotation: Annotation, regions: foreign.Regions, names: Sequence[str]) -> bytes:
    fields = [
        {"name": name, "mutable": "False", "input_type": "text"}
        for name in ("object", "name", "motion", "note")
    ]
    width, height = annotation.image_size
    task = {
        "name": annotation.clip,
        "size": annotation.n_frames,
        "mode": "interpolation",
        "labels": {"label": [{"name": kind, "attributes": {"attribute": fields}} for kind in KINDS]},
        "original_size": {"width": width, "height": height},
    }
    root = ET.Element("annotations")
    _put(root, {"version": "1.1", "meta": {"task": task}})
    for item in annotation.objects:
        values = {"object": str(item.id), "name": item.name, "motion": str(item.motion), "note": item.note}
        for part in range(max(1, *(len(region.polygons) for region in regions[item.id]))):
            number = len(root) - 2
            track = ET.SubElement(root, "track", id=str(number), label=item.kind, source="manual")
            for frame, region in enumerate(regions[item.id]):
                drawn, hidden = part < len(region.polygons), region.visibility == "occluded"
                corners = foreign.with_corner_origin(region.polygons[part]) if drawn else []
                shape = ET.SubElement(
                    track,
                    "polygon",
                    frame=str(frame),
                    outside=str(int(not drawn and not (hidden and part == 0))),
                    occluded=str(int(hidden)),
                    keyframe=str(int(region.key)),
                    points=";".join(f"{x:.2f},{y:.2f}" for x, y in corners) or _NOWHERE,
                    z_order="0",
                )
                for name, value in values.items():
                    ET.SubElement(shape, "attribute", name=name).text = value
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    return f"{_DECLARATION}{_UNWRITABLE.sub(_UNKNOWN, text)}\n".encode()


def _put(parent: ET.Element, content: Mapping[str, Any]) -> None:
    """Add elements of these names; of a list, one each."""
    for tag, values in content.items():
        for value in values if isinstance(values, list) else [values]:
            child = ET.SubElement(parent, tag)
            if isinstance(value, dict):
                _put(child, value)
            else:
                child.text = str(value)


def _read(content: bytes, into: foreign.Import) -> None:
    """Read one XML file, or the zip file with one that CVAT offers."""
    root = _parsed(foreign.unpacked(content, ".xml", _WHAT))
    tasks = [_Task.of(node) for tag in ("task", "job") for node in root.iterfind(f"meta//{tag}")]
    tracks = {f"track[{k}]": node for k, node in enumerate(root.findall("track"))}
    images = root.findall("image")
    task = tasks[0] if tasks else _Task()
    if len(tasks) > 1:
        task = _own(tasks, into)
        stated = {node.get("task_id", "") for node in (*tracks.values(), *images)}
        if "" in stated:
            into.doubts.append("the file has several tasks, and shapes that name none")
        tracks = {where: node for where, node in tracks.items() if node.get("task_id", task.id) == task.id}
        images = [node for node in images if node.get("task_id", task.id) == task.id]
    if tracks:
        _read_tracks(tracks, task, into)
    if images:
        _read_images(images, into)


CVAT = foreign.AnnotationFormat(".xml", "application/xml", _write, _read)


def _parsed(content: bytes) -> ET.Element:
    """Parse XML without entities, and of no more elements than a person's work has."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    if content.count(b"<") - content.count(b"</") > _MOST_NODES:
        raise FileFormatError(_WHAT, expected="the elements of a task", found="very many")
    try:
        root: ET.Element = fromstring(content, forbid_dtd=True)
    except DefusedXmlException as error:
        found = "<!DOCTYPE"
        raise FileFormatError(_WHAT, expected="XML without a document type", found=found) from error
    except (ParseError, LookupError, ValueError) as error:
        raise FileFormatError(_WHAT, expected="XML", found=str(error)[:100]) from error
    if root.tag != "annotations":
        raise FileFormatError(_WHAT, expected="<annotations>", found=f"<{root.tag[:40]}>")
    return root


@dataclass(frozen=True)
class _Task:
    """What a file says of a task: its number of pictures, their numbers in the task's source, their size."""

    id: str = ""
    name: str = ""
    size: int | None = None
    first: int = 0
    step: int = 1
    pictures: tuple[int | None, int | None] = (None, None)

    @classmethod
    def of(cls, node: ET.Element) -> _Task:
        def number(path: str) -> int | None:
            text = (node.findtext(path) or "").strip()
            return int(text) if text.isdecimal() and len(text) <= _DIGITS else None

        first, last = number("start_frame") or 0, number("stop_frame")
        stated = _STEP.search(node.findtext("frame_filter") or "")
        step = max(1, int(stated[1])) if stated else 1
        size = number("size") if last is None else (last - first) // step + 1
        pictures = number("original_size/width"), number("original_size/height")
        return cls(node.findtext("id") or "", node.findtext("name") or "", size, first, step, pictures)


def _own(tasks: Sequence[_Task], into: foreign.Import) -> _Task:
    clip, names = into.like.clip, several(task.name for task in tasks)
    own = [task for task in tasks if stem(task.name).casefold() == clip.casefold()]
    if len(own) != 1:
        fix = "rename it, or export it alone"
        raise FileFormatError(_WHAT, expected=f"one task named {clip}", found=names, fix=fix)
    into.note(f"of the tasks {names}, {own[0].name} is read")
    return own[0]


@dataclass(frozen=True)
class _Known:
    """Of the tracks so far: which objects end in a frame, and where; which have an id, and when."""

    ends: dict[tuple[Kind, int], dict[foreign.Key, int]]
    named: dict[tuple[Kind, foreign.Key], tuple[foreign.Key, set[int]]]


def _read_tracks(tracks: Mapping[str, ET.Element], task: _Task, into: foreign.Import) -> None:
    numbered = [_numbered(where, track, into) for where, track in tracks.items()]
    frames = _frames(sorted({n for shapes in numbered for n, _ in shapes}), task, into)
    scale = into.scale(task.pictures, _WHAT)
    known = _Known({}, {})
    for (where, track), shapes in zip(tracks.items(), numbered, strict=True):
        placed = _placed(shapes, frames, into.like.n_frames)
        keys = [pair for pair in placed if _is_set(pair[1], "keyframe", "1")]
        if not keys or len(keys) < sum(_is_set(shape, "keyframe", "1") for _, shape in shapes):
            keys = placed  # a key frame that the clip has not: what lies between counts
        drawn: dict[int, Drawn] = {}
        if len(last := dict(keys)) < len(keys):
            into.skip(f"{where}: of several shapes in one frame, all but the last")
        for frame, shape in sorted(last.items()):
            with into.skipping(f"{where}: frame {frame}"):
                drawn[frame] = _shape(shape, scale, into)
        if drawn:
            label, fields = track.get("label", ""), _fields(placed[0][1])
            key = _key(where, foreign.kind_of(label), fields, drawn, known, into)
            name = fields.get("name") or f"{label or 'object'} {len(into.found) + 1}"
            # Before the task nothing is known, so the track's first outline is carried there.
            if min(frame for frame, _ in placed) > frames.get(task.first, 0) and key not in into.found:
                drawn.setdefault(0, ("outside", []))
            item = into.object(key, foreign.described(label, {**fields, "name": name}))
            for frame, (visibility, polygons) in drawn.items():
                item.add(frame, polygons, visibility)
    _note_returns({key for key, _ in known.named.values()}, into)


def _note_returns(named: set[foreign.Key], into: foreign.Import) -> None:
    """Say which tracks without an id begin after another of their label has ended."""
    ends: dict[str, tuple[int, str]] = {}
    begins: list[tuple[int, str, str]] = []
    for where, item in into.found.items():
        seen = sorted(frame for frame, how in item.visibility.items() if how != "outside")
        if isinstance(where, str) and where not in named and seen:
            begins.append((seen[0], item.kind, where))
            if seen[-1] < max(item.visibility):
                ends[item.kind] = min(ends.get(item.kind, (seen[-1], where)), (seen[-1], where))
    later = [(where, kind) for begin, kind, where in begins if kind in ends and begin > ends[kind][0]]
    if later:
        ended, begun = ends[later[0][1]][1], several(where for where, _ in later)
        into.note(
            f"tracks of its label begin after {ended} has ended: {begun}; "
            "they are other objects, unless a track_id says that it returns"
        )


def _placed(
    shapes: Sequence[tuple[int, ET.Element]], frames: Mapping[int, int], total: int
) -> list[tuple[int, ET.Element]]:
    """Give shapes their frames; where a track ends between two frames, it is outside in the second."""
    placed: list[tuple[int, ET.Element]] = []
    for number, shape in sorted(shapes, key=lambda pair: pair[0]):
        if number in frames:
            placed.append((frames[number], shape))
        elif placed and placed[-1][0] + 1 < total and _is_set(shape, "outside"):
            placed.append((placed[-1][0] + 1, shape))
    return placed


def _is_set(shape: ET.Element, flag: str, default: str = "0") -> bool:
    return shape.get(flag, default).lower() in ("1", "true")


def _numbered(where: str, track: ET.Element, into: foreign.Import) -> list[tuple[int, ET.Element]]:
    shapes = []
    for shape in (child for child in track if child.tag != "attribute"):
        with into.skipping(f"{where}.{shape.tag}"):
            shapes.append((_number(shape, "frame"), shape))
    if not shapes:
        into.skip(f"{where}: expected polygons, found nothing")
    return shapes


def _key(
    where: str,
    kind: Kind,
    fields: Mapping[str, str],
    drawn: Mapping[int, Drawn],
    known: _Known,
    into: foreign.Import,
) -> foreign.Key:
    """Return the object of a track: as stated, that which ends where and when it begins, or a new one."""
    key, _ = foreign.identity_in(fields, ("object",))
    if key is not None:
        return key
    into.note("ids are the tracks")
    into.count("tracks", 1, 2 * MAX_OBJECTS)
    begin, end = min(drawn), max(drawn)
    stated, source = foreign.identity_in(fields, foreign.OF_TRACKS)
    if stated is not None:
        other, taken = known.named.setdefault((kind, stated), (where, set()))
        span = {*range(begin, end if drawn[end][0] == "outside" else into.like.n_frames)}
        apart = taken.isdisjoint(span)
        taken |= span
        if apart and other != where:
            into.note(f"{where} has the {source} of {other}: one object")
            return other
    ended, place = known.ends.get((kind, begin), {}), _place(drawn[begin][1], into.like)
    alike = (
        other
        for other, left in ended.items()
        if (left & place).bit_count() >= _SAME_PLACE * max(1, (left | place).bit_count())
    )
    key = next(alike, where)
    if key != where:
        del ended[key]
        into.note(f"{where} goes on where {key} ends: one object")
    shown = [polygons for _, polygons in drawn.values() if polygons]
    if shown and drawn[end][0] == "outside":
        known.ends.setdefault((kind, end), {})[key] = _place(shown[-1], into.like)
    return key


def _place(polygons: Sequence[Polygon], like: Annotation) -> int:
    """Where outlines lie: a bit for each cell of a coarse grid, as many are compared."""
    scale = _COARSE / max(like.image_size)
    mask = mask_of([scale * p for p in arrays(polygons)], (_COARSE, _COARSE))
    return int.from_bytes(np.packbits(mask).tobytes())


def _frames(numbers: Sequence[int], task: _Task, into: foreign.Import) -> dict[int, int]:
    """Find the clip's frame of each frame number of CVAT; raises FileFormatError when none has one."""
    total, shift = into.like.n_frames, into.choices.shift
    if shift is not None:
        into.note(f"frames shifted by {shift}")
    known = _frames_of_task(numbers, task, into) if shift is None else {n: n + shift for n in numbers}
    found = {number: frame for number, frame in known.items() if 0 <= frame < total}
    left = [number for number in numbers if number not in found]
    if left and not found:
        expected, fix = f"frames 0 to {total - 1} of the clip", f"a shift of {-left[0]} begins with frame 0"
        raise FileFormatError(_WHAT, expected=expected, found=f"frames {several(left)}", fix=fix)
    if left:
        into.doubts.append(f"frames {several(left)} are none of the clip's, 0 to {total - 1}")
    return found


def _frames_of_task(numbers: Sequence[int], task: _Task, into: foreign.Import) -> dict[int, int]:
    """Find the clip's frames of a task.

    CVAT numbers the pictures of the task's source from 0, also those that the task leaves out. The task is
    the clip when it has as many frames; else its source may be the clip, or what the clip was cut from.
    """
    total, first, step = into.like.n_frames, task.first, task.step
    last = first + ((task.size or total) - 1) * step
    same = {number: number for number in numbers}
    if task.size == total:
        inside = {n: (n - first) // step for n in numbers if n in range(first, last + 1, step)}
        if inside and (first or step > 1):
            steps = f", each next one {step} later" * (step > 1)
            into.note(f"frame {first} of the task is frame 0 of the clip{steps}")
        return inside or same  # some versions count within the task
    if last < total:
        other = [n for n in numbers if n <= last and n not in range(first, last + 1, step)]
        if task.size and other:
            into.doubts.append(f"frames {several(other)} are none of the task's, {first} to {last} by {step}")
        elif task.size:
            text = f"the task has {task.size} of the clip's {total} frames, {first} to {last}"
            if first or step > 1:
                into.note(text)
            else:
                into.doubts.append(f"{text}, unless it was made of later ones")
        return same
    known = {number_in(name): k for k, name in enumerate(into.names)}
    into.doubts.append(
        f"the task has frames {first} to {last}, the clip {total} frames; they are taken as the "
        f"numbers in {into.names[0]} to {into.names[-1]}"
    )
    return {number: known[number] for number in numbers if number in known}


def _read_images(images: Sequence[ET.Element], into: foreign.Import) -> None:
    named = [(node.get("name") or node.get("id") or "", node) for node in images]
    frames = into.match([name for name, _ in named], "CVAT images")
    for name, node in named:
        if name in frames:
            scale = into.scale((node.get("width"), node.get("height")), name)
            for k, shape in enumerate(child for child in node if child.tag not in ("tag", "attribute")):
                with into.skipping(f"{name}: shape {k}"):
                    fields, label = (
                        {"group_id": shape.get("group_id"), **_fields(shape)},
                        shape.get("label", ""),
                    )
                    into.reading(frames[name], label, fields)
                    visibility, polygons = _shape(shape, scale, into)
                    into.add(frames[name], label, polygons, fields, visibility=visibility)
    into.list_frames(frames.values())


def _fields(shape: ET.Element) -> dict[str, str]:
    return {node.get("name", ""): node.text or "" for node in shape.findall("attribute")}


def _shape(shape: ET.Element, scale: tuple[float, float], into: foreign.Import) -> Drawn:
    """Visibility and outlines of a shape."""
    if _is_set(shape, "outside"):
        return "outside", []
    if shape.tag not in _OUTLINES:
        raise InvalidValueError("", expected="polygons, masks or ellipses", found=f"a {shape.tag[:40]}")
    hidden = shape.get("points") == _NOWHERE
    polygons = [] if hidden else _OUTLINES[shape.tag](shape, scale, into)
    return "occluded" if _is_set(shape, "occluded") else "visible", polygons


def _polygon(shape: ET.Element, scale: tuple[float, float], into: foreign.Import) -> list[Polygon]:
    # Of more, a part is as wrong.
    corners = shape.get("points", "").split(";", MAX_POINTS + 1)[: MAX_POINTS + 1]
    try:
        pairs = [tuple(map(float, pair.split(",", 2))) for pair in corners]
    except ValueError:
        found = repr(";".join(corners))[:60]
        raise InvalidValueError("points", expected="x,y;x,y;...", found=found) from None
    return [into.outline(pairs, scale)]


def _ellipse(shape: ET.Element, scale: tuple[float, float], into: foreign.Import) -> list[Polygon]:
    values = [float(shape.get(name, "0")) for name in ("cx", "cy", "rx", "ry", "rotation")]
    return [into.outline(foreign.ellipse(*values), scale)]


def _mask(shape: ET.Element, scale: tuple[float, float], into: foreign.Import) -> list[Polygon]:
    """Run lengths, row by row, in a box."""
    left, top, width, height = (_number(shape, name) for name in ("left", "top", "width", "height"))
    columns, rows = into.like.image_size
    if scale != (1.0, 1.0) or left + width > columns or top + height > rows:
        expected, found = f"a mask in pictures of {columns}x{rows}", f"{width}x{height} at {left}, {top}"
        raise InvalidValueError("mask", expected=expected, found=found)
    runs = [int(run) for run in shape.get("rle", "").split(",") if len(run) <= _DIGITS]
    return outlines_of(decode_rle(runs, width, height, "rle").T, into, (left, top))


_OUTLINES = {"polygon": _polygon, "ellipse": _ellipse, "mask": _mask}


def _number(shape: ET.Element, name: str) -> int:
    value = shape.get(name, "")
    if not value.isdecimal() or len(value) > _DIGITS:
        raise InvalidValueError(name, expected="a number", found=repr(value)[:40])
    return int(value)
