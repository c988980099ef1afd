"""The state of each clip on the server: frames, trajectories once they are there, labelling, progress."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, TypeAlias

from kt3dmoseg import io
from kt3dmoseg.annotate.labelling import LabelledTracks, label_tracks_detailed
from kt3dmoseg.annotate.model import Annotation, KeyFrame, load_annotation
from kt3dmoseg.annotate.propagation import Region, TrackMotion, propagate_keys, weak_frames
from kt3dmoseg.annotate.proposals.residual import moving_groups
from kt3dmoseg.errors import FileFormatError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import hold_folder, parse_json, read_bytes, write_text
from kt3dmoseg.frames import ClipFiles
from kt3dmoseg.io.images import read_frame
from kt3dmoseg.types import ByteArray, IntArray, Trajectories

Tracker: TypeAlias = Callable[[Iterator[ByteArray], Callable[[int, int | None], None]], Trajectories]
"""Computes trajectories from frames, reporting (frames done, frames in all)."""

_KEPT_LABELLINGS = 4
_KEPT_OBJECTS = 256
_MAX_STATES = 1 << 20
_LONGEST_NAME = 100
_MOSTLY = 0.5

WORK_STATES = ("not started", "in work", "done", "reviewed")


@dataclass(frozen=True)
class Progress:
    """How far the trajectories are: done of total frames, or what went wrong."""

    done: int
    total: int
    error: str = ""


class ClipSession:
    """One clip that is being labelled; safe to use from several threads."""

    def __init__(self, source: ClipFiles, tracker: Tracker) -> None:
        self.source, self.tracker = source, tracker
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._progress = Progress(0, len(source.frames))
        self._trajectories: Trajectories | None = None
        self._labelled = lru_cache(_KEPT_LABELLINGS)(self._label)
        self._carried = lru_cache(_KEPT_OBJECTS)(self._carry)
        self._doubted = lru_cache(_KEPT_OBJECTS)(self._doubt)

    @cached_property
    def image_size(self) -> tuple[int, int]:
        """Width and height of the frames, from the first one."""
        height, width = read_frame(self.source.frames[0], "luma").shape
        return width, height

    @property
    def frame_names(self) -> list[str]:
        """File names of the frames."""
        return [frame.name for frame in self.source.frames]

    def annotation(self) -> Annotation:
        """Read the annotation file, which must be of this clip; an empty annotation when there is none."""
        if not self.source.annotation.exists():
            return Annotation(self.source.name, self.image_size, len(self.source.frames))
        found = load_annotation(self.source.annotation)
        self.check(found)
        return found

    def check(self, annotation: Annotation) -> None:
        """Raise InvalidValueError, which names the field, for the annotation of another clip."""
        frames = len(self.source.frames)
        wanted = {"clip": self.source.name, "image_size": self.image_size, "n_frames": frames}
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

    def wait(self) -> Trajectories:
        """Return the trajectories, waiting for them; InvalidValueError when there are none."""
        found = self.trajectories()
        if isinstance(found, Progress) and self._thread is not None:
            self._thread.join()
            found = self.trajectories()
        if isinstance(found, Progress):
            raise InvalidValueError(f"trajectories of {self.source.name}", found=found.error)
        return found

    def labelled(self, annotation: Annotation) -> LabelledTracks:
        """Label the clip's trajectories; the last few answers are kept."""
        # Who saved it, and as which revision, changes no label.
        return self._labelled(replace(annotation, revision=0, annotator=""))

    def regions(self, annotation: Annotation) -> dict[int, list[Region]]:
        """Return every object's region in every frame; computed only for objects that were edited."""
        return {item.id: self._carried(item.key_frames) for item in annotation.objects}

    def weak(self, annotation: Annotation) -> dict[int, list[str]]:
        """Return why each object's region is in doubt in each frame; see `weak_frames`."""
        return {item.id: self._doubted(item.key_frames) for item in annotation.objects}

    @cached_property
    def moving(self) -> IntArray | None:
        """Group (N,) of each trajectory: 1 moves as the scene, 2, 3, ... by themselves; None when unknown."""
        return _moving(self.wait())

    def work_state(self) -> dict[str, Any]:
        """Return the last state that an annotator set, as `set_work_state` wrote it.

        Without one a clip is "in work" when it has an annotation, else "not started".
        """
        path = self._states_file
        if not path.exists():
            return {"state": WORK_STATES[self.source.annotation.exists()]}
        *_, last = read_bytes(path, _MAX_STATES).splitlines() or [b""]
        found = parse_json(last, os.fspath(path))
        if not isinstance(found, dict) or found.get("state") not in WORK_STATES:
            raise FileFormatError(os.fspath(path), expected="a state of the clip", found=repr(found)[:80])
        return found

    def set_work_state(self, state: object, by: object) -> dict[str, Any]:
        """Add state, name, time and revision to ``<clip>.states.jsonl`` in the annotation's folder."""
        if state not in WORK_STATES:
            expected = f"one of {', '.join(WORK_STATES)}"
            raise InvalidValueError("state", expected=expected, found=repr(state)[:80])
        if not isinstance(by, str) or not by.strip() or len(by) > _LONGEST_NAME:
            expected = f"the annotator's name, of at most {_LONGEST_NAME} characters"
            raise InvalidValueError("by", expected=expected, found=repr(by)[:80])
        path = self._states_file
        with hold_folder(path.parent):
            before = read_bytes(path, _MAX_STATES).decode() if path.exists() else ""
            time = datetime.now(UTC).isoformat(timespec="seconds")
            entry = {"state": state, "by": by.strip(), "time": time, "revision": self.annotation().revision}
            write_text(path, f"{before}{json.dumps(entry, ensure_ascii=False)}\n")
        return entry

    @property
    def _states_file(self) -> Path:
        return self.source.annotation.with_suffix(".states.jsonl")

    def trouble(self) -> str:
        """Return why the annotation cannot be saved as things are; "" when it can."""
        folder = self.source.annotation.parent
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        if not folder.is_dir():
            return f"{folder}: expected a folder, found a file"
        return "" if os.access(folder, os.W_OK) else f"{folder}: cannot write there"

    def summary(self) -> dict[str, Any]:
        """Count how far the clip is, JSON-able; trajectories that no file holds are not computed for it."""
        found = self._trajectories
        ready = found is not None
        if found is None and self.source.tracks is not None:
            found = self._load(self.source.tracks)
        out: dict[str, Any] = {} if found is None else {"trajectories": len(found)}
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
        labelled = self.labelled(annotation) if ready else label_tracks_detailed(found, annotation)
        groups = self.moving if ready else _moving(found)
        left = None if groups is None else unexplained(groups, labelled)
        return out | {"counts": labelled.counts(), "unexplained": left}

    def state(self) -> tuple[object, ...]:
        """Return what `summary` depends on: the state of the files, or whether trajectories were computed."""
        tracks, computed = self.source.tracks, self._trajectories is not None
        return _file_state(self.source.annotation), _file_state(tracks) if tracks else computed

    def _label(self, annotation: Annotation) -> LabelledTracks:
        return label_tracks_detailed(self.wait(), annotation, regions=self.regions(annotation))

    def _carry(self, keys: tuple[KeyFrame, ...]) -> list[Region]:
        return propagate_keys(keys, len(self.source.frames), TrackMotion(self.wait()))

    def _doubt(self, keys: tuple[KeyFrame, ...]) -> list[str]:
        return weak_frames(self._carried(keys), TrackMotion(self.wait()))

    def _work(self) -> None:
        try:
            found = self._load(self.source.tracks) if self.source.tracks else self._track()
            with self._lock:
                self._trajectories = found
        except KT3DMoSegError as error:
            self._report(self._progress.done, str(error))

    def _load(self, path: Path) -> Trajectories:
        dense, frames = io.load(path).dense, len(self.source.frames)
        if dense.n_frames != frames:
            expected = f"{frames} frames, as the clip has"
            raise InvalidValueError(f"{path}", expected=expected, found=f"{dense.n_frames}")
        return Trajectories(dense.xy, dense.visible, dense.track_id, self.image_size)

    def _track(self) -> Trajectories:
        frames = (read_frame(path, "luma") for path in self.source.frames)
        return self.tracker(frames, lambda done, _: self._report(done))

    def _report(self, done: int, error: str = "") -> None:
        with self._lock:
            self._progress = Progress(done, len(self.source.frames), error)


