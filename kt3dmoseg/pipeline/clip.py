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
from kt3dmoseg.pipeline.fingerprint import fingerprint
from kt3dmoseg.pipeline.masks import by_frame, label_by_masks, mask_paths
from kt3dmoseg.pipeline.options import Settings
from kt3dmoseg.pipeline.shot import Shot, Source
from kt3dmoseg.pipeline.sources import find_sources
from kt3dmoseg.tracking import Progress, subsample_background, track
from kt3dmoseg.types import Clip, IntArray, Labels, Trajectories


@dataclass(frozen=True)
class LabelSource:
    """Where a clip's labels come from: an annotation, masks, or nothing.

    Parameters
    ----------
    annotation : Path or None
        The annotation's file.
    masks : tuple of Path
        The masks' files.
    """

    annotation: Path | None = None
    masks: tuple[Path, ...] = ()

    def digests(self) -> dict[str, str]:
        """Return the sha256 of the annotation or of the masks together."""
        if self.annotation is not None:
            return {"annotation": sha256_file(self.annotation)}
        if self.masks:
            return {"masks": sha256_files(self.masks)}
        return {}

    def label(self, trajectories: Trajectories, numbers: IntArray, name: str) -> Labels | None:
        """Label trajectories; None when there is nothing to label them by."""
        if self.annotation is not None:
            return label_tracks(trajectories, load_annotation(self.annotation))
        if self.masks:
            return label_by_masks(trajectories, by_frame(self.masks, numbers.tolist(), name))
        return None


@dataclass(frozen=True)
class Job:
    """One clip to build, checked and fingerprinted but not computed."""

    source: Source
    shot: Shot
    labels: LabelSource
    settings: Settings
    flow: Flow
    fingerprint: Mapping[str, Any]

    def build(self, *, cache: Path | None = None, progress: Progress | None = None) -> Clip:
        """Track, label, subsample."""
        settings, name = self.settings, self.source.name
        dense = self._track(cache, progress)
        numbers = np.arange(dense.n_frames) if self.shot.numbers is None else np.array(self.shot.numbers)
        evaluated, labels = _choose(self.labels.label(dense, numbers, name), len(dense), settings, name)
        return Clip(
            name=name,
            dense=dense,
            evaluated=evaluated,
            labels=labels,
            frame_numbers=numbers,
            timestamps=self.shot.timestamps,
            camera=self.shot.camera,
            provenance={"format": "kt3dmoseg-build", "fingerprint": dict(self.fingerprint)},
        )

    def _track(self, cache: Path | None, progress: Progress | None) -> Trajectories:
        total = None if self.shot.numbers is None else len(self.shot.numbers)
        frames = self.source.frames(self.settings.build.colour)
        tell = None if progress is None else lambda done, _: progress(done, total)
        options = asdict(self.settings.tracks)
        try:
            return track(frames, self.flow, cache=cache, progress=tell, **options)
        except InvalidValueError as error:  # of the frames' arrays: say whose they are
            raise InvalidValueError(f"{self.source.where}: {error}") from None


def prepare(source: Source, labels: LabelSource, settings: Settings) -> Job:
    """Check a clip's sources and fingerprint them, without decoding a frame."""
    shot = source.inspect()
    flow = create(settings.build.flow, **settings.flow_parameters)
    print_of = fingerprint(source.name, shot, settings, flow, labels.digests())
    return Job(source, shot, labels, settings, flow, print_of)


def build_clip(
    source: str | os.PathLike[str] | Source,
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
    source : path or Source
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
    chosen = _only(source) if isinstance(source, (str, os.PathLike)) else source
    labels = label_source(chosen.name, annotation, masks)
    job = prepare(chosen, labels, settings)
    return job.build(cache=None if cache is None else Path(cache), progress=progress)


def label_source(
    name: str, annotation: str | os.PathLike[str] | None, masks: str | os.PathLike[str] | None
) -> LabelSource:
    """Find what a clip is labelled by: an annotation goes before masks.

    Parameters
    ----------
    name : str
        Name of the clip.
    annotation : path or None
        A file, or a folder that may hold ``<name>.json``.
    masks : path or None
        A folder of masks, or of one such folder per clip.
    """
    _check_places(annotation, masks)
    if annotation is not None:
        file = Path(annotation) / f"{name}.json" if Path(annotation).is_dir() else Path(annotation)
        if file.is_file():
            return LabelSource(annotation=file)
    return LabelSource(masks=tuple(mask_paths(masks, name)) if masks is not None else ())


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
        When there are no annotations or masks at the place.
    """
    create(settings.build.flow, **settings.flow_parameters)
    _check_places(annotation, masks)


def _check_places(annotation: str | os.PathLike[str] | None, masks: str | os.PathLike[str] | None) -> None:
    for given, what in ((annotation, "annotations"), (masks, "masks")):
        if given is not None and not Path(given).exists():
            raise InputFileError(f"{given}", expected=what, found="no such file or folder")


def _only(path: str | os.PathLike[str]) -> Source:
    found = find_sources(path)
    if len(found) != 1:
        raise InvalidValueError(
            os.fspath(path), expected="one clip", found=f"{len(found)}", fix="build_dataset builds many"
        )
    return found[0]


def _choose(labels: Labels | None, count: int, settings: Settings, name: str) -> tuple[IntArray, Labels]:
    """Return the evaluated rows and their labels."""
    if labels is None:
        return np.arange(count), Labels(np.zeros(count, dtype=np.int64))
    # The clip's name takes part, so that a clip's draw does not depend on the others.
    rng = np.random.default_rng([settings.build.seed, *name.encode()])
    rows = subsample_background(labels, rng, settings.build.fraction, settings.build.smallest)
    return rows, Labels(labels.label[rows], labels.background, labels.names)
