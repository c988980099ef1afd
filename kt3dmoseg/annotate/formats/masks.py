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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import PurePosixPath

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from kt3dmoseg.annotate.formats.foreign import (
    AnnotationFormat,
    ForeignObject,
    Import,
    Regions,
    check_shape,
    names_of,
    unzip_frames,
)
from kt3dmoseg.annotate.model import (
    BACKGROUND,
    MAX_OBJECTS,
    MAX_POINTS,
    MAX_POLYGONS,
    REJECT,
    Annotation,
    Polygon,
)
from kt3dmoseg.errors import FileFormatError, InvalidValueError, MissingDependencyError
from kt3dmoseg.files import zip_bytes
from kt3dmoseg.io.images import decode_indices, encode_indices, void_ids
from kt3dmoseg.matching import number_in
from kt3dmoseg.types import BoolArray, ByteArray, FloatArray, IntArray

# For each heading (right, down, left, up) the step (y, x) from a pixel to the neighbour that is not in the
# mask, and where on the pixel (x, y) the edge between begins: clockwise around it.
_EDGES = (((-1, 0), (0, 0)), ((0, 1), (1, 0)), ((1, 0), (1, 1)), ((0, -1), (0, 1)))
_RUNS = re.compile("(?:[P-o]{0,5}[0-O])++")  # numbers of up to 6 digits
_MORE, _SIGN = 32, 16
_DAVIS_VOID = 254
_BLOCK = 1 << 20
# Pixel edges around one region; a car that fills a large picture has 10,000.
_MOST_EDGES = 300_000
_MOTS_IGNORE = 10_000
_MOTS_STEP = 1000
_MOTS_LINE = re.compile(r"(\d{1,9}) +(\d{1,9}) +\S+ +(\d{1,9}) +(\d{1,9}) +(\S+)")
_MOTS_CLASS = {"pedestrian": 2, "cyclist": 2, "animal": 3, "other": 3}
_MOTS_KIND = {1: "car", 2: "pedestrian", 3: "other"}


def mask_of(polygons: Sequence[FloatArray], image_size: tuple[int, int]) -> BoolArray:
    """Return the pixels whose centres lie in the union of the polygons by the even-odd rule, (H, W) bool."""
    width, height = image_size
    mask = np.zeros((height, width), dtype=np.bool_)
    step = max(1, _BLOCK // height)
    for polygon in polygons:
        crossings = np.zeros(height * (width + 1), dtype=np.int64)
        starts, ends = polygon, np.roll(polygon, -1, axis=0)
        for k in range(0, len(polygon), step):
            _count_crossings(starts[k : k + step], ends[k : k + step], crossings, (width, height))
        # A pixel is inside when an odd number of edges cross its row to its right.
        right = crossings.reshape(height, width + 1)[:, :0:-1]
        mask |= np.cumsum(right, axis=1)[:, ::-1] % 2 == 1
    return mask


def _count_crossings(
    starts: FloatArray, ends: FloatArray, crossings: IntArray, image_size: tuple[int, int]
) -> None:
    """Count where edges cross the rows between their ends, the upper end included, in (H * (W + 1),)."""
    width, height = image_size
    (ax, ay), (bx, by) = starts.T, ends.T
    first = np.clip(np.ceil(np.minimum(ay, by)), 0, height).astype(np.int64)
    counts = np.clip(np.ceil(np.maximum(ay, by)), 0, height).astype(np.int64) - first
    edge = np.repeat(np.arange(len(starts)), counts)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts) + first[edge]
    at = ax[edge] + (row - ay[edge]) * (bx - ax)[edge] / (by - ay)[edge]
    column = np.clip(np.ceil(at), 0, width).astype(np.int64)
    crossings += np.bincount(row * (width + 1) + column, minlength=len(crossings))


