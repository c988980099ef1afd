"""Trajectories of a folder of frames as a `Clip` that can be saved."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from kt3dmoseg import __version__
from kt3dmoseg.files import sha256_file
from kt3dmoseg.flow import Flow
from kt3dmoseg.flow import create as create_flow
from kt3dmoseg.io.images import Colour, frame_number, frame_paths, read_frames
from kt3dmoseg.options import from_mapping
from kt3dmoseg.tracking.options import TrackOptions
from kt3dmoseg.tracking.tracker import Progress, track
from kt3dmoseg.types import Clip, Labels


def track_clip(
    folder: str | os.PathLike[str],
    flow: str | Flow = "dis",
    *,
    colour: Colour = "refuse",
    cache: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    **options: Any,  # noqa: ANN401
) -> Clip:
    """Track a folder of frames: a clip with every trajectory evaluated and none labelled.

    Parameters
    ----------
    folder : path-like
        Numbered frames; the clip takes the folder's name.
    colour : {"refuse", "luma"}
        What to do with frames in colour, see `kt3dmoseg.io.images.read_frame`.
    flow, cache, progress, **options
        As in `kt3dmoseg.track`.

    Returns
    -------
    Clip
        Its provenance holds the frames' sha256, every option and the versions.

    Raises
    ------
    InputFileError, FileFormatError
        For a folder or frame that cannot be read.
    InvalidValueError, UnknownNameError
        As `kt3dmoseg.track`.
    """
    settings = from_mapping(TrackOptions, options, where="track")
    backend = create_flow(flow) if isinstance(flow, str) else flow
    paths = frame_paths(folder)
    frames = paths if colour == "refuse" else read_frames(paths, colour)
    dense = track(frames, backend, cache=cache, progress=progress, **dataclasses.asdict(settings))
    return Clip(
        name=Path(folder).resolve().name,
        dense=dense,
        evaluated=np.arange(len(dense)),
        labels=Labels(np.zeros(len(dense), dtype=np.int64)),
        frame_numbers=np.array([frame_number(path) for path in paths]),
        provenance={
            "frames": {path.name: sha256_file(path) for path in paths},
            "flow": type(backend).__name__,
            "flow_options": _plain(backend),
            "track_options": dataclasses.asdict(settings),
            "versions": {"kt3dmoseg": __version__, "numpy": np.__version__, "opencv": cv2.__version__},
        },
    )


def _plain(backend: Flow) -> dict[str, Any]:
    cls = type(backend)
    return (
        {f.name: getattr(backend, f.name) for f in dataclasses.fields(cls)}
        if dataclasses.is_dataclass(cls)
        else {}
    )
