"""Masks: regions as pixels and back, run lengths, and the formats that store an image per frame.

Regions to pixels and back is exact: the outline of a mask runs along the edges of its pixels, so that exactly
the pixels whose centres lie inside belong to it. A hole is joined to the outline around it by a slit of no
width.

DAVIS is a zip of indexed PNGs, ``00000.png`` on; the index is the motion, 0 background, 254 rejected.
KITTI MOTS has an id per pixel, ``1000 * class + instance``, as 16-bit PNGs in a zip or as a text file with
lines ``frame id class height width rle``. Classes are 1 = vehicles and 2 = people, 10 = ignore (id 10000); 3
is used here for all else. The instance is the motion; objects of one motion have the class of the first. Ids
whose instance numbers repeat in another class are different objects in MOTS: read, they are motions of their
own.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import PurePosixPath

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from kt3dmoseg.annotate import model
from kt3dmoseg.annotate.formats.foreign import AnnotationFormat, ForeignObject, Import, Regions
from kt3dmoseg.errors import FileFormatError, InvalidValueError, optional
from kt3dmoseg.files import zip_bytes
from kt3dmoseg.io.images import MOTS_CLASS, MOTS_VOID, davis_palette, decode_indices, encode_indices, void_ids
from kt3dmoseg.matching import number_in
from kt3dmoseg.types import BoolArray, FloatArray

_RUNS = re.compile("(?:[P-o]{0,5}[0-O])++")  # numbers of up to 6 digits
_MORE, _SIGN = 32, 16
_DAVIS_VOID = 254
_BLOCK = 1 << 20
# Of one region; a car that fills a large picture has some thousand.
_MOST_CORNERS = 200_000
_PART = 5_000
_MOTS_LINE = re.compile(r"(\d{1,9})\s+(\d{1,9})\s+\S+\s+(\d{1,9})\s+(\d{1,9})\s+(\S+)")
_MOTS_CLASSES = {"pedestrian": 2, "cyclist": 2, "animal": 3, "other": 3}
_MOTS_KIND = {1: "car", 2: "pedestrian", 3: "other"}


def mask_of(polygons: Sequence[FloatArray], image_size: tuple[int, int]) -> BoolArray:
    """Return the pixels whose centres lie in the union of the polygons by the even-odd rule, (H, W) bool."""
    width, height = image_size
    mask, rows = np.zeros((height, width), dtype=np.bool_), np.arange(height)
    step = max(1, _BLOCK // height)
    for polygon in polygons:
        crossings = np.zeros(height * (width + 1), dtype=np.int64)
        after = np.roll(polygon, -1, axis=0)
        for first in range(0, len(polygon), step):
            (ax, ay), (bx, by) = (ends[first : first + step].T for ends in (polygon, after))
            edge, row = np.nonzero((ay[:, None] <= rows) != (by[:, None] <= rows))
            at = ax[edge] + (row - ay[edge]) * (bx - ax)[edge] / (by - ay)[edge]
            column = np.clip(np.ceil(at), 0, width).astype(np.int64)
            crossings += np.bincount(row * (width + 1) + column, minlength=len(crossings))
        # A pixel is inside when an odd number of edges cross its row to its right.
        right = crossings.reshape(height, width + 1)[:, :0:-1]
        mask |= np.cumsum(right, axis=1)[:, ::-1] % 2 == 1
    return mask


def polygons_of(mask: BoolArray, tolerance: float = 0.0) -> list[model.Polygon]:
    """Return the outlines of a mask (H, W), one polygon per 4-connected part.

    Of more parts than a region may have, the largest; of more corners than a polygon may have, every
    second, or third... Corners closer than `tolerance` pixels to the simplified outline are left out.
    """
    _, parts, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    out = []
    for k in 1 + np.sort(np.argsort(-stats[1:, cv2.CC_STAT_AREA], kind="stable")[: model.MAX_POLYGONS]):
        left, top, width, height = stats[k, : cv2.CC_STAT_AREA].tolist()
        part = parts[top : top + height, left : left + width] == k
        outline = _joined(_loops(part)) + np.array([left, top]) - 0.5
        if tolerance > 0:  # Douglas and Peucker (1973)
            simple = cv2.approxPolyDP(outline.astype(np.float32)[:, None], tolerance, True)
            outline = np.asarray(simple[:, 0], dtype=np.float64)
        outline = outline[:: -(-len(outline) // model.MAX_POINTS)]
        if len(outline) >= 3:
            out.append(tuple((x, y) for x, y in outline.tolist()))
    return out


def label_images(
    annotation: model.Annotation, regions: Regions, values: Mapping[int, int]
) -> Iterator[npt.NDArray[np.int64]]:
    """Paint the visible objects of every frame into an (H, W) image, each with its value; 0 = background.

    Later objects cover earlier ones, static ones cover moving ones, rejected ones cover all, as in
    `label_tracks`.
    """
    width, height = annotation.image_size
    layers = {model.REJECT: 2, model.BACKGROUND: 1}
    ordered = sorted(annotation.objects, key=lambda item: layers.get(item.motion, 0))
    for frame in range(annotation.n_frames):
        image = np.zeros((height, width), dtype=np.int64)
        for item in ordered:
            region = regions[item.id][frame]
            if region.visibility == "visible":
                image[mask_of(region.polygons, annotation.image_size)] = values[item.id]
        yield image


def _loops(part: BoolArray) -> list[FloatArray]:
    """Return the corners of closed walks along the pixel edges of a 4-connected mask, the outer one first.

    Pixels are drawn twice as large, with their edges, so that OpenCV's contours run along these. It cuts
    corners that point into the mask: from the middle of one edge to that of the next.
    """
    grid = np.zeros([2 * side + 1 for side in part.shape], dtype=np.uint8)
    grid[1::2, 1::2] = part
    closed = cv2.dilate(grid, np.ones((3, 3), dtype=np.uint8))
    contours, (tree,) = cv2.findContours(closed, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    points = np.concatenate(contours)[:, 0]
    if len(points) > _MOST_CORNERS:
        raise FileFormatError("mask", expected="regions that a person draws", found="noise")
    ends = np.cumsum([len(contour) for contour in contours])
    after = np.concatenate([points[1:], points[:1]])
    after[ends - 1] = points[np.append(0, ends[:-1])]
    even = points % 2 == 0
    corners = np.where(even, points, after) / 2
    kept = even.all(axis=1) | (points != after).all(axis=1)
    loops = [corners[a:b][kept[a:b]] for a, b in pairwise([0, *ends])]
    outer = loops.pop(int(np.argmin(tree[:, 3])))  # the one without a parent
    return [np.concatenate([outer[:1], outer[:0:-1]]), *loops]  # clockwise


def _joined(loops: list[FloatArray]) -> FloatArray:
    """One outline from the outer loop and those of the holes, of very many the longest.

    The slit to a hole runs along pixel edges only: there no pixel centre can fall on it.
    """
    outer, *holes = loops
    holes = holes if len(holes) <= model.MAX_POLYGONS else sorted(holes, key=len)[-model.MAX_POLYGONS :]
    pieces = [outer, outer[:1]]
    for hole in holes:
        corner = np.array([[outer[0, 0], hole[0, 1]]])
        pieces += [corner, hole, hole[:1], corner, outer[:1]]
    return np.concatenate(pieces) if holes else outer


def encode_rle(mask: BoolArray) -> str:
    """Return the compressed run lengths of an (H, W) mask, as in COCO; pycocotools makes them."""
    coco = optional("pycocotools.mask", "run lengths need", "label")
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


def outlines_of(mask: BoolArray, into: Import, corner: tuple[int, int] = (0, 0)) -> list[model.Polygon]:
    """Return the outlines of a mask that begins at the pixel `corner` (x, y), and count them."""
    left, top, width, height = cv2.boundingRect(np.ascontiguousarray(mask).view(np.uint8))
    part = mask[top : top + height, left : left + width]
    polygons = polygons_of(part) if part.size else []
    into.count("pixels in masks", part.size + _PART * len(polygons))
    into.count("corners", sum(map(len, polygons)))
    if len(polygons) == model.MAX_POLYGONS or max(map(len, polygons), default=0) > model.MAX_POINTS // 4:
        into.note("where a mask has very many parts, holes or corners, the largest are kept")
    return [tuple((x + corner[0] + left, y + corner[1] + top) for x, y in polygon) for polygon in polygons]


def _write_davis(annotation: model.Annotation, regions: Regions, names: Sequence[str]) -> bytes:
    values = {o.id: _DAVIS_VOID if o.motion == model.REJECT else int(o.motion) for o in annotation.objects}
    images, palette = _painted(annotation, regions, values, "DAVIS", _DAVIS_VOID - 1), davis_palette()
    return _zipped((encode_indices(image.astype(np.uint8), palette) for image in images), names)


def _write_mots_png(annotation: model.Annotation, regions: Regions, names: Sequence[str]) -> bytes:
    images = _painted(annotation, regions, _mots_values(annotation), "MOTS", MOTS_CLASS - 1)
    return _zipped((cv2.imencode(".png", image.astype(np.uint16))[1].tobytes() for image in images), names)


def _write_mots_text(annotation: model.Annotation, regions: Regions, names: Sequence[str]) -> bytes:
    width, height = annotation.image_size
    images = _painted(annotation, regions, _mots_values(annotation), "MOTS", MOTS_CLASS - 1)
    lines = [
        f"{number_in(name)} {value} {value // MOTS_CLASS} {height} {width} {encode_rle(image == value)}\n"
        for name, image in zip(names, images, strict=True)
        for value in np.unique(image[image > 0]).tolist()
    ]
    return "".join(lines).encode()


def _mots_values(annotation: model.Annotation) -> dict[int, int]:
    """Values by object; those of one motion have one, with the class of the first."""
    values: dict[model.Motion, int] = {model.REJECT: MOTS_VOID, model.BACKGROUND: model.BACKGROUND}
    for item in annotation.objects:
        kind = _MOTS_CLASSES.get(item.kind, 1)
        if item.motion not in values:
            values[item.motion] = MOTS_CLASS * kind + int(item.motion)
    return {item.id: values[item.motion] for item in annotation.objects}


def _painted(
    annotation: model.Annotation, regions: Regions, values: Mapping[int, int], name: str, most: int
) -> Iterator[npt.NDArray[np.int64]]:
    if (largest := max(annotation.motions, default=0)) > most:
        raise InvalidValueError("motion", expected=f"at most {most}, as {name} can hold", found=str(largest))
    return label_images(annotation, regions, values)


def _zipped(files: Iterable[bytes], names: Sequence[str]) -> bytes:
    stems = (PurePosixPath(name).stem for name in names)
    return zip_bytes({f"{stem}.png": file for stem, file in zip(stems, files, strict=True)})


def _read_davis(content: bytes, into: Import) -> None:
    voids = _read_images(content, into, "DAVIS masks", bits=8)
    into.note("ids are the values of the masks")
    for value, item in _in_order(into):
        item.motion = model.REJECT if value in voids else 1 if value == 255 else value
        item.name = "rejected" if value in voids else f"motion {item.motion}"
        if value in voids:
            into.note(f"{value} is void and rejected")


def _read_mots_png(content: bytes, into: Import) -> None:
    _read_images(content, into, "MOTS masks", bits=16)
    _name_mots(into)


def _read_mots_text(content: bytes, into: Import) -> None:
    lines = content.decode("utf-8-sig", "replace").splitlines()
    into.count("lines", len(lines), model.MAX_OBJECTS * into.like.n_frames)
    found: list[tuple[str, tuple[int, int, int, int], str]] = []
    for number, line in enumerate(lines, start=1):
        with into.skipping(f"line {number}"):
            if match := _MOTS_LINE.fullmatch(line.strip()):
                frame, identity, height, width = map(int, match.groups()[:-1])
                into.check_shape(height, width, "size")
                found.append((f"line {number}", (frame, identity, height, width), match[5]))
            elif line.strip():
                expected = "frame id class height width rle"
                raise FileFormatError("", expected=expected, found=repr(line[:60]))
    frames = into.match(dict.fromkeys(str(numbers[0]) for _, numbers, _ in found), "MOTS text")
    into.annotated |= set(range(into.like.n_frames))
    for where, (frame, identity, height, width), text in found:
        with into.skipping(where):
            if str(frame) in frames:
                into.reading(frames[str(frame)], identity)
                into.count("pixels in masks", height * width // 8)  # decoding is cheap
                if outlines := outlines_of(into.fit(decode_rle(text, height, width, "rle"), "size"), into):
                    into.object(identity, ForeignObject(of_masks=True)).add(frames[str(frame)], outlines)
    _name_mots(into)


DAVIS = AnnotationFormat(".zip", "application/zip", _write_davis, _read_davis, "{:05d}.png")
MOTS_PNG = AnnotationFormat(".zip", "application/zip", _write_mots_png, _read_mots_png)
MOTS_TXT = AnnotationFormat(".txt", "text/plain", _write_mots_text, _read_mots_text)


def _read_images(content: bytes, into: Import, what: str, *, bits: int) -> list[int]:
    """Read a zip of PNGs of at most `bits` bits, whose numbers are objects; return which are void."""
    used = set()
    for frame, file, png in into.unzip(content, ".png", what):
        image, depth = decode_indices(png, f"{what}: {file}")
        if (depth > 8) != (bits > 8):
            expected = f"a{'' if bits > 8 else 'n indexed or'} gray PNG of {bits} bits"
            fix = f"import it as {'davis' if bits > 8 else 'mots_png'}"
            raise FileFormatError(f"{what}: {file}", expected=expected, found=f"{depth} bits", fix=fix)
        image = into.fit(image, f"{what}: {file}")
        into.annotated.add(frame)
        used |= {int(image.min())}
        for value, box in enumerate(ndimage.find_objects(image), start=1):
            if box is not None:
                outlines = outlines_of(image[box] == value, into, (box[1].start, box[0].start))
                into.object(value, ForeignObject(of_masks=True)).add(frame, outlines)
    return void_ids(used.union(map(int, into.found)), bits, what)


def _in_order(into: Import) -> list[tuple[int, ForeignObject]]:
    """Return the objects by value, and let them be numbered in that order."""
    found = sorted((int(value), item) for value, item in into.found.items())
    into.found = {str(value): item for value, item in found}
    return found


def _name_mots(into: Import) -> None:
    found = _in_order(into)
    ignored = MOTS_VOID // MOTS_CLASS
    instances = [value % MOTS_CLASS for value, _ in found if value // MOTS_CLASS != ignored]
    unique = len(set(instances)) == len(instances) and min(instances, default=1) > 0
    for number, (value, item) in enumerate(found, start=1):
        kind, instance = divmod(value, MOTS_CLASS)
        item.kind = _MOTS_KIND.get(kind, "other")
        item.motion = model.REJECT if kind == ignored else instance if unique else number
        item.name = "rejected" if kind == ignored else f"{item.kind} {value}"
