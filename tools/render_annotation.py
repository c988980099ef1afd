"""Draw an annotation on its frames, to check it by eye.

    tools/render_annotation.py annotations/CLIP.json --frames FRAMES/CLIP --tracks out/CLIP.h5 -o pictures/

writes one overview per frame, and per object a sheet of enlarged crops of all frames, with rulers in
pixels. Thick outlines with dots were drawn by a person, thin ones are propagated.

    tools/render_annotation.py --frames FRAMES/Seq005_Clip01 --crop 3:500,150,700,300 --zoom 6 -o out/

enlarges a part of frame 3 (0-based) for reading coordinates; with an annotation, its regions too.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from overlay import Box, contact_sheets, draw_view

from kt3dmoseg import io
from kt3dmoseg.annotate import Annotation, Region, TrackMotion, propagate
from kt3dmoseg.annotate.geometry import bounds
from kt3dmoseg.annotate.model import AnnotatedObject, load_annotation
from kt3dmoseg.errors import InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import write_bytes
from kt3dmoseg.io.images import frame_paths, read_frame
from kt3dmoseg.types import ByteArray

# Screen pixels: the widest crop of an object's sheet.
_TILE = 490
Shown = list[tuple[AnnotatedObject, Region]]


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("annotation", nargs="?", type=Path, help="an annotation, <clip>.json")
    parser.add_argument("--frames", type=Path, required=True, help="folder of the clip's frames")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the pictures")
    parser.add_argument("--zoom", type=float, default=4.0, help="enlargement of the crops (default: 4)")
    parser.add_argument("--padding", type=float, default=12.0, help="pixels around an object (default: 12)")
    parser.add_argument("--object", type=int, action="append", help="only this object id; may be repeated")
    parser.add_argument(
        "--crop",
        action="append",
        default=[],
        metavar="FRAME:X0,Y0,X1,Y1",
        help="only this part; may be repeated",
    )
    parser.add_argument(
        "--tracks",
        type=Path,
        help="trajectories that carry the regions, needed with an annotation",
    )
    arguments = parser.parse_args(argv)
    try:
        return _render(arguments)
    except KT3DMoSegError as error:
        print(f"render_annotation: {error}", file=sys.stderr)
        return error.exit_code


def _render(arguments: argparse.Namespace) -> int:
    frames = [read_frame(path) for path in frame_paths(arguments.frames)]
    shown: list[Shown] = [[] for _ in frames]
    name = arguments.frames.name
    if arguments.annotation:
        annotation = load_annotation(arguments.annotation)
        _check(annotation, frames)
        name = annotation.clip
        if not arguments.tracks:
            raise InvalidValueError("--tracks", expected="those that carry the regions", found="none")
        shown = _regions(annotation, TrackMotion(io.load(arguments.tracks).dense), arguments.object)
    for text in arguments.crop:
        number, box = _crop(text, len(frames))
        picture = draw_view(frames[number], box, arguments.zoom, shown[number], title=f"frame {number}")
        _write(arguments.output / f"{name}_f{number:03d}_{box[0]:.0f}_{box[1]:.0f}.png", picture)
    if not arguments.crop:
        _overviews(arguments.output, name, frames, shown)
        _sheets(arguments.output, name, frames, shown, arguments.zoom, arguments.padding)
    return 0


def _regions(annotation: Annotation, motion: TrackMotion, only: list[int] | None) -> list[Shown]:
    regions = propagate(annotation, motion)
    items = [item for item in annotation.objects if not only or item.id in only]
    return [[(item, regions[item.id][frame]) for item in items] for frame in range(annotation.n_frames)]


def _overviews(folder: Path, name: str, frames: list[ByteArray], shown: list[Shown]) -> None:
    for number, (frame, items) in enumerate(zip(frames, shown, strict=True)):
        box = (0.0, 0.0, frame.shape[1] - 1.0, frame.shape[0] - 1.0)
        picture = draw_view(frame, box, 1.25, items, title=f"{name} frame {number}")
        _write(folder / f"{name}_f{number:03d}.png", picture)


def _sheets(
    folder: Path, name: str, frames: list[ByteArray], shown: list[Shown], zoom: float, padding: float
) -> None:
    for k, (item, _) in enumerate(shown[0]):
        seen = [number for number, items in enumerate(shown) if items[k][1].polygons]
        if not seen:
            continue
        widest = max(np.ptp(bounds(shown[number][k][1].polygons)[::2]) + 2 * padding for number in seen)
        scale = min(zoom, _TILE / widest)
        tiles = []
        for number in seen:
            region = shown[number][k][1]
            left, top, right, bottom = bounds(region.polygons)
            box = (left - padding, top - padding, right + padding, bottom + padding)
            title = f"frame {number}" + (" KEY" if region.key else "")
            tiles.append(draw_view(frames[number], box, scale, shown[number], title=title))
        for page, sheet in enumerate(contact_sheets(tiles)):
            _write(folder / f"{name}_object{item.id:02d}_{page}.png", sheet)


def _crop(text: str, n_frames: int) -> tuple[int, Box]:
    try:
        frame, _, box = text.partition(":")
        left, top, right, bottom = (float(value) for value in box.split(","))
        number = int(frame)
        if not (0 <= number < n_frames and left < right and top < bottom):
            raise ValueError
    except ValueError:
        expected = f"FRAME:X0,Y0,X1,Y1 with a frame in 0..{n_frames - 1}"
        raise InvalidValueError("--crop", expected=expected, found=repr(text)) from None
    return number, (left, top, right, bottom)


def _check(annotation: Annotation, frames: list[ByteArray]) -> None:
    size = (frames[0].shape[1], frames[0].shape[0])
    if (annotation.n_frames, annotation.image_size) != (len(frames), size):
        raise InvalidValueError(
            f"frames of {annotation.clip}",
            expected=f"{annotation.n_frames} of {annotation.image_size}, as annotated",
            found=f"{len(frames)} of {size}",
        )


def _write(path: Path, picture: ByteArray) -> None:
    write_bytes(path, cv2.imencode(".png", picture)[1].tobytes())
    print(path)


if __name__ == "__main__":
    raise SystemExit(main())
