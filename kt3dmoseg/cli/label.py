"""Outline the moving objects of a clip in the browser.

CLIP is a folder of frames, a clip file (.h5, .mat), or a dataset: a folder with one of these per clip.
The page opens on this machine only; annotations are saved to <clip>.json while you draw.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kt3dmoseg.annotate.server.clip_session import ClipSession
    from kt3dmoseg.types import ByteArray, Trajectories


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("clip", type=Path, metavar="CLIP", help="frames, a clip file, or a folder of them")
    parser.add_argument(
        "--frames",
        type=Path,
        metavar="FOLDER",
        help="frames of a clip file, a folder with those of all clips, or a KITTI raw root",
    )
    parser.add_argument(
        "--tracks", type=Path, metavar="PATH", help="clip file or folder of them with trajectories to show"
    )
    parser.add_argument(
        "--annotations",
        type=Path,
        metavar="FOLDER",
        default=Path("annotations"),
        help="where <clip>.json are (default: annotations)",
    )
    parser.add_argument("--annotator", default="", metavar="NAME", help="name written into what is saved")
    parser.add_argument(
        "--compare", type=Path, metavar="FOLDER", help="folder of another annotator's annotations"
    )
    parser.add_argument(
        "--masks", type=Path, metavar="FOLDER", help="folder of masks to propose regions from"
    )
    parser.add_argument(
        "--kitti", type=Path, metavar="FOLDER", help="KITTI raw root to propose regions from tracklets"
    )
    parser.add_argument(
        "--flow", default="dis", metavar="NAME", help="flow that computes missing trajectories (default: dis)"
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: 127.0.0.1)")
    parser.add_argument(
        "--port", type=int, default=0, metavar="N", help="port to listen on (default: a free one)"
    )
    parser.add_argument("--no-browser", action="store_true", help="print the address, open no browser")


def run(arguments: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C."""
    from kt3dmoseg.annotate.server.app import serve
    from kt3dmoseg.annotate.server.clip_session import ClipSession
    from kt3dmoseg.annotate.server.routes import Routes
    from kt3dmoseg.frames import find_clips

    _check(arguments)
    clips = find_clips(
        arguments.clip,
        annotations=arguments.annotations,
        frames=arguments.frames,
        tracks=arguments.tracks,
    )
    tracker = _tracker(arguments.flow)
    sessions = {name: ClipSession(source, tracker) for name, source in clips.items()}
    if len(sessions) == 1:
        _read_once(*sessions.values())
    routes = Routes(
        sessions,
        annotator=arguments.annotator,
        other=arguments.compare,
        masks=arguments.masks,
        kitti=arguments.kitti,
    )
    found = f"{len(clips)} clip{'s' * (len(clips) > 1)}; annotations in {arguments.annotations.resolve()}"
    ready = _announce(found, browse=not arguments.no_browser)
    serve(routes, host=arguments.host, port=arguments.port, ready=ready)
    return 0


def _check(arguments: argparse.Namespace) -> None:
    """Find what would only be missed later, on the page, or not at all."""
    from kt3dmoseg.errors import InputFileError
    from kt3dmoseg.flow import create

    create(arguments.flow)
    for name in ("frames", "tracks", "compare", "masks", "kitti"):
        place: Path | None = getattr(arguments, name)
        if place is not None and not place.exists():
            raise InputFileError(f"--{name} {place}", found="no such file or folder")


def _read_once(session: ClipSession) -> None:
    """Read the files of the only clip: what is wrong with them is told here; of several, on the page."""
    from collections import deque

    from kt3dmoseg.io import load
    from kt3dmoseg.io.images import read_frames

    deque(read_frames(session.source.frames, "luma"), maxlen=0)
    if session.source.tracks is not None:
        load(session.source.tracks)
    session.annotation()


def _tracker(flow: str) -> Callable[[Iterator[ByteArray], Callable[[int, int | None], None]], Trajectories]:
    def work(frames: Iterator[ByteArray], progress: Callable[[int, int | None], None]) -> Trajectories:
        from kt3dmoseg.tracking import track

        return track(frames, flow=flow, progress=progress)

    return work


def _announce(found: str, *, browse: bool) -> Callable[[str], None]:
    def ready(address: str) -> None:
        print(found)
        print(f"label at {address}  (Ctrl-C stops)", flush=True)
        if browse:
            import webbrowser

            webbrowser.open(address)

    return ready
