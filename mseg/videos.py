"""The command `video`: what moves in a video; its parts are in `mseg.shots`, imported when it is called."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from kt3dmoseg.app import AnyEither, AnyFolder, Flag, Name, Positive, Range, Size, Whole, progress_bar
from kt3dmoseg.errors import InputFileError, InvalidValueError


def video(
    input: AnyEither,
    /,
    frames: AnyFolder | None = None,
    *,
    output: Annotated[AnyFolder, Parameter(alias="-o")],
    n_motions: Positive | None = None,
    method: Name = "multibody",
    flow: Name = "dis",
    seed: Whole = 0,
    range_: Range = "",
    step: Positive = 1,
    size: Size = "",
    rate: float = 10.0,
    quiet: Flag = False,
    report: Annotated[Callable[[str], object] | None, Parameter(parse=False)] = None,
) -> list[Any]:  # of Shot, which the command line would have to import to list it
    """Find the motions in a video: trajectories, labels, masks and an overlay, each shot by itself.

    INPUT is a video, a folder of frames, a KITTI raw root with one drive, or a clip file. Per shot are
    written NAME.h5 (all trajectories, with the motions found), PNG files in masks/NAME (DAVIS; 0 is the
    largest motion, the background) and NAME.mp4.

    Parameters
    ----------
    input : path
        Video, folder of numbered frames, KITTI raw root, or clip file.
    frames : path, optional
        Frames of a clip file; without them, no masks.
    output : path
        New folder for what is found.
    n_motions : int, optional
        Number of motions of every shot, or of every 40 frames of a longer one (default: found).
    method : str
        Method, see 'mseg methods'.
    flow : str
        Flow that trajectories follow.
    seed : int
        Same seed, same labels.
    range_ : str
        Frame numbers, both included; a video's from 0.
    step : int
        Take every N-th frame.
    size : str
        Resize the frames.
    rate : float
        Pictures per second of the overlay.
    quiet : bool
        No progress bar.
    report : callable, optional
        Takes the line on each shot, and notes on the frames; by default they are printed.

    Returns
    -------
    list of Shot
        In order.

    Raises
    ------
    InputFileError, FileFormatError
        When the input cannot be read, or the output is not a new folder.
    InvalidValueError, UnknownNameError
        For an option that makes no sense, or when no shot can be segmented.
    """
    from kt3dmoseg.files import check_writable
    from kt3dmoseg.frames import one_source
    from kt3dmoseg.io.formats import CLIP_SUFFIXES
    from kt3dmoseg.io.images import check_rate
    from mseg.methods import check_whole, create
    from mseg.shots import clip_shot, segmented, tracked_shots, write_shot

    source, folder, say = Path(input), Path(output), report or (lambda line: print(line, flush=True))
    create(method)
    check_whole("seed", seed, 0)
    if folder.is_dir() and any(folder.iterdir()):
        fix = "give another folder, or remove it"
        raise InputFileError(f"{folder}", expected="a new or empty folder", found="files", fix=fix)
    check_rate(rate)
    check_writable(folder)
    part, is_clip = (range_, step, size), source.is_file() and source.suffix.lower() in CLIP_SUFFIXES
    if is_clip and part != ("", 1, ""):
        raise InvalidValueError("range, step and size", expected="frames or a video", found=f"{source}")
    if is_clip and flow != "dis":
        raise InvalidValueError("flow", expected="frames or a video", found=f"{source}, with trajectories")
    if frames is not None and not is_clip:
        raise InvalidValueError("frames", expected="a clip file that they are of", found=f"{source}")
    taken = None if is_clip else one_source(source, frames=range_, step=step, size=size)
    info = taken.inspect() if taken else None
    for note in info.notes if info else ():
        say(f"{source.stem}: {note}")
    options: dict[str, Any] = {"method": method, "n_motions": n_motions, "seed": seed}
    shots = []
    with progress_bar("frame", quiet=quiet) as bar:
        found = tracked_shots(taken, info, flow, bar) if taken and info else clip_shot(source, frames)
        for tracked, pictures in found:
            shot = segmented(tracked, options, bar)
            note = write_shot(shot.clip, pictures, folder, rate, bar) if shot.clip else ""
            deque(pictures or (), maxlen=0)  # those of the next shot follow
            shots.append(shot)
            say(f"{shot}{note}")
    if all(shot.clip is None for shot in shots):
        raise InvalidValueError(f"{source}", expected="motions in some shot", found=shots[0].reason)
    return shots
