"""One clip: frames in, trajectories, labels and the evaluated rows out."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kt3dmoseg.annotate import label_tracks, load_annotation
from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.files import sha256_file, sha256_files
from kt3dmoseg.flow import Flow, create
from kt3dmoseg.frames import FrameInfo, FrameSource, find_sources
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
    job = prepare(source, label_source(source.name, annotation, masks), settings)
    return job.build(cache=cache, progress=progress)


def check_usage(
    settings: Settings, annotation: str | os.PathLike[str] | None, masks: str | os.PathLike[str] | None
) -> None:
    """Find what is wrong for every clip alike, before the first one is read.

    Parameters
    ----------
    settings : Settings
        Names the flow backend and its parameters.
    annotation, masks : path or None
        As in `label_source`.

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


@dataclass(frozen=True)
class LabelSource:
    """Where a clip's labels come from: the file of an annotation, files of masks, or nothing."""

    annotation: Path | None = None
    masks: tuple[Path, ...] = ()

    def checksums(self) -> dict[str, str]:
        """Return the sha256 of the annotation or of the masks together."""
        if self.annotation is not None:
            return {"annotation": sha256_file(self.annotation)}
        return {"masks": sha256_files(self.masks)} if self.masks else {}

    def label(self, trajectories: Trajectories, numbers: IntArray, name: str) -> Labels | None:
        """Label trajectories; None when there is nothing to label them by."""
        if self.annotation is not None:
            return label_tracks(trajectories, load_annotation(self.annotation))
        if self.masks:
            return label_by_masks(trajectories, by_frame(self.masks, numbers.tolist(), name))
        return None


def label_source(
    name: str, annotation: str | os.PathLike[str] | None, masks: str | os.PathLike[str] | None
) -> LabelSource:
    """Find what a clip is labelled by: an annotation takes precedence over masks.

    Parameters
    ----------
    name : str
        Name of the clip.
    annotation : path or None
        A file, or a folder that may hold ``<name>.json``.
    masks : path or None
        A folder of masks, or of one such folder per clip.
    """
    if annotation is not None:
        file = Path(annotation) / f"{name}.json" if Path(annotation).is_dir() else Path(annotation)
        if file.is_file():
            return LabelSource(annotation=file)
    return LabelSource(masks=tuple(mask_paths(masks, name)) if masks is not None else ())


@dataclass(frozen=True)
class Job:
    """One clip to build, checked but not computed; its inputs are known."""

    source: FrameSource
    info: FrameInfo
    labels: LabelSource
    settings: Settings
    flow: Flow
    inputs: Mapping[str, Any]

    def build(self, *, cache: str | os.PathLike[str] | None = None, progress: Progress | None = None) -> Clip:
        """Track, label, subsample."""
        name, info = self.source.name, self.info
        dense = self._track(cache, progress)
        numbers = np.arange(dense.n_frames) if info.numbers is None else np.array(info.numbers)
        evaluated, labels = self._choose(self.labels.label(dense, numbers, name), len(dense))
        provenance = {"format": "kt3dmoseg-build", "inputs": dict(self.inputs)}
        return Clip(name, dense, evaluated, labels, numbers, info.timestamps, info.camera, provenance)

    def _track(self, cache: str | os.PathLike[str] | None, progress: Progress | None) -> Trajectories:
        total = None if self.info.numbers is None else len(self.info.numbers)
        frames = self.source.frames(self.settings.build.colour)
        report = None if progress is None else lambda done, _: progress(done, total)
        try:
            return track(frames, self.flow, cache=cache, progress=report, **asdict(self.settings.tracks))
        except InvalidValueError as error:  # of the frames' arrays: say whose they are
            raise InvalidValueError(f"{self.source.where}: {error}") from None

    def _choose(self, labels: Labels | None, count: int) -> tuple[IntArray, Labels]:
        """Return the evaluated rows and their labels."""
        if labels is None:
            return np.arange(count), Labels(np.zeros(count, dtype=np.int64))
        chosen = self.settings.build
        # The clip's name takes part, so that a clip's draw does not depend on the others.
        rng = np.random.default_rng([chosen.seed, *self.source.name.encode()])
        rows = subsample_background(labels, rng, chosen.fraction, chosen.smallest)
        return rows, Labels(labels.label[rows], labels.background, labels.names)


def prepare(source: FrameSource, labels: LabelSource, settings: Settings) -> Job:
    """Check a clip's sources and describe them, without decoding a frame."""
    info = source.inspect()
    flow = create(settings.build.flow, **settings.flow_parameters)
    inputs = inputs_of(source.name, info.description, labels.checksums(), settings, flow)
    return Job(source, info, labels, settings, flow, inputs)
