"""Looking at clips: trajectories drawn on their frames, and the labelling page in the browser."""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from kt3dmoseg.draw import DrawOptions
from kt3dmoseg.draw.painting import Painting, by_label, by_length, by_prediction, draw_frame
from kt3dmoseg.errors import InputFileError, InvalidValueError, KT3DMoSegError, MissingDependencyError
from kt3dmoseg.files import check_target, listed
from kt3dmoseg.flow import create
from kt3dmoseg.frames import check_frames, find_clips, frames_of
from kt3dmoseg.io import load
from kt3dmoseg.io.fields import check_name
from kt3dmoseg.io.formats import recognise
from kt3dmoseg.io.images import read_frames
from kt3dmoseg.io.predictions import read_prediction
from kt3dmoseg.io.video import MOVING_SUFFIXES, write_moving, write_png
from kt3dmoseg.options import from_mapping
from kt3dmoseg.types import ByteArray, Clip, Trajectories

if TYPE_CHECKING:
    from kt3dmoseg.annotate.server.clip_session import ClipSession

_PICTURE = ".png"
_SLOWEST, _FASTEST = 0.1, 240.0  # pictures per second


def show(
    clip: str | os.PathLike[str],
    frames: str | os.PathLike[str] | None = None,
    *,
    output: str | os.PathLike[str] | None = None,
    by: Literal["label", "length", "prediction"] | None = None,
    pred: str | os.PathLike[str] | None = None,
    at: int | None = None,
    rate: float = 5.0,
    report: Callable[[str], object] = print,
    **options: Any,  # noqa: ANN401  # fields of DrawOptions
) -> list[Path]:
    """Draw trajectories with their trails on the frames, as pictures or a short video.

    Parameters
    ----------
    clip : path
        A clip file.
    frames : path, optional
        The clip's frames, a folder with one folder of frames per clip, or a KITTI raw root; by default
        trajectories are drawn on black.
    output : path, optional
        A folder (one PNG per frame), a single .png (of `at`, by default the middle frame), or a .mp4, .avi,
        .gif, .apng or .webp; by default a folder of the clip's name.
    by : {"label", "length", "prediction"}, optional
        What colours show; by default the prediction when there is one, else the labels, else the length.
    pred : path, optional
        Predicted labels: .csv, .npz or .h5.
    at : int, optional
        Only this frame, counted from 0.
    rate : float
        Pictures per second of a video.
    report : callable
        Takes a line on what was written.
    **options
        Fields of `kt3dmoseg.draw.DrawOptions`.

    Returns
    -------
    list of Path
        The files that were written.

    Raises
    ------
    InputFileError, FileFormatError
        When a file cannot be read or written, or the frames are those of another clip.
    InvalidValueError, UnknownNameError
        For an option that makes no sense.
    """
    chosen = from_mapping(DrawOptions, options)
    if not _SLOWEST <= rate <= _FASTEST:  # nor NaN
        expected = f"a number above 0, from {_SLOWEST:g} to {_FASTEST:g}"
        raise InvalidValueError("--rate", expected=expected, found=f"{rate}")
    loaded = load(clip)
    check_name(loaded.name, f"{clip}: name")
    target = _target(Path(output or loaded.name))
    if not loaded.n_frames:
        raise InvalidValueError(f"{clip}", expected="a clip with frames", found="none")
    if at is not None and not 0 <= at < loaded.n_frames:
        raise InvalidValueError("--at", expected=f"0..{loaded.n_frames - 1}", found=str(at))
    painting = _painting(loaded, by, pred)
    pictures = [] if frames is None else frames_of(loaded, frames)

    def drawn(frame: int) -> ByteArray:
        title = f"{loaded.name}  frame {frame + 1}/{loaded.n_frames}"
        return draw_frame(painting, frame, pictures[frame] if pictures else None, title, chosen)

    suffix, paths = "" if target.is_dir() else target.suffix.lower(), [target]
    shown: Sequence[int] = range(loaded.n_frames) if at is None else [at]
    if suffix == _PICTURE:
        shown = [shown[len(shown) // 2]]
        write_png(target, drawn(shown[0]))
    elif suffix:
        write_moving(target, map(drawn, shown), rate)
    else:
        paths = [target / f"{loaded.name}_{frame + 1:06d}.png" for frame in shown]
        for frame, path in zip(shown, paths, strict=True):
            write_png(path, drawn(frame))
    report(f"{target}: {loaded.name}, {len(shown)} picture{'s' * (len(shown) > 1)}")
    return paths


def _target(path: Path) -> Path:
    """Refuse what nothing is written as, before anything is drawn."""
    if path.is_dir():
        return path
    if path.suffix.lower() not in ("", _PICTURE, *MOVING_SUFFIXES):
        known = ", ".join((*MOVING_SUFFIXES, _PICTURE))
        expected = f"a suffix of {known}, or none for a folder"
        raise InvalidValueError(f"{path}", expected=expected, found=repr(path.suffix))
    check_target(path)
    return path


def _painting(clip: Clip, by: str | None, prediction: str | os.PathLike[str] | None) -> Painting:
    by = by or ("prediction" if prediction else "label" if clip.n_motions else "length")
    if by == "prediction":
        if prediction is None:
            raise InvalidValueError("--by prediction", expected="--pred FILE", found="none")
        return by_prediction(clip, read_prediction(prediction, clip))
    return by_label(clip, clip.labels.label, clip.labels.names) if by == "label" else by_length(clip.dense)


def label(
    clip: str | os.PathLike[str],
    frames: str | os.PathLike[str] | None = None,
    *,
    tracks: str | os.PathLike[str] | None = None,
    annotations: str | os.PathLike[str] = "annotations",
    annotator: str = "",
    compare: str | os.PathLike[str] | None = None,
    masks: str | os.PathLike[str] | None = None,
    kitti: str | os.PathLike[str] | None = None,
    flow: str = "dis",
    host: str = "127.0.0.1",
    port: int = 0,
    no_browser: bool = False,
) -> None:
    """Outline the moving objects of a clip in the browser; returns when the page is stopped (Ctrl-C).

    Parameters
    ----------
    clip : path
        A folder of frames, a clip file, or a folder with one of these per clip.
    frames : path, optional
        The frames of a clip file, a folder with those of all clips, or a KITTI raw root.
    tracks : path, optional
        Clip file, or folder of them, with trajectories to show.
    annotations : path
        Folder of the files ``<clip>.json``.
    annotator : str
        Name written into what is saved.
    compare : path, optional
        Folder of another annotator's annotations.
    masks, kitti : path, optional
        Folder of masks, or KITTI raw root, to propose regions from.
    flow : str
        Optical flow that computes missing trajectories, a name of `kt3dmoseg.flow.list`.
    host, port
        Address to listen on; port 0 takes a free one.
    no_browser : bool
        Print the address, open no browser.

    Raises
    ------
    InputFileError, FileFormatError
        When a path does not exist or the files of the only clip are unfit; of several clips, a warning says
        so, and the page.
    MissingDependencyError
        When starlette or uvicorn is not installed.
    """
    try:
        from kt3dmoseg.annotate.server.app import serve
        from kt3dmoseg.annotate.server.clip_session import ClipSession
        from kt3dmoseg.annotate.server.routes import Routes
    except ModuleNotFoundError as error:
        if error.name not in ("starlette", "uvicorn"):
            raise
        what, fix = f"labelling needs the package {error.name}", "pip install 'kt3dmoseg[label]'"
        raise MissingDependencyError(what, fix=fix) from None
    create(flow)
    paths = {"frames": frames, "tracks": tracks, "compare": compare, "masks": masks, "kitti": kitti}
    given = {name: Path(path) for name, path in paths.items() if path is not None}
    for name, path in given.items():
        if not path.exists():
            raise InputFileError(f"--{name} {path}", found="no such file or folder")

    def tracker(pictures: Iterator[ByteArray], progress: Callable[[int, int | None], None]) -> Trajectories:
        from kt3dmoseg.tracking import track

        return track(pictures, flow=flow, progress=progress)

    clips = find_clips(clip, annotations=annotations, frames=frames, tracks=tracks)
    sessions = {name: ClipSession(source, tracker) for name, source in clips.items()}
    _check_sources(sessions)
    _check_case(Path(annotations), clips)
    other, masks_folder, raw = (given.get(name) for name in ("compare", "masks", "kitti"))
    routes = Routes(sessions, annotator=annotator, other=other, masks=masks_folder, kitti=raw)
    found = f"{len(clips)} clip{'s' * (len(clips) > 1)}; annotations in {Path(annotations).resolve()}"

    def ready(address: str) -> None:
        print(found)
        print(f"label at {address}  (Ctrl-C stops)", flush=True)
        if not no_browser:
            import webbrowser

            webbrowser.open(address)

    serve(routes, host=host, port=port, ready=ready)


def _check_sources(sessions: Mapping[str, ClipSession]) -> None:
    """Check that trajectories are of the frames; of the only clip, that everything can be read, too."""
    alone = len(sessions) == 1
    for name, session in sessions.items():
        source = session.source
        try:
            if alone:
                deque(read_frames(source.frames, "luma"), maxlen=0)
                session.annotation()
            # The other formats keep no sha256; reading all of a release would delay the page.
            if source.tracks and (alone or recognise(source.tracks).name in ("hdf5", "npz")):
                check_frames(load(source.tracks).provenance, name, source.frames)
        except KT3DMoSegError as error:
            if alone:
                raise
            print(f"kt3dmoseg: warning: {name}: {error}", file=sys.stderr)


def _check_case(folder: Path, clips: Iterable[str]) -> None:
    names = {f"{name}.json" for name in clips}
    for path in listed(folder) if folder.is_dir() else []:
        if path.name not in names and path.name.lower() in {name.lower() for name in names}:
            print(f"kt3dmoseg: warning: {path} is of none of the clips by its case", file=sys.stderr)
