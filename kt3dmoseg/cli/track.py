"""Dense point trajectories of a folder of frames.

Writes every trajectory, unlabelled, in the format that the suffix of FILE names (.h5, .mat, .npz, .dat).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kt3dmoseg.tracks import Progress


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    from kt3dmoseg.options import add_arguments, add_parameters
    from kt3dmoseg.tracks.options import TrackOptions

    parser.add_argument("frames", metavar="FRAMES", help="folder of gray frames")
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help="file to write")
    parser.add_argument("--flow", default="dis", metavar="NAME", help="optical flow (default: dis)")
    add_parameters(parser, "the optical flow")
    parser.add_argument("--cache", metavar="FOLDER", help="keep and reuse flow fields here")
    add_arguments(parser, TrackOptions)


def run(arguments: argparse.Namespace) -> None:
    """Track and write."""
    from dataclasses import asdict

    from kt3dmoseg.flow import create
    from kt3dmoseg.io import save
    from kt3dmoseg.options import from_namespace, parse_assignments
    from kt3dmoseg.tracks import TrackOptions, track_clip

    options = asdict(from_namespace(TrackOptions, arguments))
    flow = create(arguments.flow, **parse_assignments(arguments.parameter))
    with _bar() as progress:
        clip = track_clip(arguments.frames, flow, cache=arguments.cache, progress=progress, **options)
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
