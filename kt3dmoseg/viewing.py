"""Looking at clips: trajectories drawn on their frames, and the labelling page in the browser.

Both functions are commands, too; they import what they need when they are called.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from kt3dmoseg.app import AnyEither, AnyFile, AnyFolder, Catalogs, Flag, Name, Range, Size, Whole, flags
from kt3dmoseg.draw import DrawOptions
from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.options import from_mapping
from kt3dmoseg.text import count

if TYPE_CHECKING:
    from kt3dmoseg.types import ByteArray, Trajectories


@flags(DrawOptions)
def show(
    clip: AnyFile,
    /,
    frames: AnyFolder | None = None,
    *,
    output: Annotated[AnyEither | None, Parameter(alias="-o")] = None,
    by: Literal["label", "length", "prediction"] | None = None,
    pred: AnyFile | None = None,
    at: Annotated[Whole | None, Parameter(metavar="I")] = None,
    rate: float = 5.0,
    report: Annotated[Callable[[str], object] | None, Parameter(parse=False)] = None,
    **options: Any,  # noqa: ANN401
) -> list[Path]:
    """Draw trajectories with their trails on the frames, as pictures or a short video.

    CLIP is any clip file. PATH is a folder (one PNG per frame), a single .png (of --at), or .mp4, .avi,
    .gif, .apng, .webp.

    Parameters
    ----------
    clip : path
        Clip file.
    frames : path, optional
        Frames, a folder with FOLDER/CLIP, or a KITTI raw root.
    output : path, optional
        Where to write (default: CLIP's name, a folder).
    by : {"label", "length", "prediction"}, optional
        What colours show (default: label, if labelled).
    pred : path, optional
        Predicted labels: .csv track,label, .npz or .h5.
    at : int, optional
        Only frame I of the clip, counted from 0.
    rate : float
        Pictures per second of a video.
    report : callable, optional
        Takes a line on what was written; by default it goes to standard error.
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
    from kt3dmoseg.draw.painting import draw_frame, painting_of
    from kt3dmoseg.frames import frames_of
    from kt3dmoseg.io import load
    from kt3dmoseg.io.images import MOVING_SUFFIXES, check_rate, write_moving, write_png

    chosen = from_mapping(DrawOptions, options)
    check_rate(rate)
    loaded = load(clip)
    target = Path(output or loaded.name)
    suffix = "" if output is None or target.is_dir() else target.suffix.lower()
    if suffix not in ("", ".png", *MOVING_SUFFIXES):
        expected = f"a suffix of {', '.join(MOVING_SUFFIXES)}, .png, or none for a folder"
        raise InvalidValueError(f"{target}", expected=expected, found=repr(target.suffix))
    if at is not None and not 0 <= at < loaded.n_frames:
        raise InvalidValueError("at", expected=f"0..{loaded.n_frames - 1}", found=str(at))
    painting = painting_of(loaded, by, pred)
    pictures = [] if frames is None else frames_of(loaded, frames)

    def drawn(frame: int) -> ByteArray:
        title = f"{loaded.name}  frame {frame + 1}/{loaded.n_frames}"
        return draw_frame(painting, frame, pictures[frame] if pictures else None, title, chosen)

    shown = list(range(loaded.n_frames)) if at is None else [at]
    if suffix == ".png":
        shown = [shown[len(shown) // 2]]
    paths = [target] if suffix else [target / f"{loaded.name}_{frame + 1:06d}.png" for frame in shown]
    if suffix in MOVING_SUFFIXES:
        write_moving(target, map(drawn, shown), rate)
    else:
        for path, frame in zip(paths, shown, strict=True):
            write_png(path, drawn(frame))
    line = f"{target}: {loaded.name}, {count(len(shown), 'picture')}"
    print(line, file=sys.stderr) if report is None else report(line)
    return paths


def label(
    clip: AnyEither,
    /,
    frames: AnyFolder | None = None,
    *,
    tracks: AnyEither | None = None,
    annotations: AnyFolder = "annotations",
    annotator: Name = "",
    team: AnyFile | None = None,
    compare: AnyFolder | None = None,
    masks: AnyFolder | None = None,
    kitti: AnyFolder | None = None,
    catalogs: Catalogs = (),
    range_: Range = "",
    step: Whole = 1,
    size: Size = "",
    flow: Name = "dis",
    host: str = "127.0.0.1",
    port: Annotated[Whole, Parameter(show_default=False)] = 0,
    no_browser: Flag = False,
) -> None:
    """Outline the moving objects of a clip in the browser.

    CLIP is a folder of frames, a clip file (.h5, .mat), or a dataset: a folder with one of these per clip.
    The page opens on this machine only; annotations are saved to <clip>.json while you draw.

    Parameters
    ----------
    clip : path
        Frames, a clip file, or a folder of them.
    frames : path, optional
        Frames of a clip file, a folder with those of all clips, or a KITTI raw root.
    tracks : path, optional
        Clip file or folder of them with trajectories to show.
    annotations : path
        Where <clip>.json are.
    annotator : str
        Name written into what is saved.
    team : path, optional
        File with a name per line: each gets an address with a token of their own, kept in the file.
    compare : path, optional
        Folder of another annotator's annotations.
    masks : path, optional
        Folder of masks to propose regions from.
    kitti : path, optional
        KITTI raw root to propose regions from tracklets.
    catalogs : paths, optional
        Label the clips of these catalogs; CLIP is a KITTI raw root.
    range_ : str
        Frame numbers of frames or a video, both included; a video's from 0.
    step : int
        Take every N-th frame.
    size : str
        Resize the frames.
    flow : str
        Flow that computes missing trajectories.
    host : str
        Address to listen on.
    port : int
        Port to listen on (default: a free one).
    no_browser : bool
        Print the address, open no browser.

    Raises
    ------
    InputFileError, FileFormatError
        When a path does not exist or the files of the only clip are unfit; of several clips, a warning says
        so, and the page.
    ModuleNotFoundError
        When starlette or uvicorn is not installed.
    """
    import webbrowser

    from kt3dmoseg.annotate.server.app import read_team, serve
    from kt3dmoseg.annotate.server.clip_session import sessions_of
    from kt3dmoseg.annotate.server.routes import Routes
    from kt3dmoseg.flow import create
    from kt3dmoseg.frames import find_clips

    create(flow)
    given = {"team": team, "frames": frames, "tracks": tracks}
    for name, path in (given | {"compare": compare, "masks": masks, "kitti": kitti}).items():
        if path is not None and not Path(path).exists():
            raise InputFileError(f"--{name} {path}", found="no such file or folder")
    if Path(annotations).exists() and not Path(annotations).is_dir():
        raise InputFileError(f"annotations: {annotations}", expected="a folder", found="no folder")

    def tracker(pictures: Iterator[ByteArray], progress: Callable[[int, int | None], None]) -> Trajectories:
        from kt3dmoseg.tracking import track

        return track(pictures, flow=flow, progress=progress)

    part: dict[str, Any] = {"range_": range_, "step": step, "size": size, "catalogs": catalogs}
    clips = find_clips(clip, annotations=annotations, frames=frames, tracks=tracks, **part)
    sessions = sessions_of(clips, tracker)
    other, mask_folder, raw = (None if path is None else Path(path) for path in (compare, masks, kitti))
    tokens = {} if team is None else read_team(Path(team))
    folders: dict[str, Any] = {"other": other, "masks": mask_folder, "kitti": raw}
    routes = Routes(sessions, annotator=annotator, team=tokens.values(), **folders)
    found = f"{count(len(sessions), 'clip')}; annotations in {Path(annotations).resolve()}"

    def ready(addresses: dict[str, str]) -> None:
        lines = [f"{name} labels at {address}" for name, address in addresses.items() if name]
        lines = lines or [f"label at {addresses['']}"]
        lines += [f"{files.name}: {note}" for files in clips.values() for note in files.notes]
        print(found, *lines, "(Ctrl-C stops)", sep="\n", flush=True)
        if not (no_browser or team):
            webbrowser.open(addresses[""])

    serve(routes, host=host, port=port, ready=ready, tokens=tokens)
