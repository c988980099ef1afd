"""One clip: frames in, trajectories, labels and the evaluated rows out, and what they depend on."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import scipy

import kt3dmoseg
from kt3dmoseg import pipeline, tracking
from kt3dmoseg.annotate import label_tracks, load_annotation
from kt3dmoseg.errors import InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import listed, sha256_file, sha256_files
from kt3dmoseg.flow import Flow, backend_identity, create
from kt3dmoseg.frames import FrameSource, find_sources
from kt3dmoseg.io import hdf5
from kt3dmoseg.options import from_mapping, option_names
from kt3dmoseg.pipeline import BuildOptions
from kt3dmoseg.pipeline.drives import SyntheticDrive
from kt3dmoseg.pipeline.masks import by_frame, label_by_masks, mask_paths
from kt3dmoseg.registry import unknown_name
from kt3dmoseg.tracking import Progress, TrackOptions, subsample_background, track
from kt3dmoseg.types import Clip, IntArray, Labels, Trajectories


@dataclass(frozen=True)
class Settings:
    """Everything that a clip depends on apart from its sources."""

    build: BuildOptions
    tracks: TrackOptions
    flow: Flow

    @classmethod
    def of(cls, options: Mapping[str, Any], flow_parameters: Mapping[str, Any] | None) -> Settings:
        """Sort keywords into the two groups of options and create the flow; raises as `build_clip` does."""
        own, tracker = option_names(BuildOptions), option_names(TrackOptions)
        for name in options:
            if name not in (*own, *tracker):
                raise unknown_name("option", name, [*own, *tracker])
        build = from_mapping(BuildOptions, {k: v for k, v in options.items() if k in own})
        tracks = from_mapping(TrackOptions, {k: v for k, v in options.items() if k in tracker})
        return cls(build, tracks, create(build.flow, **(flow_parameters or {})))


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
    settings = Settings.of(options, flow_parameters)
    if isinstance(source, (str, os.PathLike)):
        found = find_sources(source)
        if len(found) != 1:
            number, fix = f"{len(found)}", "build_dataset builds many"
            raise InvalidValueError(os.fspath(source), expected="one clip", found=number, fix=fix)
        source = found[0]
    check_label_paths([source.name], annotation, masks)
    return Job(source, label_files(source.name, annotation, masks), settings).build(cache, progress)


def check_label_paths(
    names: Sequence[str], annotation: str | os.PathLike[str] | None, masks: str | os.PathLike[str] | None
) -> None:
    """Raise an `InputFileError` when annotations or masks do not exist, or annotations are of no clip."""
    for given, what in ((annotation, "annotations"), (masks, "masks")):
        if given is not None and not Path(given).exists():
            raise InputFileError(f"{given}", expected=what, found="no such file or folder")
    if annotation is None or masks is not None:
        return
    folder = Path(annotation)
    if folder.is_dir() and not any((folder / f"{name}.json").is_file() for name in names):
        files = [path.name for path in listed(folder) if path.suffix.lower() == ".json"]
        expected = f"{names[0]}.json" if len(names) == 1 else f"CLIP.json of {', '.join(names[:3])}"
        fix = "rename it" if files else "give the folder that has some"
        fix += ", or give --annotations none (annotations=None) for no labels"
        raise InputFileError(
            f"{folder}", expected=expected, found=", ".join(files[:3]) or "no annotation", fix=fix
        )


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
    """One clip to build, checked, without a frame decoded.

    Its `inputs` are everything that the bytes of the clip depend on, as JSON values; a null flow means a
    backend that depends on more than its parameters.
    """

    def __init__(self, source: FrameSource, labels: Mapping[str, Sequence[Path]], settings: Settings) -> None:
        self.source, self.labels, self.settings = source, labels, settings
        self.info = source.inspect()
        self.inputs = {
            "name": source.name,
            "source": self.info.description,
            "labels": {
                kind: sha256_file(paths[0]) if kind == "annotation" else sha256_files(paths)
                for kind, paths in labels.items()
            },
            "options": asdict(settings.build) | asdict(settings.tracks),
            "flow": backend_identity(settings.flow),
            "versions": {
                "kt3dmoseg": kt3dmoseg.__version__,
                "numpy": np.__version__,
                "scipy": scipy.__version__,
                "opencv": cv2.__version__,
                "h5py": h5py.__version__,
            },
            "algorithms": {"tracking": tracking.ALGORITHM_VERSION, "pipeline": pipeline.ALGORITHM_VERSION},
        }

    def build(self, cache: str | os.PathLike[str] | None, progress: Progress | None) -> Clip:
        """Track, label, subsample."""
        info, total = self.info, None if self.info.numbers is None else len(self.info.numbers)
        report = None if progress is None else lambda done, _: progress(done, total)
        frames, options = self.source.frames(self.settings.build.colour), asdict(self.settings.tracks)
        try:
            dense = track(frames, self.settings.flow, cache=cache, progress=report, **options)
        except InvalidValueError as error:  # of the frames' arrays: name their source
            raise InvalidValueError(f"{self.source.where}: {error}") from None
        numbers = np.arange(dense.n_frames) if info.numbers is None else np.array(info.numbers)
        evaluated, labels = self._evaluated(self._label(dense, numbers), len(dense))
        provenance: dict[str, Any] = {"format": "kt3dmoseg-build", "inputs": self.inputs}
        if isinstance(self.source, SyntheticDrive):
            provenance["attributes"] = dict(self.source.measure())
        return Clip(
            self.source.name, dense, evaluated, labels, numbers, info.timestamps, info.camera, provenance
        )

    def _label(self, dense: Trajectories, numbers: IntArray) -> Labels | None:
        if isinstance(self.source, SyntheticDrive):
            return self.source.label(dense)
        if annotation := self.labels.get("annotation"):
            found = load_annotation(annotation[0])
            if found.clip != self.source.name:
                where, fix = f"{annotation[0]}: clip", "annotations are of one clip each"
                raise InputFileError(where, expected=repr(self.source.name), found=repr(found.clip), fix=fix)
            return label_tracks(dense, found)
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


def reason_to_build(target: Path, wanted: Mapping[str, Any], *, force: bool = False) -> str:
    """Explain why a clip's file must be written (with `force`, always); empty when it is up to date.

    Raises
    ------
    InputFileError
        For an intact clip that no build has made, unless forced: it may be the only copy.
    """
    if not target.exists():
        return "new"
    try:
        provenance = hdf5.provenance(target)
    except KT3DMoSegError as error:
        return f"the file there is no intact clip ({error})"
    found = provenance.get("inputs", provenance.get("fingerprint"))  # its name in 0.1.0
    if not isinstance(found, dict):
        if force:
            return "forced"
        raise InputFileError(
            f"{target}",
            expected="no file, or a clip that was built from frames",
            found="another clip",
            fix="give another output folder, or --force to write over it",
        )
    if wanted["flow"] is None:
        return "the fields of this flow backend may depend on more than its parameters"
    changes = list(_differences(found, wanted, ""))
    if force and not changes:
        return "forced"
    return "; ".join(changes[:3]) + (f"; {len(changes) - 3} more changes" if len(changes) > 3 else "")


def _differences(old: object, new: object, where: str) -> Iterator[str]:
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in sorted({*old, *new}):
            yield from _differences(old.get(key), new.get(key), f"{where} {key}".strip())
    elif old != new and (old is None or new is None):
        yield f"{where} {'added' if old is None else 'removed'}"
    elif old != new:
        checksum = where.startswith("labels") or where.endswith("sha256")
        yield f"{where} changed" if checksum else f"{where} was {old!r}, now {new!r}"