def unexplained(groups: IntArray, labelled: LabelledTracks) -> int:
    """Count the groups that move by themselves but are mostly labelled as background."""
    background = labelled.labels.label == 1
    return sum(bool(background[groups == k].mean() > _MOSTLY) for k in range(2, groups.max(initial=1) + 1))


def _moving(tracks: Trajectories) -> IntArray | None:
    try:
        return moving_groups(tracks)
    except InvalidValueError:
        return None


class Summaries:
    """The progress of all clips, counted in the background, and again only where a file has changed."""

    def __init__(self, sessions: Mapping[str, ClipSession]) -> None:
        self.sessions = sessions
        self._lock = threading.Lock()
        self._known: dict[str, tuple[tuple[object, ...], dict[str, Any]]] = {}
        self._worker: threading.Thread | None = None

    def clips(self) -> list[dict[str, Any]]:
        """Return what is counted of each clip so far; the rest is being counted.

        ``name``, ``n_frames`` and ``counting``; for a counted clip ``revision``, ``annotator``, ``objects``,
        ``motions`` as far as there is an annotation, ``trajectories`` as far as there are any, ``counts``
        where there is both; ``error`` when a file is damaged.
        """
        with self._lock:
            out = [self._summary(session) for session in self.sessions.values()]
            if any(summary["counting"] for summary in out) and self._worker is None:
                self._worker = threading.Thread(target=self._work, daemon=True)
                self._worker.start()
        return out

    def _summary(self, session: ClipSession) -> dict[str, Any]:
        state, counted = self._known.get(session.source.name, (None, {}))
        general = {"name": session.source.name, "n_frames": len(session.source.frames)}
        return general | counted | _work_state(session) | {"counting": state != session.state()}

    def _work(self) -> None:
        while True:
            with self._lock:
                session = next((s for s in self.sessions.values() if self._summary(s)["counting"]), None)
                if session is None:
                    self._worker = None
                    return
            state = session.state()
            try:
                counted = session.summary()
            except KT3DMoSegError as error:
                counted = {"error": str(error)}
            with self._lock:
                self._known[session.source.name] = state, counted


def _work_state(session: ClipSession) -> dict[str, Any]:
    try:
        return {"work": session.work_state()}
    except KT3DMoSegError as error:
        return {"error": str(error)}


def _file_state(path: Path) -> tuple[int, ...]:
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_mtime_ns, status.st_size, status.st_ino
