"""Dense point trajectories of a folder of frames.

Writes every trajectory, unlabelled, in the format that the suffix of FILE names (.h5, .mat, .npz, .dat).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kt3dmoseg.tracking import Progress


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    from kt3dmoseg.options import add_arguments, add_parameters
    from kt3dmoseg.tracking.options import TrackOptions

    parser.add_argument("frames", metavar="FRAMES", help="folder of frames")
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help="file to write")
    parser.add_argument("--flow", default="dis", metavar="NAME", help="optical flow (default: dis)")
    add_parameters(parser, "the optical flow")
    parser.add_argument("--cache", metavar="FOLDER", help="keep and reuse flow fields here")
    parser.add_argument(
        "--colour",
        choices=("refuse", "luma"),
        default="refuse",
        help="colour frames: refuse them, or take their luma (default: refuse)",
    )
    add_arguments(parser, TrackOptions)


def run(arguments: argparse.Namespace) -> None:
    """Track and write."""
    from dataclasses import asdict
    from pathlib import Path

    from kt3dmoseg.files import check_writable
    from kt3dmoseg.flow import create
    from kt3dmoseg.io import save
    from kt3dmoseg.io.formats import written_as
    from kt3dmoseg.options import from_namespace, parse_assignments
    from kt3dmoseg.tracking import TrackOptions, track_clip

    options = asdict(from_namespace(TrackOptions, arguments))
    flow = create(arguments.flow, **parse_assignments(arguments.parameter))
    written_as(arguments.output)
    check_writable(Path(arguments.output).parent)
    with _bar() as progress:
        clip = track_clip(
            arguments.frames,
            flow,
            colour=arguments.colour,
            cache=arguments.cache,
            progress=progress,
            **options,
        )
    save(clip, arguments.output)
    print(f"{arguments.output}: {len(clip.dense)} trajectories in {clip.n_frames} frames")


@contextmanager
def _bar() -> Iterator[Progress]:
    """Show a bar on a terminal, and nothing elsewhere."""
    from tqdm import tqdm

    with tqdm(unit="frame", disable=None) as bar:

        def progress(done: int, total: int | None) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield progress