def polygons_of(mask: BoolArray, tolerance: float = 0.0) -> list[Polygon]:
    """Return the outlines of a mask (H, W), one polygon per 4-connected part.

    Of more parts than a region may have, the largest; of more corners than a polygon may have, every
    second, or third... Corners closer than `tolerance` pixels to the simplified outline are left out.
    """
    _, parts, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    out = []
    for k in 1 + np.sort(np.argsort(-stats[1:, cv2.CC_STAT_AREA], kind="stable")[:MAX_POLYGONS]):
        left, top, width, height = stats[k, : cv2.CC_STAT_AREA].tolist()
        part = parts[top : top + height, left : left + width] == k
        outline = _joined(_loops(part)) + np.array([left, top]) - 0.5
        if tolerance > 0:  # Douglas and Peucker (1973)
            simple = cv2.approxPolyDP(outline.astype(np.float32)[:, None], tolerance, True)
            outline = np.asarray(simple[:, 0], dtype=np.float64)
        outline = outline[:: -(-len(outline) // MAX_POINTS)]
        if len(outline) >= 3:
            out.append(tuple((float(x), float(y)) for x, y in outline))
    return out


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
    """Return the corners of closed walks along the pixel edges of a mask, the mask on the right hand.

    The first is the outer one; the others are those of the holes.
    """
    height, width = part.shape
    columns, padded = width + 1, np.pad(part, 1)
    starts, headings = [], []
    for number, ((dy, dx), (right, down)) in enumerate(_EDGES):
        beyond = padded[1 + dy : 1 + dy + height, 1 + dx : 1 + dx + width]
        y, x = np.divmod(np.flatnonzero(part & ~beyond), width)
        starts.append((y + down) * columns + x + right)
        headings.append(np.full(len(y), number))
    start, heading = np.concatenate(starts), np.concatenate(headings)
    if len(start) > _MOST_EDGES:
        raise FileFormatError("mask", expected="regions that a person draws", found="noise")
    order = np.argsort(4 * start + heading)
    known = (4 * start + heading)[order]
    end = start + np.array([1, columns, -1, -columns])[heading]
    # Turning right keeps to the same pixel, so that pixels touching at a corner stay apart.
    after = np.zeros(len(start), dtype=np.int64)
    for turn in (3, 0, 1):
        sought = 4 * end + (heading + turn) % 4
        at = np.minimum(np.searchsorted(known, sought), len(known) - 1)
        after = np.where(known[at] == sought, order[at], after)
    corner = np.stack([start % columns, start // columns], axis=1).astype(np.float64)
    turned = heading.tolist()
    following = after.tolist()
    loops, left = [], bytearray(b"\1") * len(after)
    for first in range(
        len(starts[0])
    ):  # every walk has an upper edge; in reading order the outer one is first
        walk, edge, before = [], first, -1
        while left[edge]:
            left[edge] = 0
            if turned[edge] != before:
                walk.append(edge)
                before = turned[edge]
            edge = following[edge]
        if walk:
            loops.append(corner[walk])
    return loops


def _joined(loops: list[FloatArray]) -> FloatArray:
    """One outline from the outer loop and those of the holes.

    The slit to a hole runs along pixel edges only: there no pixel centre can fall on it.
    """
    outer, *holes = loops
    pieces = [outer, outer[:1]]
    for hole in holes:
        corner = np.array([[outer[0, 0], hole[0, 1]]])
        pieces += [corner, hole, hole[:1], corner, outer[:1]]
    return np.concatenate(pieces) if holes else outer


def encode_rle(mask: BoolArray) -> str:
    """Return the compressed run lengths of an (H, W) mask, as in COCO; pycocotools makes them."""
    try:
        from pycocotools import mask as coco
    except ImportError as error:
        fix = "pip install 'kt3dmoseg[label]'"
        raise MissingDependencyError("pycocotools is not installed", fix=fix) from error
    found: bytes = coco.encode(np.asfortranarray(mask, dtype=np.uint8))["counts"]
    return found.decode()


def decode_rle(runs: str | Sequence[int], height: int, width: int, where: str = "RLE") -> BoolArray:
    """Return the (height, width) mask of run lengths as in COCO, compressed or as a list of numbers.

    Raises FileFormatError when they are damaged or do not fill the mask.
    """
    counts = _decoded(runs) if isinstance(runs, str) else runs
    if min(counts, default=-1) < 0 or sum(counts) != height * width:
        expected = f"runs that fill {width}x{height} pixels"
        raise FileFormatError(where, expected=expected, found=f"{runs[:40]!r}")
    flat = np.repeat(np.arange(len(counts)) % 2 == 1, counts)
    return flat.reshape((height, width), order="F")


def _decoded(text: str) -> list[int]:
    """Return compressed run lengths as numbers, none when they are damaged.

    A character holds 5 bits, the lowest first, and whether more follow; the highest bit of the last one is
    the sign. From the fourth run on, the difference from the one before the last is stored. pycocotools reads
    beyond damaged texts, and keeps the memory of each that it refuses.
    """
    if not _RUNS.fullmatch(text):
        return []
    codes = np.frombuffer(text.encode(), dtype=np.uint8).astype(np.int64) - ord("0")
    ends = np.flatnonzero(codes < _MORE)
    starts = np.append(0, ends[:-1] + 1)
    lengths = ends - starts + 1
    place = np.arange(len(codes)) - np.repeat(starts, lengths)
    runs = np.add.reduceat((codes & (_MORE - 1)) << (5 * place), starts)
    runs -= np.where(codes[ends] & _SIGN, 1 << (5 * lengths), 0)
    runs[1::2], runs[2::2] = np.cumsum(runs[1::2]), np.cumsum(runs[2::2])
    numbers: list[int] = runs.tolist()
    return numbers


def outlines_of(mask: BoolArray, into: Import, corner: tuple[int, int] = (0, 0)) -> list[Polygon]:
    """Return the outlines of a mask that begins at the pixel `corner` (x, y), and count them."""
    boxes = ndimage.find_objects(mask.view(np.uint8))
    if not boxes:
        return []
    part = mask[boxes[0]]
    into.count_pixels(part.size)
    x, y = corner[0] + boxes[0][1].start, corner[1] + boxes[0][0].start
    return [into.counted(tuple((a + x, b + y) for a, b in polygon)) for polygon in polygons_of(part)]


def _dump_davis(annotation: Annotation, regions: Regions, names: Sequence[str] = ()) -> bytes:
    _check_motions(annotation, _DAVIS_VOID - 1, "DAVIS")
    values = {o.id: _DAVIS_VOID if o.motion == REJECT else int(o.motion) for o in annotation.objects}
    images, palette = label_images(annotation, regions, values), davis_palette()
    files = (encode_indices(image.astype(np.uint8), palette) for image in images)
    return _zipped(files, names_of(annotation, names, "{:05d}.png"))


def _dump_mots_png(annotation: Annotation, regions: Regions, names: Sequence[str] = ()) -> bytes:
    images = label_images(annotation, regions, _mots_values(annotation))
    files = (cv2.imencode(".png", image.astype(np.uint16))[1].tobytes() for image in images)
    return _zipped(files, names_of(annotation, names))


def _zipped(files: Iterable[bytes], names: Sequence[str]) -> bytes:
    """Pack masks that are named as the frames."""
    stems = (PurePosixPath(name).stem for name in names)
    return zip_bytes({f"{stem}.png": file for stem, file in zip(stems, files, strict=True)})


def _dump_mots_text(annotation: Annotation, regions: Regions, names: Sequence[str] = ()) -> bytes:
    width, height = annotation.image_size
    numbers = [number_in(name) for name in names_of(annotation, names)]
    images = label_images(annotation, regions, _mots_values(annotation))
    lines = [
        f"{number} {value} {value // _MOTS_STEP} {height} {width} {encode_rle(image == value)}\n"
        for number, image in zip(numbers, images, strict=True)
        for value in np.unique(image[image > 0]).tolist()
    ]
    return "".join(lines).encode()


def _mots_values(annotation: Annotation) -> dict[int, int]:
    _check_motions(annotation, _MOTS_STEP - 1, "MOTS")
    values = {}
    for item in annotation.objects:
        number = _MOTS_IGNORE if item.motion == REJECT else int(item.motion)
        kind = 0 if item.motion in (REJECT, BACKGROUND) else _MOTS_CLASS.get(item.kind, 1)
        values[item.id] = _MOTS_STEP * kind + number
    return values


def _check_motions(annotation: Annotation, most: int, name: str) -> None:
    if (largest := max(annotation.motions, default=0)) > most:
        raise InvalidValueError("motion", expected=f"at most {most}, as {name} can hold", found=str(largest))


def _read_davis(content: bytes, into: Import) -> None:
    used, bits = _read_images(content, into, "DAVIS masks", bits=8)
    voids = void_ids(used, bits, "DAVIS masks")
    into.note("ids are the values of the masks")
    if 255 in used.intersection(voids):
        into.note("255 is void and rejected")
    for value, item in _in_order(into):
        item.motion = REJECT if value in voids else 1 if value == 255 else value
        item.name = "rejected" if value in voids else f"motion {item.motion}"


def _read_mots_png(content: bytes, into: Import) -> None:
    _read_images(content, into, "MOTS masks", bits=16)
    _name_mots(into)


def _read_mots_text(content: bytes, into: Import) -> None:
    lines = content.decode("ascii", "replace").splitlines()
    into.count("lines", MAX_OBJECTS * into.like.n_frames, len(lines))
    found: list[tuple[str, str, int, str]] = []
    for number, line in enumerate(lines, start=1):
        with into.skipping(f"line {number}"):
            if line.strip():
                found.append((f"line {number}", *_mots_line(line, into.like)))
    frames = into.match(dict.fromkeys(frame for _, frame, *_ in found), "MOTS text")
    into.annotated |= set(range(into.like.n_frames))
    width, height = into.like.image_size
    for where, frame, value, text in found:
        with into.skipping(where):
            if frame in frames:
                into.count_pixels(width * height // 8)  # decoding is cheap
                if outlines := outlines_of(decode_rle(text, height, width, "rle"), into):
                    into.object(value).add(frames[frame], outlines)
    _name_mots(into)


DAVIS = AnnotationFormat(".zip", "application/zip", _dump_davis, _read_davis)
MOTS_PNG = AnnotationFormat(".zip", "application/zip", _dump_mots_png, _read_mots_png)
MOTS_TXT = AnnotationFormat(".txt", "text/plain", _dump_mots_text, _read_mots_text)


def davis_palette() -> ByteArray:
    """Return the palette of PASCAL VOC and DAVIS, (256, 3) RGB.

    The bits of the index are spread over the high bits of the channels.
    """
    palette, index = np.zeros((256, 3), dtype=np.int64), np.arange(256)
    for bit in range(8):
        palette[:, bit % 3] |= ((index >> bit) & 1) << (7 - bit // 3)
    return palette.astype(np.uint8)


def _read_images(content: bytes, into: Import, what: str, *, bits: int) -> tuple[set[int], int]:
    """Read a zip of PNGs of at most `bits` bits; return the numbers in use, and their bits."""
    used, deepest = {0}, 1
    for frame, file, png in unzip_frames(content, ".png", into, what):
        where = f"{what}: {file}"
        image, depth = decode_indices(png, where)
        if depth > bits:
            expected = f"an indexed or gray PNG of {bits} bits"
            raise FileFormatError(where, expected=expected, found=f"{depth} bits")
        check_shape(image.shape, into.like, where)
        deepest = max(deepest, depth)
        into.annotated.add(frame)
        for value, box in enumerate(ndimage.find_objects(image), start=1):
            if box is not None:
                used.add(value)
                item = into.object(value)
                item.add(frame, outlines_of(image[box] == value, into, (box[1].start, box[0].start)))
    return used, deepest


def _mots_line(line: str, like: Annotation) -> tuple[str, int, str]:
    """Frame number, id and run lengths of a line."""
    if not (match := _MOTS_LINE.fullmatch(line.strip())):
        expected = "frame id class height width rle"
        raise FileFormatError("", expected=expected, found=repr(line[:60]))
    frame, value, height, width, text = match.groups()
    check_shape((int(height), int(width)), like, "size")
    return str(int(frame)), int(value), text


def _in_order(into: Import) -> list[tuple[int, ForeignObject]]:
    """Return the objects by value, and let them be numbered in that order."""
    found = sorted((int(value), item) for value, item in into.found.items())
    into.found = {str(value): item for value, item in found}
    return found


def _name_mots(into: Import) -> None:
    found = _in_order(into)
    ignored = _MOTS_IGNORE // _MOTS_STEP
    instances = [value % _MOTS_STEP for value, _ in found if value // _MOTS_STEP != ignored]
    unique = len(set(instances)) == len(instances) and min(instances, default=1) > 0
    for number, (value, item) in enumerate(found, start=1):
        kind, instance = divmod(value, _MOTS_STEP)
        item.kind = _MOTS_KIND.get(kind, "other")
        item.motion = REJECT if kind == ignored else instance if unique else number
        item.name = "rejected" if kind == ignored else f"{item.kind} {value}"
