"""Draw trajectories with their trails on the frames, as pictures or a short video.

CLIP is any clip file. PATH is a folder (one PNG per frame), a single .png (of --at), or .mp4, .avi,
.gif, .apng, .webp.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from kt3dmoseg.draw import Painting
    from kt3dmoseg.types import ByteArray, Clip

_PICTURE = ".png"
_SLOWEST, _FASTEST = 0.1, 240.0  # pictures per second


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    from kt3dmoseg.draw import DrawOptions
    from kt3dmoseg.options import add_arguments

    parser.add_argument("clip", metavar="CLIP", help="clip file")
    parser.add_argument(
        "-o", "--output", metavar="PATH", help="where to write (default: CLIP's name, a folder)"
    )
    parser.add_argument(
        "--frames", metavar="FOLDER", help="frames, a folder with FOLDER/CLIP, or a KITTI raw root"
    )
    parser.add_argument(
        "--by",
        choices=("label", "length", "prediction"),
        help="what colours tell (default: label, if labelled)",
    )
    parser.add_argument("--pred", metavar="FILE", help="predicted labels: .csv track,label, .npz or .h5")
    parser.add_argument("--at", type=int, metavar="I", help="only frame I of the clip, counted from 0")
    parser.add_argument("--rate", type=float, default=5.0, help="pictures per second of a video (default: 5)")
    add_arguments(parser, DrawOptions)


def run(arguments: argparse.Namespace) -> None:
    """Load, draw, write."""
    from kt3dmoseg.draw import DrawOptions, draw_frame
    from kt3dmoseg.errors import InvalidValueError
    from kt3dmoseg.io import load
    from kt3dmoseg.io.fields import check_name
    from kt3dmoseg.options import from_namespace

    options = from_namespace(DrawOptions, arguments)
    if not _SLOWEST <= arguments.rate <= _FASTEST:  # nor NaN
        expected = f"a number above 0, from {_SLOWEST:g} to {_FASTEST:g}"
        raise InvalidValueError("--rate", expected=expected, found=f"{arguments.rate}")
    clip = load(arguments.clip)
    check_name(clip.name, f"{arguments.clip}: name")
    output = _output(arguments.output or clip.name)
    if not clip.n_frames:
        raise InvalidValueError(arguments.clip, expected="a clip with frames", found="none")
    if arguments.at is not None and not 0 <= arguments.at < clip.n_frames:
        raise InvalidValueError("--at", expected=f"0..{clip.n_frames - 1}", found=str(arguments.at))
    painting = _painting(clip, arguments)
    pictures = _pictures(clip, arguments.frames)

    def drawn(frame: int) -> ByteArray:
        title = f"{clip.name}  frame {frame + 1}/{clip.n_frames}"
        return draw_frame(painting, frame, pictures[frame] if pictures else None, title, options)

    print(_write(clip, output, arguments, drawn))


def _output(path: str) -> Path:
    """Refuse a suffix that nothing is written as, before anything is drawn."""
    from kt3dmoseg.errors import InvalidValueError
    from kt3dmoseg.io.video import MOVING_SUFFIXES

    output = Path(path)
    if not output.is_dir() and output.suffix.lower() not in ("", _PICTURE, *MOVING_SUFFIXES):
        known = ", ".join((*MOVING_SUFFIXES, _PICTURE))
        raise InvalidValueError(
            path, expected=f"a suffix of {known}, or none for a folder", found=repr(output.suffix)
        )
    return output


def _painting(clip: Clip, arguments: argparse.Namespace) -> Painting:
    from kt3dmoseg.draw import by_label, by_length, by_prediction
    from kt3dmoseg.errors import InvalidValueError
    from kt3dmoseg.io.predictions import read_prediction

    by = arguments.by or ("prediction" if arguments.pred else "label" if clip.n_motions else "length")
    if by == "prediction" and not arguments.pred:
        raise InvalidValueError("--by prediction", expected="--pred FILE", found="none")
    if by == "prediction":
        return by_prediction(clip, read_prediction(arguments.pred, clip))
    return by_label(clip, clip.labels.label, clip.labels.names) if by == "label" else by_length(clip.dense)


def _pictures(clip: Clip, folder: str | None) -> list[ByteArray]:
    """Gray frames of the clip; none when no folder is given."""
    from kt3dmoseg.frames import frames_of

    return [] if folder is None else frames_of(clip, folder)


def _write(clip: Clip, output: Path, arguments: argparse.Namespace, drawn: Callable[[int], ByteArray]) -> str:
    from kt3dmoseg.io.video import write_moving, write_png

    chosen = range(clip.n_frames) if arguments.at is None else [arguments.at]
    suffix = "" if output.is_dir() else output.suffix.lower()
    if suffix == _PICTURE:
        middle = arguments.at if arguments.at is not None else clip.n_frames // 2
        write_png(output, drawn(middle))
    elif suffix:
        write_moving(output, map(drawn, chosen), arguments.rate)
    else:
        for frame in chosen:
            write_png(output / f"{clip.name}_{frame + 1:06d}.png", drawn(frame))
    count = 1 if suffix == _PICTURE else len(chosen)
    return f"{output}: {clip.name}, {count} picture{'s' * (count > 1)}"
