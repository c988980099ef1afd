"""Pictures of regions on frames, enlarged on request, with rulers in pixels; matplotlib draws them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from kt3dmoseg.annotate.geometry import bounds
from kt3dmoseg.annotate.model import AnnotatedObject
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.draw.palette import REJECTED, css, label_colour
from kt3dmoseg.types import ByteArray

Box = tuple[float, float, float, float]

# A power of two, so that sizes in inches give whole pixels.
_DPI = 64
_TOP, _LEFT = 26, 36
_TICK = 60
_TEXT: dict[str, Any] = {"bbox": {"color": "black", "alpha": 0.5, "pad": 1}, "parse_math": False}


def draw_view(
    frame: ByteArray,
    box: Box,
    scale: float,
    shown: Iterable[tuple[AnnotatedObject, Region]] = (),
    *,
    title: str = "",
) -> ByteArray:
    """Draw a part of a gray frame (H, W) with the outlines of regions and rulers in pixels.

    The box (left, top, right, bottom) in pixels may reach beyond the frame. Outlines are thick with dots
    where a person drew, thin where propagated. Returns (h, w, 3) uint8, BGR.
    """
    left, top, right, bottom = (round(value) for value in box)
    width, height = max(1, round((right - left + 1) * scale)), max(1, round((bottom - top + 1) * scale))
    figure = Figure(((width + _LEFT) / _DPI, (height + _TOP) / _DPI), dpi=_DPI, facecolor="#282828")
    axes = figure.add_axes((_LEFT / (width + _LEFT), 0, width / (width + _LEFT), height / (height + _TOP)))
    # The full range of gray: street scenes have dark corners where objects hide.
    seen = frame[max(0, top) : bottom + 1, max(0, left) : right + 1]
    low, high = np.percentile(seen, (0.5, 99.5)) if seen.size else (0.0, 255.0)
    axes.imshow(frame, "gray", vmin=low, vmax=max(high, low + 1), aspect="auto", interpolation="bicubic")
    for item, region in shown:
        _outline(axes, item, region)
    axes.set(facecolor="black", xlim=(left - 0.5, right + 0.5), ylim=(bottom + 0.5, top - 0.5))
    axes.xaxis.tick_top()
    axes.tick_params(colors="white", labelsize=9, pad=1)
    for axis, length in ((axes.xaxis, width), (axes.yaxis, height)):
        axis.set_major_locator(MaxNLocator(max(1, length // _TICK), steps=[1, 2, 5, 10], integer=True))
    axes.text(0.01, 0.99, title, color="white", va="top", transform=axes.transAxes, **_TEXT)
    drawn = BytesIO()
    figure.savefig(drawn, format="rgba", dpi=_DPI)
    pixels = np.frombuffer(drawn.getvalue(), dtype=np.uint8)
    return pixels.reshape(height + _TOP, width + _LEFT, 4)[..., 2::-1].copy()


def contact_sheets(tiles: Sequence[ByteArray]) -> list[ByteArray]:
    """Arrange pictures in rows on sheets of at most 1600 x 1500 screen pixels, or one picture."""
    high, wide = np.max([tile.shape[:2] for tile in tiles], axis=0)
    columns, rows = max(1, 1600 // wide), max(1, 1500 // high)
    even = np.zeros((-(-len(tiles) // columns) * columns, high, wide, 3), dtype=np.uint8)
    for cell, tile in zip(even, tiles, strict=False):
        cell[: tile.shape[0], : tile.shape[1]] = tile
    strips = [np.hstack(list(even[k : k + columns])) for k in range(0, len(even), columns)]
    return [np.vstack(strips[k : k + rows]) for k in range(0, len(strips), rows)]


def _outline(axes: Axes, item: AnnotatedObject, region: Region) -> None:
    rejected = isinstance(item.motion, str)  # else motion m has label m + 1
    colour = css(REJECTED if rejected else label_colour(item.motion + 1, background=1))
    width, dot = (2.2, "o") if region.key else (1.1, "")
    for polygon in region.polygons:
        closed = np.vstack([polygon, polygon[:1]])
        axes.plot(*closed.T, color=colour, linewidth=width, marker=dot, markersize=4)
    if region.polygons:
        hidden = " (occluded)" if region.visibility == "occluded" else ""
        text = f"{item.motion}: {item.name}{hidden}"
        corner = bounds(region.polygons)[:2]
        axes.annotate(text, corner, color=colour, va="bottom", clip_on=True, **_TEXT)
