"""One clip: frames in, trajectories, labels and the evaluated rows out."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from kt3dmoseg.annotate import label_tracks, load_annotation
from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.files import sha256_file, sha256_files
from kt3dmoseg.flow import create
from kt3dmoseg.frames import FrameSource, find_sources
from kt3dmoseg.pipeline.masks import by_frame, label_by_masks, mask_paths
from kt3dmoseg.pipeline.options import Settings
from kt3dmoseg.pipeline.provenance import inputs_of
from kt3dmoseg.tracking import Progress, subsample_background, track
from kt3dmoseg.types import Clip, IntArray, Labels, Trajectories


def build_clip(
    source: str | os.PathLike[str] | FrameSource,
    *,
    annotation: str | os.PathLike[str] | None = None,
    masks: str | os.PathLike[str] | None = None,
    flow_parameters: Mapping[str, Any] | None = None,
    cache: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    **options: Any,  # noqa: ANN401
) -> Clip:
    """Build one clip from its frames.

    Parameters
    ----------
    source : path or FrameSource
        A folder of frames, a video, or what `find_sources` and `kitti_sources` list.
    annotation : path, optional
        File that labels come from.
    masks : path, optional
        Folder of DAVIS or KITTI MOTS masks that labels come from.
    flow_parameters : mapping, optional
        Parameters of the flow backend.
    cache : path, optional
        Folder in which flow fields are kept and looked up by content.
    progress : callable, optional
        Called with (frames done, frames in all or None).
    **options
        Fields of `BuildOptions` and of `kt3dmoseg.tracking.TrackOptions`.

    Returns
    -------
    Clip
        With an annotation or masks: the labelled foreground and the drawn part of the background
        are evaluated. Without: every trajectory is evaluated, label 0.

    Raises
    ------
    InputFileError, FileFormatError
        For frames, annotation or masks that cannot be read.
    InvalidValueError, UnknownNameError
        For a bad option.
    """
    settings = Settings.of(options, dict(flow_parameters or {}))
    if isinstance(source, (str, os.PathLike)):
        found = find_sources(source)
        if len(found) != 1:
            number, fix = f"{len(found)}", "build_dataset builds many"
            raise InvalidValueError(os.fspath(source), expected="one clip", found=number, fix=fix)
        source = found[0]
    check_usage(settings, annotation, masks)
    return Job(source, label_files(source.name, annotation, masks), settings).build(cache, progress)


def check_usage(
    settings: Settings, annotation: str | os.PathLike[str] | None, masks: str | os.PathLike[str] | None
) -> None:
    """Find what is wrong for every clip alike, before the first one is read.

    Raises
    ------
    UnknownNameError, InvalidValueError, MissingDependencyError
        For a flow backend that cannot be made.
    InputFileError
        When a path of annotations or masks does not exist.
    """
    create(settings.build.flow, **settings.flow_parameters)
    for given, what in ((annotation, "annotations"), (masks, "masks")):
        if given is not None and not Path(given).exists():
            raise InputFileError(f"{given}", expected=what, found="no such file or folder")


def label_files(
    name: str, annotation: str | os.PathLike[str] | None, masks: str | os.PathLike[str] | None
) -> dict[str, list[Path]]:
    """Find what a clip is labelled by: its file under "annotation", else its files under "masks", or nothing.

    An annotation is a file, or a folder that may hold ``<name>.json``; masks are a folder of them, or of one
    such folder per clip.
    """
    if annotation is not None:
        file = Path(annotation) / f"{name}.json" if Path(annotation).is_dir() else Path(annotation)
        if file.is_file():
            return {"annotation": [file]}
    found = [] if masks is None else mask_paths(masks, name)
    return {"masks": found} if found else {}


class Job:
    """One clip to build, checked and described (`inputs`), without a frame decoded."""

    def __init__(self, source: FrameSource, labels: Mapping[str, Sequence[Path]], settings: Settings) -> None:
        self.source, self.labels, self.settings = source, labels, settings
        self.info = source.inspect()
        self.flow = create(settings.build.flow, **settings.flow_parameters)
        hashed = {
            kind: sha256_file(paths[0]) if kind == "annotation" else sha256_files(paths)
            for kind, paths in labels.items()
        }
        self.inputs = inputs_of(source.name, self.info.description, hashed, settings, self.flow)

    def build(self, cache: str | os.PathLike[str] | None, progress: Progress | None) -> Clip:
        """Track, label, subsample."""
        info, total = self.info, None if self.info.numbers is None else len(self.info.numbers)
        report = None if progress is None else lambda done, _: progress(done, total)
        frames, options = self.source.frames(self.settings.build.colour), asdict(self.settings.tracks)
        try:
            dense = track(frames, self.flow, cache=cache, progress=report, **options)
        except InvalidValueError as error:  # of the frames' arrays: say whose they are
            raise InvalidValueError(f"{self.source.where}: {error}") from None
        numbers = np.arange(dense.n_frames) if info.numbers is None else np.array(info.numbers)
        evaluated, labels = self._evaluated(self._label(dense, numbers), len(dense))
        provenance = {"format": "kt3dmoseg-build", "inputs": self.inputs}
        return Clip(
            self.source.name, dense, evaluated, labels, numbers, info.timestamps, info.camera, provenance
        )

    def _label(self, dense: Trajectories, numbers: IntArray) -> Labels | None:
        if annotation := self.labels.get("annotation"):
            return label_tracks(dense, load_annotation(annotation[0]))
        if masks := self.labels.get("masks"):
            return label_by_masks(dense, by_frame(masks, numbers.tolist(), self.source.name))
        return None

    def _evaluated(self, labels: Labels | None, count: int) -> tuple[IntArray, Labels]:
        if labels is None:
            return np.arange(count), Labels(np.zeros(count, dtype=np.int64))
        chosen = self.settings.build
        # The clip's name takes part, so that a clip's draw does not depend on the others.
        rng = np.random.default_rng([chosen.seed, *self.source.name.encode()])
        rows = subsample_background(labels, rng, chosen.fraction, chosen.smallest)
        return rows, Labels(labels.label[rows], labels.background, labels.names)
