"""Pictures of regions on frames, enlarged on request, with rulers in pixels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import floor

import cv2
import numpy as np

from kt3dmoseg.annotate.geometry import bounds
from kt3dmoseg.annotate.model import AnnotatedObject
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.draw.palette import Colour, motion_colour
from kt3dmoseg.types import ByteArray, FloatArray

Box = tuple[float, float, float, float]

_INK: Colour = (255, 255, 255)
_RULER = 26
_SUBPIXEL = 4
_TICK = 60


@dataclass(frozen=True)
class View:
    """A part of a frame and how much it is enlarged.

    Parameters
    ----------
    box : (left, top, right, bottom)
        Pixels; may reach beyond the frame.
    scale : float
        Screen pixels per pixel.
    """

    box: Box
    scale: float

    def to_screen(self, points: FloatArray) -> FloatArray:
        """Screen positions (n, 2) of pixel positions; a pixel's centre maps to its square's centre."""
        return np.asarray((points - self.box[:2] + 0.5) * self.scale - 0.5)


def draw_view(
    frame: ByteArray, view: View, shown: Iterable[tuple[AnnotatedObject, Region]] = (), *, title: str = ""
) -> ByteArray:
    """Draw a part of a gray frame (H, W) with the outlines of regions and rulers in pixels.

    Outlines are solid where drawn by a person, thin where propagated. Returns (h, w, 3) uint8, BGR.
    """
    canvas = _enlarged(frame, view)
    for item, region in shown:
        _outline(canvas, view, item, region)
    framed = np.full((canvas.shape[0] + _RULER, canvas.shape[1] + _RULER + 10, 3), 40, dtype=np.uint8)
    framed[_RULER:, _RULER + 10 :] = canvas
    _rulers(framed, view)
    if title:
        _write(framed, title, (_RULER + 16, _RULER + 16), _INK, 0.5)
    return framed


def view_around(region: Region, *, padding: float, scale: float) -> View:
    """Give a view around a region with some surroundings, in pixels."""
    left, top, right, bottom = bounds(region.polygons)
    return View((floor(left - padding), floor(top - padding), right + padding, bottom + padding), scale)


def contact_sheets(tiles: Sequence[ByteArray], width: int = 1600, height: int = 1500) -> list[ByteArray]:
    """Arrange pictures in rows on sheets of at most `width` x `height` screen pixels, or one picture."""
    return _strips(_strips(tiles, width, axis=1), height, axis=0)


def _strips(pictures: Sequence[ByteArray], limit: int, axis: int) -> list[ByteArray]:
    """Join pictures along an axis, beginning another strip at the limit; strips are of one size across."""
    across = max(picture.shape[1 - axis] for picture in pictures)
    strips: list[list[ByteArray]] = [[]]
    for picture in pictures:
        missing = [(0, 0), (0, 0), (0, 0)]
        missing[1 - axis] = (0, across - picture.shape[1 - axis])
        if strips[-1] and sum(p.shape[axis] for p in strips[-1]) + picture.shape[axis] > limit:
            strips.append([])
        strips[-1].append(np.pad(picture, missing))
    return [np.concatenate(strip, axis=axis) for strip in strips]


def _enlarged(frame: ByteArray, view: View) -> ByteArray:
    left, top, right, bottom = (round(v) for v in view.box)
    size = (max(1, round((right - left + 1) * view.scale)), max(1, round((bottom - top + 1) * view.scale)))
    part = np.zeros((bottom - top + 1, right - left + 1), dtype=np.uint8)
    y0, y1 = max(0, top), min(frame.shape[0], bottom + 1)
    x0, x1 = max(0, left), min(frame.shape[1], right + 1)
    if y1 > y0 and x1 > x0:
        # The full range of gray: street scenes have dark corners where objects hide.
        seen = frame[y0:y1, x0:x1]
        low, high = np.percentile(seen, (0.5, 99.5))
        stretched = np.clip((seen - low) * (255.0 / max(high - low, 1.0)), 0, 255)
        part[y0 - top : y1 - top, x0 - left : x1 - left] = stretched.astype(np.uint8)
    large = cv2.resize(part, size, interpolation=cv2.INTER_CUBIC if view.scale > 1 else cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(large, cv2.COLOR_GRAY2BGR))


def _outline(canvas: ByteArray, view: View, item: AnnotatedObject, region: Region) -> None:
    red, green, blue = motion_colour(item.motion)
    colour = blue, green, red
    for polygon in region.polygons:
        screen = view.to_screen(polygon)
        fixed = np.rint(screen * 2**_SUBPIXEL).astype(np.int32)[:, None]
        thickness = 2 if region.key else 1
        cv2.polylines(canvas, [fixed], True, colour, thickness, cv2.LINE_AA, _SUBPIXEL)
        if region.key:
            for x, y in np.rint(screen).astype(int):
                cv2.circle(canvas, (int(x), int(y)), 2, colour, -1, cv2.LINE_AA)
    if region.polygons:
        left, top = view.to_screen(np.array([bounds(region.polygons)[:2]]))[0]
        hidden = " (occluded)" if region.visibility == "occluded" else ""
        corner = (max(2, int(left)), max(12, int(top) - 4))
        _write(canvas, f"{item.motion}: {item.name}{hidden}", corner, colour, 0.42)


def _rulers(framed: ByteArray, view: View) -> None:
    step = next((s for s in (1, 2, 5, 10, 20, 50, 100, 200, 500) if s * view.scale >= _TICK), 1000)
    left, top, right, bottom = view.box
    offset = _RULER + 10
    for x in range(int(np.ceil(left / step)) * step, int(right) + 1, step):
        at = int(view.to_screen(np.array([[x, top]]))[0, 0]) + offset
        framed[_RULER - 5 : _RULER, at] = _INK
        _write(framed, str(x), (at - 9, 16), _INK, 0.38)
    for y in range(int(np.ceil(top / step)) * step, int(bottom) + 1, step):
        at = int(view.to_screen(np.array([[left, y]]))[0, 1]) + _RULER
        framed[at, offset - 5 : offset] = _INK
        _write(framed, str(y), (2, at + 4), _INK, 0.38)


def _write(picture: ByteArray, text: str, corner: tuple[int, int], colour: Colour, size: float) -> None:
    # OpenCV's fonts have ASCII only.
    plain = text.encode("ascii", "replace").decode()
    cv2.putText(picture, plain, corner, cv2.FONT_HERSHEY_SIMPLEX, size, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(picture, plain, corner, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
