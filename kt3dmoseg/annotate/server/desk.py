"""One clip on the desk: its frames, its trajectories once they are there, and its labelling."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np

from kt3dmoseg import io
from kt3dmoseg.annotate.labelling import LabelledTracks, label_tracks_detailed
from kt3dmoseg.annotate.model import Annotation, KeyFrame, load_annotation
from kt3dmoseg.annotate.propagation import Region, TrackMotion, propagate_keys
from kt3dmoseg.annotate.workspace import ClipSource
from kt3dmoseg.errors import InvalidValueError, KT3DMoSegError
from kt3dmoseg.io.images import read_frame
from kt3dmoseg.types import ByteArray, Trajectories

Tracker: TypeAlias = Callable[[Iterator[ByteArray], Callable[[int, int | None], None]], Trajectories]
"""Computes trajectories from frames, reporting (frames done, frames in all)."""

_KEPT_LABELLINGS = 4
_KEPT_OBJECTS = 256


@dataclass(frozen=True)
class Progress:
    """How far the trajectories are: done of total frames, or what went wrong."""

    done: int
    total: int
    error: str = ""


class Desk:
    """What the server knows about one clip; safe to use from several threads."""

    def __init__(self, source: ClipSource, tracker: Tracker) -> None:
        self.source, self.tracker = source, tracker
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._progress = Progress(0, len(source.frames))
        self._trajectories: Trajectories | None = None
        self._size: tuple[int, int] | None = None
        self._labelled = lru_cache(_KEPT_LABELLINGS)(self._label)
        self._carried = lru_cache(_KEPT_OBJECTS)(self._carry)

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of the frames, from the first one."""
        if self._size is None:
            height, width = read_frame(self.source.frames[0], "luma").shape
            self._size = (width, height)
        return self._size

    @property
    def frame_names(self) -> list[str]:
        """File names of the frames."""
        return [frame.name for frame in self.source.frames]

    def annotation(self) -> Annotation:
        """Read the annotation file; an empty annotation when there is none yet.

        Raises
        ------
        FileFormatError, InvalidValueError
            When the file is damaged, or belongs to another clip.
        """
        if not self.source.annotation.exists():
            return Annotation(self.source.name, self.image_size, len(self.source.frames))
        found = load_annotation(self.source.annotation)
        self.check(found)
        return found

    def check(self, annotation: Annotation) -> None:
        """Refuse the annotation of another clip.

        Raises
        ------
        InvalidValueError
            The message names the field.
        """
        wanted = {
            "clip": self.source.name,
            "image_size": self.image_size,
            "n_frames": len(self.source.frames),
        }
        for name, value in wanted.items():
            if getattr(annotation, name) != value:
                raise InvalidValueError(name, expected=repr(value), found=repr(getattr(annotation, name)))

    def trajectories(self) -> Trajectories | Progress:
        """Return the trajectories, or how far they are; the first call starts the work."""
        with self._lock:
            if self._trajectories is not None:
                return self._trajectories
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, daemon=True)
                self._thread.start()
            return self._progress

    @property
    def ready(self) -> bool:
        """Whether the trajectories are there."""
        return self._trajectories is not None

    def wait(self) -> Trajectories:
        """Return the trajectories, waiting for them.

        Raises
        ------
        InvalidValueError
            When they cannot be read or computed.
        """
        found = self.trajectories()
        if isinstance(found, Progress) and self._thread is not None:
            self._thread.join()
            found = self.trajectories()
        if isinstance(found, Progress):
            raise InvalidValueError(f"trajectories of {self.source.name}", found=found.error)
        return found

    def labelled(self, annotation: Annotation) -> LabelledTracks:
        """Label the clip's trajectories; the last few answers are remembered."""
        # Who saved it, and as which revision, changes no label.
        return self._labelled(replace(annotation, revision=0, annotator=""))

    def regions(self, annotation: Annotation) -> dict[int, list[Region]]:
        """Return every object's region in every frame; computed only for objects that were edited."""
        return {item.id: self._carried(item.key_frames) for item in annotation.objects}

    def progress(self) -> dict[str, Any]:
        """Tell how far the clip is, JSON-able; trajectories that no file holds are not computed for it.

        Raises
        ------
        KT3DMoSegError
            When a file is damaged, or of another clip.
        """
        out: dict[str, Any] = {}
        found = self._trajectories
        if found is None and self.source.tracks is not None:
            found = self._load()
        if found is not None:
            out["trajectories"] = len(found)
        if not self.source.annotation.exists():
            return out
        annotation = self.annotation()
        out |= {
            "revision": annotation.revision,
            "annotator": annotation.annotator,
            "objects": len(annotation.objects),
            "motions": len(annotation.motions),
        }
        if found is None:
            return out
        # A clip that nobody opened is labelled without keeping anything of it.
        labelled = self.labelled(annotation) if self.ready else label_tracks_detailed(found, annotation)
        return out | {"counts": labelled.counts()}

    def frames(self) -> list[ByteArray]:
        """Read all frames as gray."""
        return [read_frame(path, "luma") for path in self.source.frames]

    def _label(self, annotation: Annotation) -> LabelledTracks:
        return label_tracks_detailed(self.wait(), annotation, regions=self.regions(annotation))

    def _carry(self, keys: tuple[KeyFrame, ...]) -> list[Region]:
        return propagate_keys(keys, len(self.source.frames), TrackMotion(self.wait()))

    def _work(self) -> None:
        try:
            found = self._load() if self.source.tracks else self._track()
            with self._lock:
                self._trajectories = found
        except KT3DMoSegError as error:
            self._report(self._progress.done, str(error))

    def _load(self) -> Trajectories:
        assert self.source.tracks is not None
        dense = io.load(self.source.tracks).dense
        if dense.n_frames != len(self.source.frames):
            raise InvalidValueError(
                f"{self.source.tracks}",
                expected=f"{len(self.source.frames)} frames, as the clip has",
                found=f"{dense.n_frames}",
            )
        return Trajectories(dense.xy, dense.visible, dense.track_id, self.image_size)

    def _track(self) -> Trajectories:
        frames = (read_frame(path, "luma") for path in self.source.frames)
        return self.tracker(frames, lambda done, _: self._report(done))

    def _report(self, done: int, error: str = "") -> None:
        with self._lock:
            self._progress = Progress(done, len(self.source.frames), error)


def outcome(labelled: LabelledTracks) -> dict[str, Any]:
    """Return what the page shows of a labelling, JSON-able."""
    return {
        "label": labelled.labels.label.tolist(),
        "reason": labelled.reason.tolist(),
        "counts": labelled.counts() | {"motions": _per_label(labelled)},
    }


def shown(regions: Mapping[int, list[Region]]) -> dict[str, Any]:
    """Return the regions as the page draws them, JSON-able."""
    return {
        str(number): [
            {
                "visibility": region.visibility,
                "key": region.key,
                "polygons": [np.round(polygon, 2).tolist() for polygon in region.polygons],
            }
            for region in of_object
        ]
        for number, of_object in regions.items()
    }


def _per_label(labelled: LabelledTracks) -> dict[str, int]:
    labels, counts = np.unique(labelled.labels.label, return_counts=True)
    return {str(label): int(count) for label, count in zip(labels, counts, strict=True)}
