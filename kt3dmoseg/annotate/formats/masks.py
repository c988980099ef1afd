"""Regions as masks and back.

Both ways are exact: the outline of a mask runs along the edges of its pixels, so that exactly the
pixels whose centres lie inside belong to it. A hole is joined to the outline around it by a slit of no width.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from kt3dmoseg.annotate.geometry import area, bounds, inside
from kt3dmoseg.annotate.model import (
    BACKGROUND,
    MAX_POINTS,
    MAX_POLYGONS,
    REJECT,
    AnnotatedObject,
    Annotation,
    Polygon,
)
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.types import BoolArray, FloatArray

Corner = tuple[int, int]

# Step to the neighbour that is not in the mask -> the edge between, clockwise around the pixel.
_EDGES: dict[Corner, tuple[Corner, Corner]] = {
    (-1, 0): ((0, 0), (1, 0)),
    (0, 1): ((1, 0), (1, 1)),
    (1, 0): ((1, 1), (0, 1)),
    (0, -1): ((0, 1), (0, 0)),
}


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
    """Return the outlines of a mask, one polygon per 4-connected part.

    Of more parts than a region may have, the largest; of more corners than a polygon may have, every
    second, or third...

    Parameters
    ----------
    mask : (H, W) bool
        The pixels.
    tolerance : float
        Leave out corners closer than this to the simplified outline, pixels; 0 = exact.
    """
    parts, _ = ndimage.label(mask)
    boxes = ndimage.find_objects(parts)
    sizes = np.bincount(parts.ravel())[1:]
    out = []
    # In reading order; of more parts than a region may have, the largest.
    for k in np.sort(np.argsort(-sizes, kind="stable")[:MAX_POLYGONS]):
        rows, columns = boxes[k]
        loops = [_straightened(loop) for loop in _loops(parts[rows, columns] == k + 1)]
        joined = _joined(loops) + np.array([columns.start - 0.5, rows.start - 0.5])
        simple = simplify(joined, tolerance) if tolerance > 0 else joined
        simple = simple[:: -(-len(simple) // MAX_POINTS)]
        if len(simple) >= 3:
            out.append(tuple((float(x), float(y)) for x, y in simple))
    return out


def simplify(polygon: FloatArray, tolerance: float) -> FloatArray:
    """Leave out points that are within `tolerance` pixels of the outline without them.

    Douglas and Peucker (1973), between the two points that are farthest apart.
    """
    start = int(np.argmax(((polygon - polygon[0]) ** 2).sum(axis=1)))
    turned = np.roll(polygon, -start, axis=0)
    middle = int(np.argmax(((turned - turned[0]) ** 2).sum(axis=1)))
    closed = np.concatenate([turned, turned[:1]])
    kept = {0, middle}
    stack = [(0, middle), (middle, len(polygon))]
    while stack:
        first, last = stack.pop()
        if last - first < 2:
            continue
        gap = _distance_to_segment(closed[first + 1 : last], closed[first], closed[last])
        worst = int(np.argmax(gap))
        if gap[worst] > tolerance:
            middle = first + 1 + worst
            kept.add(middle)
            stack += [(first, middle), (middle, last)]
    return turned[sorted(kept)]


def label_image(
    annotation: Annotation, regions: Mapping[int, list[Region]], frame: int, values: Mapping[int, int]
) -> npt.NDArray[np.int64]:
    """Paint the visible objects of one frame into an image.

    Parameters
    ----------
    annotation, regions
        The objects and their regions in every frame.
    frame : int
        Which frame.
    values : mapping of object id to int
        Value to paint; 0 = background. Later objects cover earlier ones, static ones cover moving
        ones, rejected ones cover all, as in `label_tracks`.
    """
    width, height = annotation.image_size
    image = np.zeros((height, width), dtype=np.int64)
    for item in sorted(annotation.objects, key=_layer):
        region = regions[item.id][frame]
        if region.visibility == "visible":
            image[mask_of(region.polygons, annotation.image_size)] = values[item.id]
    return image


def check_shape(shape: tuple[int, ...], like: Annotation, where: str) -> None:
    """Refuse a mask of another size than the clip's frames.

    Raises
    ------
    FileFormatError
    """
    width, height = like.image_size
    if shape != (height, width):
        raise FileFormatError(where, expected=f"a mask of {width}x{height} pixels", found=f"shape {shape}")


def check_frame(frame: int, like: Annotation, where: str) -> None:
    """Refuse a frame that the clip does not have.

    Raises
    ------
    FileFormatError
    """
    if not 0 <= frame < like.n_frames:
        raise FileFormatError(where, expected=f"frames 0 to {like.n_frames - 1}", found=f"frame {frame}")


def _layer(item: AnnotatedObject) -> int:
    return 2 if item.motion == REJECT else int(item.motion == BACKGROUND)


def _loops(part: BoolArray) -> list[list[Corner]]:
    """Return closed walks along the pixel edges of a mask, the mask on the right hand."""
    padded = np.pad(part, 1)
    leave: dict[Corner, list[Corner]] = {}
    for (dy, dx), (start, end) in _EDGES.items():
        rows, columns = np.nonzero(padded & ~np.roll(padded, (-dy, -dx), axis=(0, 1)))
        for y, x in zip((rows - 1).tolist(), (columns - 1).tolist(), strict=True):
            leave.setdefault((x + start[0], y + start[1]), []).append((x + end[0], y + end[1]))
    loops = []
    while leave:
        first = next(iter(leave))
        loops.append(_walk(leave, first))
    return loops


def _walk(leave: dict[Corner, list[Corner]], first: Corner) -> list[Corner]:
    loop, at, heading = [first], first, (0, 0)
    while True:
        ways = leave[at]
        # Turning right keeps to the same pixel, so that pixels touching at a corner stay apart.
        right = (at[0] - heading[1], at[1] + heading[0])
        after = right if right in ways else ways[0]
        ways.remove(after)
        if not ways:
            del leave[at]
        heading, at = (after[0] - at[0], after[1] - at[1]), after
        if at == first:
            return loop
        loop.append(at)


def _straightened(loop: list[Corner]) -> FloatArray:
    points = np.array(loop, dtype=np.float64)
    before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    corner = before[:, 0] * after[:, 1] != before[:, 1] * after[:, 0]
    return np.asarray(points[corner])


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


def _distance_to_segment(points: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    edge = b - a
    share = np.clip((points - a) @ edge / max(float(edge @ edge), 1e-12), 0.0, 1.0)
    return np.asarray(np.hypot(*(points - a - share[:, None] * edge).T))
