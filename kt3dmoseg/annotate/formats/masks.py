"""Masks: regions as pixels and back, run lengths, and the formats that store an image per frame.

Regions to pixels and back is exact: the outline of a mask runs along the edges of its pixels, so that exactly
the pixels whose centres lie inside belong to it. A hole is joined to the outline around it by a slit of no
width.

DAVIS is a zip of indexed PNGs, ``00000.png`` on; the index is the motion, 0 background, 254 rejected. Kept:
which pixels have which motion in which frame. Not kept: names and kinds, objects that share a motion, key
frames, what is hidden, motions above 253, marks.

KITTI MOTS has an id per pixel, ``1000 * class + instance``, as 16-bit PNGs in a zip or as a text file.
Classes are 1 = vehicles and 2 = people, 10 = ignore (id 10000); 3 is used here for all else. The instance
is the motion. A text line is ``frame id class height width rle``; frames count from 0. Kept and not kept as
for DAVIS, but for the class, which is kept, and motions up to 999. Ids whose instance numbers repeat in
another class are different objects in MOTS: they come back as motions of their own.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from types import ModuleType

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from kt3dmoseg.annotate.formats import AnnotationFormat
from kt3dmoseg.annotate.formats.foreign import ForeignObject, assemble, check_frame, check_shape, unzip_frames
from kt3dmoseg.annotate.geometry import area, bounds, inside
from kt3dmoseg.annotate.model import (
    BACKGROUND,
    MAX_OBJECTS,
    MAX_POINTS,
    MAX_POLYGONS,
    REJECT,
    Annotation,
    Polygon,
)
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.errors import FileFormatError, InvalidValueError, MissingDependencyError
from kt3dmoseg.files import zip_bytes
from kt3dmoseg.io.images import decode_indices, encode_indices
from kt3dmoseg.types import BoolArray, ByteArray, FloatArray

Corner = tuple[int, int]
Regions = Mapping[int, list[Region]]

# Step to the neighbour that is not in the mask -> the edge between, clockwise around the pixel.
_EDGES: dict[Corner, tuple[Corner, Corner]] = {
    (-1, 0): ((0, 0), (1, 0)),
    (0, 1): ((1, 0), (1, 1)),
    (1, 0): ((1, 1), (0, 1)),
    (0, -1): ((0, 1), (0, 0)),
}
# pycocotools reads and writes beyond the end of a text that stops in the middle of a number.
_RUNS = re.compile("[0-o]*[0-O]")
_DAVIS_VOID = 254
# Ids up to this are numbers of objects; gray levels that a person chose to see are brighter.
_DARK = 20
_MOTS_IGNORE = 10_000
_MOTS_STEP = 1000
_MOTS_LARGEST = (1 << 16) - 1
_MOTS_CLASS = {"pedestrian": 2, "cyclist": 2, "animal": 3, "other": 3}
_MOTS_KIND = {1: "car", 2: "pedestrian", 3: "other"}


def mask_of(polygons: Sequence[FloatArray], image_size: tuple[int, int]) -> BoolArray:
    """Return the pixels whose centres lie in the union of the polygons, (H, W) bool."""
    width, height = image_size
    mask = np.zeros((height, width), dtype=np.bool_)
    for polygon in polygons:
        left, top, right, bottom = bounds([polygon])
        x0, x1 = max(0, int(np.floor(left))), min(width - 1, int(np.ceil(right)))
        y0, y1 = max(0, int(np.floor(top))), min(height - 1, int(np.ceil(bottom)))
        if x1 >= x0 and y1 >= y0:
            grid = np.stack(np.meshgrid(np.arange(x0, x1 + 1), np.arange(y0, y1 + 1)), axis=-1)
            for row, points in enumerate(grid.astype(np.float64), start=y0):
                mask[row, x0 : x1 + 1] |= inside(points, polygon)
    return mask


def polygons_of(mask: BoolArray, tolerance: float = 0.0) -> list[Polygon]:
    """Return the outlines of a mask (H, W), one polygon per 4-connected part.

    Of more parts than a region may have, the largest; of more corners than a polygon may have, every
    second, or third... Corners closer than `tolerance` pixels to the simplified outline are left out.
    """
    parts, _ = ndimage.label(mask)
    boxes = ndimage.find_objects(parts)
    sizes = np.bincount(parts.ravel())[1:]
    out = []
    for k in np.sort(np.argsort(-sizes, kind="stable")[:MAX_POLYGONS]):
        rows, columns = boxes[k]
        offset = np.array([columns.start, rows.start]) - 0.5
        outline = _joined(_loops(parts[rows, columns] == k + 1)) + offset
        if tolerance > 0:  # Douglas and Peucker (1973)
            simple = cv2.approxPolyDP(outline.astype(np.float32)[:, None], tolerance, True)
            outline = np.asarray(simple[:, 0], dtype=np.float64)
        outline = outline[:: -(-len(outline) // MAX_POINTS)]
        if len(outline) >= 3:
            out.append(tuple((float(x), float(y)) for x, y in outline))
    return out


def void_ids(used: Collection[int], bits: int, where: str) -> list[int]:
    """Return which of the ids that the masks of a clip use are void, nothing to be scored on.

    10000 in the 16 bits of MOTS; in 8 bits 254 (ours) and 255 (DAVIS), but masks of 0 and 255 are of one
    object. Raises FileFormatError where 255 may be either: next to other values that one can see.
    """
    if bits == 16:
        return [_MOTS_IGNORE]
    others = set(used) - {0, 255}
    if not others:
        return []
    if 255 in used and min(others) > _DARK:
        expected, fix = "ids 1, 2, ... (255 = void)", "number the objects from 1 on"
        raise FileFormatError(where, expected=expected, found=f"255 and {sorted(others)[:5]}", fix=fix)
    return [_DAVIS_VOID, 255]


def label_images(
    annotation: Annotation, regions: Regions, values: Mapping[int, int]
) -> Iterator[npt.NDArray[np.int64]]:
    """Paint the visible objects of every frame into an (H, W) image, each with its value; 0 = background.

    Later objects cover earlier ones, static ones cover moving ones, rejected ones cover all, as in
    `label_tracks`.
    """
    width, height = annotation.image_size
    layers = {REJECT: 2, BACKGROUND: 1}
    ordered = sorted(annotation.objects, key=lambda item: layers.get(item.motion, 0))
    for frame in range(annotation.n_frames):
        image = np.zeros((height, width), dtype=np.int64)
        for item in ordered:
            region = regions[item.id][frame]
            if region.visibility == "visible":
                image[mask_of(region.polygons, annotation.image_size)] = values[item.id]
        yield image


def _loops(part: BoolArray) -> list[FloatArray]:
    """Return the corners of closed walks along the pixel edges of a mask, the mask on the right hand."""
    padded = np.pad(part, 1)
    leave: dict[Corner, list[Corner]] = {}
    for (dy, dx), (start, end) in _EDGES.items():
        rows, columns = np.nonzero(padded & ~np.roll(padded, (-dy, -dx), axis=(0, 1)))
        for y, x in zip((rows - 1).tolist(), (columns - 1).tolist(), strict=True):
            leave.setdefault((x + start[0], y + start[1]), []).append((x + end[0], y + end[1]))
    loops = []
    while leave:  # in reading order, so that each walk starts at a corner
        loops.append(np.array(_walk(leave, next(iter(leave))), dtype=np.float64))
    return loops


def _walk(leave: dict[Corner, list[Corner]], first: Corner) -> list[Corner]:
    corners: list[Corner] = []
    at, heading = first, (0, 0)
    while not corners or at != first:
        ways = leave[at]
        # Turning right keeps to the same pixel, so that pixels touching at a corner stay apart.
        right = (at[0] - heading[1], at[1] + heading[0])
        after = right if right in ways else ways[0]
        ways.remove(after)
        if not ways:
            del leave[at]
        step = (after[0] - at[0], after[1] - at[1])
        if step != heading:
            corners.append(at)
        heading, at = step, after
    return corners


def _joined(loops: list[FloatArray]) -> FloatArray:
    """One outline from the outer loop and those of the holes.

    The slit to a hole runs along pixel edges only: there no pixel centre can fall on it.
    """
    loops.sort(key=area, reverse=True)
    outline = loops[0]
    for hole in loops[1:]:
        corner = np.array([[outline[0, 0], hole[0, 1]]])
        outline = np.concatenate([outline[:1], corner, hole, hole[:1], corner, outline])
    return outline


def encode_rle(mask: BoolArray) -> str:
    """Return the compressed run lengths of an (H, W) mask, as in COCO; pycocotools makes them."""
    found: bytes = _pycocotools().encode(np.asfortranarray(mask, dtype=np.uint8))["counts"]
    return found.decode()


def decode_rle(runs: str | Sequence[int], height: int, width: int, where: str = "RLE") -> BoolArray:
    """Return the (height, width) mask of run lengths as in COCO, compressed or as a list of numbers.

    Raises FileFormatError when they are damaged or do not fill the mask.
    """
    size = height * width
    problem = FileFormatError(
        where, expected=f"runs that fill {width}x{height} pixels", found=f"{runs[:40]!r}"
    )
    if not isinstance(runs, str):
        if min(runs, default=0) < 0 or sum(runs) != size:
            raise problem
        flat = np.repeat(np.arange(len(runs)) % 2 == 1, runs)
        return flat.reshape((height, width), order="F")
    if not _RUNS.fullmatch(runs):
        raise problem
    mask = _decoded(runs, height, width)
    # pycocotools refuses runs that are too long; where they are too short, it leaves memory as it was.
    if mask is None or _decoded(runs, size - 1, 1) is not None:
        raise problem
    return mask


def _decoded(runs: str, height: int, width: int) -> BoolArray | None:
    try:
        found = _pycocotools().decode({"size": [height, width], "counts": runs.encode()})
    except ValueError:
        return None
    return np.asarray(found, dtype=np.bool_)


def _pycocotools() -> ModuleType:
    try:
        from pycocotools import mask
    except ImportError as error:
        fix = "pip install 'kt3dmoseg[label]'"
        raise MissingDependencyError("pycocotools is not installed", fix=fix) from error
    module: ModuleType = mask
    return module


def add_mask(
    found: dict[int, ForeignObject], number: int, frame: int, mask: BoolArray, where: str
) -> ForeignObject | None:
    """Add the outlines of an object in one frame, not its pixels, so that no file fills the memory.

    Returns the object, None when the mask is empty; raises FileFormatError when there are too many.
    """
    polygons = polygons_of(mask)
    if not polygons:
        return None
    if number not in found and len(found) == MAX_OBJECTS:
        raise FileFormatError(where, expected=f"at most {MAX_OBJECTS} objects", found="more")
    item = found.setdefault(number, ForeignObject())
    item.add(frame, polygons)
    return item


def _dump_davis(annotation: Annotation, regions: Regions, names: Sequence[str] = ()) -> bytes:
    largest = max(annotation.motions, default=0)
    if largest >= _DAVIS_VOID:
        expected = f"at most {_DAVIS_VOID - 1}, as DAVIS can hold"
        raise InvalidValueError("motion", expected=expected, found=str(largest))
    values = {o.id: _DAVIS_VOID if o.motion == REJECT else int(o.motion) for o in annotation.objects}
    images = label_images(annotation, regions, values)
    palette = davis_palette()
    return zip_bytes(
        {f"{k:05d}.png": encode_indices(image.astype(np.uint8), palette) for k, image in enumerate(images)}
    )


def _parse_davis(content: bytes, like: Annotation, names: Sequence[str] = ()) -> Annotation:
    found = _parse_images(content, like, names, "DAVIS masks", bits=8, largest=_DAVIS_VOID)
    for value, item in found.items():  # 255 was taken as 254
        void = value == _DAVIS_VOID
        item.motion, item.name = (REJECT, "rejected") if void else (value, f"motion {value}")
    return assemble({str(value): found[value] for value in sorted(found)}, like)


def _dump_mots_png(annotation: Annotation, regions: Regions, names: Sequence[str] = ()) -> bytes:
    images = _mots_images(annotation, regions)
    encoded = (cv2.imencode(".png", image.astype(np.uint16))[1].tobytes() for image in images)
    return zip_bytes({f"{k:06d}.png": content for k, content in enumerate(encoded)})


def _parse_mots_png(content: bytes, like: Annotation, names: Sequence[str] = ()) -> Annotation:
    found = _parse_images(content, like, names, "MOTS masks", bits=16, largest=_MOTS_LARGEST)
    return _mots_annotation(found, like)


def _dump_mots_text(annotation: Annotation, regions: Regions, names: Sequence[str] = ()) -> bytes:
    width, height = annotation.image_size
    lines = [
        f"{frame} {value} {value // _MOTS_STEP} {height} {width} {encode_rle(image == value)}\n"
        for frame, image in enumerate(_mots_images(annotation, regions))
        for value in np.unique(image[image > 0]).tolist()
    ]
    return "".join(lines).encode()


def _parse_mots_text(content: bytes, like: Annotation, names: Sequence[str] = ()) -> Annotation:
    found: dict[int, ForeignObject] = {}
    lines = content.decode("ascii", "replace").splitlines()
    most = MAX_OBJECTS * like.n_frames
    if len(lines) > most:
        raise FileFormatError("MOTS text", expected=f"at most {most} lines", found=str(len(lines)))
    for number, line in enumerate(lines, start=1):
        if line.strip():
            frame, value, mask = _mots_line(line, like, f"line {number}")
            add_mask(found, value, frame, mask, "MOTS text")
    return _mots_annotation(found, like)


DAVIS = AnnotationFormat(".zip", "application/zip", _dump_davis, _parse_davis)
MOTS_PNG = AnnotationFormat(".zip", "application/zip", _dump_mots_png, _parse_mots_png)
MOTS_TXT = AnnotationFormat(".txt", "text/plain", _dump_mots_text, _parse_mots_text)


def davis_palette() -> ByteArray:
    """Return the palette of PASCAL VOC and DAVIS, (256, 3) RGB.

    The bits of the index are spread over the high bits of the channels.
    """
    palette, index = np.zeros((256, 3), dtype=np.int64), np.arange(256)
    for bit in range(8):
        palette[:, bit % 3] |= ((index >> bit) & 1) << (7 - bit // 3)
    return palette.astype(np.uint8)


def _parse_images(
    content: bytes, like: Annotation, names: Sequence[str], what: str, *, bits: int, largest: int
) -> dict[int, ForeignObject]:
    """Objects of a zip of PNGs of at most `bits` bits; larger numbers than `largest` are taken as it."""
    found: dict[int, ForeignObject] = {}
    for frame, png in unzip_frames(content, ".png", like, names, what).items():
        where = f"{what}, frame {frame}"
        image, depth = decode_indices(png, where)
        if depth > bits:
            expected = f"an indexed or gray PNG of {bits} bits"
            raise FileFormatError(where, expected=expected, found=f"{depth} bits")
        check_shape(image.shape, like, where)
        image = np.minimum(image, largest)
        for value in np.unique(image[image > 0]).tolist():
            add_mask(found, value, frame, image == value, where)
    return found


def _mots_images(annotation: Annotation, regions: Regions) -> Iterator[npt.NDArray[np.int64]]:
    values = {}
    for item in annotation.objects:
        if item.motion != REJECT and item.motion >= _MOTS_STEP:
            expected = f"below {_MOTS_STEP}, as MOTS can hold"
            raise InvalidValueError("motion", expected=expected, found=str(item.motion))
        number = _MOTS_IGNORE if item.motion == REJECT else int(item.motion)
        kind = 0 if item.motion in (REJECT, BACKGROUND) else _MOTS_CLASS.get(item.kind, 1)
        values[item.id] = _MOTS_STEP * kind + number
    return label_images(annotation, regions, values)


def _mots_line(line: str, like: Annotation, where: str) -> tuple[int, int, BoolArray]:
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
    return numbers[0], numbers[1], decode_rle(text, numbers[2], numbers[3], where)


def _mots_annotation(found: Mapping[int, ForeignObject], like: Annotation) -> Annotation:
    ignored = _MOTS_IGNORE // _MOTS_STEP
    instances = [value % _MOTS_STEP for value in found if value // _MOTS_STEP != ignored]
    unique = len(set(instances)) == len(instances) and min(instances, default=1) > 0
    ordered: dict[int | str, ForeignObject] = {str(value): found[value] for value in sorted(found)}
    for number, (value, item) in enumerate(sorted(found.items()), start=1):
        kind, instance = divmod(value, _MOTS_STEP)
        item.kind = _MOTS_KIND.get(kind, "other")
        item.motion = REJECT if kind == ignored else instance if unique else number
        item.name = "rejected" if kind == ignored else f"{item.kind} {value}"
    return assemble(ordered, like)
