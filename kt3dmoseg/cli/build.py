"""Frames to dataset files: track, label, subsample; one HDF5 file per clip.

PATH is a folder with one folder of frames per clip, the frames of one clip, a video file, or a
KITTI raw root: the clips that pull or locate noted in its located.toml, else one clip per drive, or one
of your choice with --date, --drive, --camera and --range. Clips whose file is up to date are skipped; an
interrupted build is finished by the same command. Exit code 2 when a clip failed, after the others are
built.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kt3dmoseg.pipeline import Outcome, Source

_ANNOTATIONS = "annotations"
_FAILED = 2


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    from kt3dmoseg.options import add_arguments, add_parameters
    from kt3dmoseg.pipeline.options import BuildOptions
    from kt3dmoseg.tracking.options import TrackOptions

    parser.add_argument(
        "--frames", required=True, metavar="PATH", help="clips, one clip, a video or a KITTI raw root"
    )
    parser.add_argument("-o", "--output", metavar="FOLDER", required=True, help="folder of the files CLIP.h5")
    parser.add_argument(
        "--annotations",
        metavar="FOLDER",
        help=f"labels: FOLDER/CLIP.json (default: ./{_ANNOTATIONS} when it exists; 'none' for no labels)",
    )
    parser.add_argument(
        "--masks", metavar="FOLDER", help="labels: FOLDER/CLIP/*.png, DAVIS indexed or KITTI MOTS"
    )
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: one per core)")
    parser.add_argument("--force", action="store_true", help="build also what is up to date")
    add_parameters(parser, "the optical flow")
    parser.add_argument("--cache", metavar="FOLDER", help="keep and reuse flow fields here")
    kitti = parser.add_argument_group("one clip of a KITTI raw root")
    kitti.add_argument("--date", help="day of the drive, 2011_09_26")
    kitti.add_argument("--drive", help="number of the drive, 5 or 0005")
    kitti.add_argument("--camera", type=int, default=0, help="0, 1 gray; 2, 3 colour (default: 0)")
    kitti.add_argument("--range", metavar="FIRST-LAST", help="frame numbers, both included")
    kitti.add_argument("--name", default="", help="name of the clip (default: drive and range)")
    add_arguments(parser, BuildOptions)
    add_arguments(parser, TrackOptions)


def run(arguments: argparse.Namespace) -> int:
    """Build and report clip by clip."""
    from kt3dmoseg.options import option_names, parse_assignments
    from kt3dmoseg.pipeline import BuildOptions, build_dataset
    from kt3dmoseg.tracking import TrackOptions

    names = [*option_names(BuildOptions), *option_names(TrackOptions)]
    sources = _sources(arguments)
    with _Bars(len(sources)) as bars:
        outcomes = build_dataset(
            sources,
            arguments.output,
            annotations=_annotations(arguments.annotations),
            masks=arguments.masks,
            workers=arguments.workers,
            force=arguments.force,
            flow_parameters=parse_assignments(arguments.parameter),
            cache=arguments.cache,
            progress=bars.frame,
            report=bars.clip,
            **{name: getattr(arguments, name) for name in names if hasattr(arguments, name)},
        )
    failed = sum(outcome.status == "failed" for outcome in outcomes)
    built = sum(outcome.status == "built" for outcome in outcomes)
    _warn_of_empty(outcomes, getattr(arguments, "min_length", TrackOptions.min_length))
    print(f"{built} built, {len(outcomes) - built - failed} up to date, {failed} failed: {arguments.output}")
    return _FAILED if failed else 0


def _sources(arguments: argparse.Namespace) -> list[Source]:
    from kt3dmoseg.pipeline import find_sources, kitti_sources

    chosen = (arguments.date, arguments.drive, arguments.range, arguments.camera or None, arguments.name)
    if not any(chosen):
        return find_sources(arguments.frames)
    return kitti_sources(
        arguments.frames,
        date=arguments.date,
        drive=arguments.drive,
        camera=arguments.camera,
        frames=arguments.range,
        name=arguments.name,
    )


def _annotations(given: str | None) -> str | None:
    if given is None:
        return _ANNOTATIONS if Path(_ANNOTATIONS).is_dir() else None
    return None if given == "none" else given


def _warn_of_empty(outcomes: list[Outcome], min_length: int | str) -> None:
    import sys

    empty = [o for o in outcomes if o.status == "built" and not o.counts["trajectories"]]
    if empty:
        names = ", ".join(f"{outcome.name} ({outcome.counts['frames']} frames)" for outcome in empty)
        print(
            f"kt3dmoseg: warning: no trajectories in {names}; a track must live --min-length {min_length} "
            "frames, and starts only where the picture has structure",
            file=sys.stderr,
        )


class _Bars:
    """Progress per clip and per frame, and a line per clip."""

    def __init__(self, clips: int) -> None:
        from tqdm import tqdm

        self.clips = tqdm(total=clips, unit="clip", desc="clips", disable=None, position=0)
        self.frames = tqdm(unit="frame", desc="frames", disable=None, position=1, leave=False)

    def __enter__(self) -> _Bars:
        return self

    def __exit__(self, *_: object) -> None:
        self.frames.close()
        self.clips.close()

    def frame(self, clip: str, done: int, total: int | None) -> None:
        self.frames.set_postfix_str(f"{clip} {done}/{total or '?'}", refresh=False)
        self.frames.update()

    def clip(self, outcome: Outcome) -> None:
        import sys

        numbers = ", ".join(f"{count} {what}" for what, count in outcome.counts.items())
        line = f"{outcome.name}: {outcome.status}" + (f" ({outcome.reason})" if outcome.reason else "")
        if outcome.status == "failed":
            self.clips.write(f"kt3dmoseg: {outcome.name} failed: {outcome.reason}", file=sys.stderr)
        else:
            self.clips.write(f"{line}: {numbers}" if numbers else line)
            sys.stdout.flush()  # a log file shall tell how far a long build is
        self.clips.update()
