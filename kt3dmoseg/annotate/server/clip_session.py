"""The state of each clip on the server: frames, trajectories once they are there, labelling, progress.

Who did what on a clip, and when, is in a log that only grows, next to its annotation. One JSON object a line,
each with ``time`` and ``by``; then what happened: ``state``, ``assigned`` (to whom), or the ``revision`` that
was saved, with the names of objects that were ``added``, ``changed``, ``removed``.
"""

import hashlib
import json
import os
import threading
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future
from dataclasses import replace
from datetime import UTC, datetime
from functools import cached_property, lru_cache
from itertools import chain, pairwise
from pathlib import Path
from typing import Any, TypeAlias

from kt3dmoseg import io
from kt3dmoseg.annotate import model, propagation
from kt3dmoseg.annotate.labelling import LabelledTracks, label_tracks_detailed
from kt3dmoseg.annotate.one_click import outline_clicks, sharpened
from kt3dmoseg.annotate.propagation import Region, TrackMotion
from kt3dmoseg.annotate.proposals.residual import moving_groups
from kt3dmoseg.app import warn
from kt3dmoseg.errors import FileFormatError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import check_writable, hold_folder, listed, parse_json, read_bytes, write_text
from kt3dmoseg.frames import ClipFiles, check_frames
from kt3dmoseg.io.formats import recognise
from kt3dmoseg.io.images import picture_size, read_frame, read_frames
from kt3dmoseg.matching import number_in
from kt3dmoseg.types import ByteArray, IntArray, Trajectories

Tracker: TypeAlias = Callable[[Iterator[ByteArray], Callable[[int, int | None], None]], Trajectories]
"""Computes trajectories from frames, reporting (frames done, frames in all)."""

WORK_STATES = ("not started", "in work", "done", "reviewed")
_KEPT_LABELLINGS = 4
_KEPT_OBJECTS = 256
_KEPT_FRAMES = 16
_MOST_MADE = 40
_MAX_LOG = 1 << 24
LONGEST_NAME = 100
# Seconds after which a person who saved nothing is taken to have paused.
_PAUSE = 300


class NotTrackedError(Exception):
    """The trajectories are not there (yet); its arguments are frames done, frames in all, and what failed."""


class ClipSession:
    """One clip that is being labelled; safe to use from several threads."""

    def __init__(self, source: ClipFiles, tracker: Tracker) -> None:
        self.source, self.tracker, self.log = source, tracker, ClipLog(source.annotation)
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._tracks: Trajectories | tuple[int, int, str] = (0, len(source.frames), "")
        self._labelled = lru_cache(_KEPT_LABELLINGS)(self._label)
        self._carried = lru_cache(_KEPT_OBJECTS)(self._carry)
        self._doubted = lru_cache(_KEPT_OBJECTS)(self._doubt)
        self._asked: object = None
        self._counting: Future[None] = Future()
        self.doubt = ""  # what is wrong with the clip's files, for the page
        self._counted: dict[str, Any] = {}

    @cached_property
    def image_size(self) -> tuple[int, int]:
        """Width and height of the frames, from the first one."""
        return picture_size(self.source.frames[0])

    @property
    def frame_names(self) -> list[str]:
        """File names of the frames."""
        return [frame.name for frame in self.source.frames]

    @property
    def numbers(self) -> list[str]:
        """Numbers of the frames: those in the names of their files, where each has its own, else indices."""
        found = [number_in(name) for name in self.frame_names]
        distinct = None not in found and len(set(found)) == len(found)
        return [str(number) for number in (found if distinct else range(len(found)))]

    @property
    def built(self) -> Path:
        """Where a build writes proposals."""
        return self.source.annotation.with_suffix(model.BUILT)

    def check_files(self, *, thoroughly: bool) -> None:
        """Check that the trajectories are of the frames; thoroughly, that everything can be read, too."""
        frames, tracks = self.source.frames, self.source.tracks
        if thoroughly:
            deque(read_frames(frames, "luma"), maxlen=0)
            self.annotation()
        # The other formats keep no sha256; reading all of a release would delay the page.
        if tracks and (thoroughly or recognise(tracks).name in ("hdf5", "npz")):
            check_frames(io.load(tracks).provenance, self.source.name, frames)

    def annotation(self) -> model.Annotation:
        """Read the annotation file, which must be of this clip; an empty annotation when there is none."""
        if not self.source.annotation.exists():
            return model.Annotation(self.source.name, self.image_size, len(self.source.frames))
        return self.load(self.source.annotation)

    def load(self, path: Path, form: str = model.FORMAT) -> model.Annotation:
        """Read an annotation, which must be of this clip; errors name the file."""
        return self.checked(model.load_annotation(path, form), f"{path}: ")

    def checked(self, annotation: model.Annotation, where: str = "") -> model.Annotation:
        """Return the annotation; InvalidValueError, which names the field, when it is of another clip."""
        name, frames = self.source.name, len(self.source.frames)
        return annotation.expect(where, clip=name, image_size=self.image_size, n_frames=frames)

    def trajectories(self, *, wait: bool = False) -> Trajectories:
        """Return the trajectories, or raise NotTrackedError; the first call starts the work."""
        with self._lock:
            if self._thread is None and not isinstance(self._tracks, Trajectories):
                self._thread = threading.Thread(target=self._work, daemon=True)
                self._thread.start()
        if wait and self._thread:
            self._thread.join()
        found = self._tracks
        if not isinstance(found, Trajectories):
            raise NotTrackedError(*found)
        return found

    def labelled(self, annotation: model.Annotation) -> LabelledTracks:
        """Label the clip's trajectories; the last few answers are kept."""
        # Who saved it, and as which revision, changes no label.
        return self._labelled(replace(annotation, revision=0, annotator=""))

    def regions(self, annotation: model.Annotation) -> dict[int, list[Region]]:
        """Return every object's region in every frame; computed only for objects that were edited."""
        return {item.id: self._carried(item.key_frames, item.motion) for item in annotation.objects}

    def weak(self, annotation: model.Annotation) -> dict[int, list[str]]:
        """Return why each object's region is in doubt in each frame; see `overlaps` and `weak_frames`."""
        weak = {item.id: self._doubted(item.key_frames, item.motion) for item in annotation.objects}
        return propagation.overlaps(annotation, self.regions(annotation), weak)

    @cached_property
    def moving(self) -> IntArray | None:
        """Group (N,) of each trajectory: 1 moves as the scene, 2, 3, ... by themselves; None when unknown."""
        try:
            return moving_groups(self.trajectories(wait=True))
        except InvalidValueError:
            return None

    @property
    def folder(self) -> str:
        """Which file the annotation is, without saying where; a page may stay open while servers change."""
        return hashlib.sha256(os.fsencode(self.source.annotation.resolve())).hexdigest()[:16]

    @cached_property
    def proposed(self) -> IntArray | None:
        """Group (N,) of each trajectory by the proposals that a build made, 1 = scene; None without any."""
        if not self.built.exists():
            return None
        built = self.load(self.built, model.PROPOSALS)
        return label_tracks_detailed(self.trajectories(wait=True), built).labels.label

    def outline(self, asked: model.Clicks) -> list[model.Polygon]:
        """Outline what moves with the clicked places; InvalidValueError when they are not in the clip."""
        frames, (width, height) = self.source.frames, self.image_size
        if asked.frame >= len(frames):
            expected = f"a whole number in 0..{len(frames) - 1}"
            raise InvalidValueError("frame", expected=expected, found=str(asked.frame))
        places = [(f"clicks[{k}]", *click[:2]) for k, click in enumerate(asked.clicks)]
        places += [("box", *corner) for corner in (asked.box[:2], asked.box[2:])] if asked.box else []
        for field, x, y in places:
            if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
                expected = f"a place in the {width}x{height} px of the frame"
                raise InvalidValueError(field, expected=expected, found=f"({x:g}, {y:g})")
        tracks = self.trajectories()
        groups = [known for known in (self.proposed, self.moving) if known is not None]
        return outline_clicks(
            lambda k: _gray(frames[k]), tracks, asked.frame, asked.clicks, asked.box, groups, asked.like
        )

    def made(self, item: model.AnnotatedObject) -> list[tuple[int, list[model.Polygon], str]]:
        """Outline an object in the nearest frames it is carried to with doubt: frame, outline, doubt."""
        frames, tracks = self.source.frames, self.trajectories()
        regions, drawn = self._carried(item.key_frames, item.motion), [key.frame for key in item.key_frames]
        doubts = [(k, why) for k, why in enumerate(self._doubted(item.key_frames, item.motion)) if why]
        doubts.sort(key=lambda doubt: min(abs(doubt[0] - frame) for frame in drawn))
        found = [
            (k, sharpened(lambda i: _gray(frames[i]), tracks, k, regions[k].polygons), why)
            for k, why in doubts[:_MOST_MADE]
        ]
        return [(k, polygons, why) for k, polygons, why in found if polygons]

    def work(self) -> dict[str, Any]:
        """Return the last ``state`` set, with its ``by``, ``time`` and ``revision``, and ``assigned``.

        Without one a clip is "in work" when it has an annotation, else "not started".
        """
        state = self.log.last("state") or {"state": WORK_STATES[self.source.annotation.exists()]}
        return state | {"assigned": (self.log.last("assigned") or {"assigned": ""})["assigned"]}

    def set_work(self, by: object, given: dict[str, Any]) -> dict[str, Any]:
        """Set the ``state``, or to whom the clip is ``assigned``; both are kept in the log, with the name."""
        what: dict[str, Any] = {name: given[name] for name in ("state", "assigned") if name in given}
        if "state" in what:
            now = self.annotation()
            what["revision"] = now.revision
            model.StaleRevisionError.check(
                f"{self.source.name}: state", given.get("revision", now.revision), now
            )
        self.log.add(by, **what)
        return self.work()

    def save(self, annotation: model.Annotation, by: str) -> model.Annotation:
        """Save a revision of the annotation, and log what changed; see `save_revision`."""
        before = self.annotation()
        saved = model.save_revision(self.source.annotation, annotation)
        try:
            self.log.add_save(by, before, saved)
        except KT3DMoSegError as error:  # the annotation itself is saved
            warn(f"{self.source.name}: not logged: {error}")
        return saved

    def trouble(self) -> str:
        """Return why the annotation cannot be saved as things are; "" when it can."""
        try:
            check_writable(self.source.annotation.parent)
        except KT3DMoSegError as error:
            return str(error)
        return ""

    def summary(self, pool: Executor) -> dict[str, Any]:
        """Return how far the clip is, JSON-able, as counted last; the pool counts where a file has changed.

        ``name``, ``n_frames``, ``work``, ``minutes`` (by name) and ``counting``; for a counted clip
        ``revision``, ``annotator``, ``objects``, ``motions`` as far as there is an annotation,
        ``trajectories`` as far as there are any, ``counts`` and ``weak`` (regions in doubt) where there is
        both; ``error`` when a file is damaged.
        """
        # Trajectories that no file holds are not computed for it.
        tracks, computed = self.source.tracks, isinstance(self._tracks, Trajectories)
        state = file_version(self.source.annotation), file_version(tracks) if tracks else computed
        if state != self._asked:
            self._asked, self._counting = state, pool.submit(self._count)
        try:
            work: dict[str, Any] = {"work": self.work(), "minutes": self.log.minutes()}
        except KT3DMoSegError as error:
            work = {"error": str(error)}
        general = {"name": self.source.name, "n_frames": len(self.source.frames)}
        return general | self._counted | work | {"counting": not self._counting.done()}

    def _count(self) -> None:
        try:
            self._counted = self._counts()
        except KT3DMoSegError as error:
            self._counted = {"error": str(error)}

    def _counts(self) -> dict[str, Any]:
        session, path = self, self.source.tracks
        if path and not isinstance(self._tracks, Trajectories):  # nobody opened it: nothing of it is kept
            session = ClipSession(self.source, self.tracker)
            session._tracks = session._load(path)
        tracks = session._tracks if isinstance(session._tracks, Trajectories) else None
        out: dict[str, Any] = {} if tracks is None else {"trajectories": len(tracks)}
        if not self.source.annotation.exists():
            return out
        annotation = self.annotation()
        out |= {"revision": annotation.revision, "annotator": annotation.annotator}
        out |= {"objects": len(annotation.objects), "motions": len(annotation.motions)}
        if tracks is None:
            return out
        counts, weak = session.labelled(annotation).counts(), session.weak(annotation)
        return out | {"counts": counts, "weak": sum(map(bool, chain(*weak.values())))}

    def _label(self, annotation: model.Annotation) -> LabelledTracks:
        tracks = self.trajectories(wait=True)
        return label_tracks_detailed(tracks, annotation, regions=self.regions(annotation))

    def _carry(self, keys: tuple[model.KeyFrame, ...], number: model.Motion) -> list[Region]:
        tracks = TrackMotion(self.trajectories(wait=True))
        return propagation.propagate_keys(keys, len(self.source.frames), tracks, number)

    def _doubt(self, keys: tuple[model.KeyFrame, ...], number: model.Motion) -> list[str]:
        return propagation.weak_frames(self._carried(keys, number), TrackMotion(self.trajectories(wait=True)))

    def _work(self) -> None:
        frames, total = (read_frame(path, "luma") for path in self.source.frames), len(self.source.frames)

        def progress(done: int, _: int | None) -> None:
            self._tracks = (done, total, "")

        try:
            path = self.source.tracks
            self._tracks = self._load(path) if path else self.tracker(frames, progress)
        except KT3DMoSegError as error:
            self._tracks = (0, total, str(error))

    def _load(self, path: Path) -> Trajectories:
        dense, frames = io.load(path).dense, len(self.source.frames)
        if dense.n_frames != frames:
            expected = f"{frames} frames, as the clip has"
            raise InvalidValueError(f"{path}", expected=expected, found=f"{dense.n_frames}")
        return Trajectories(dense.xy, dense.visible, dense.track_id, self.image_size)


def sessions_of(clips: Mapping[str, ClipFiles], tracker: Tracker) -> dict[str, ClipSession]:
    """Make the sessions of clips; what is wrong with a file is raised for the only clip, else a warning."""
    sessions = {name: ClipSession(source, tracker) for name, source in clips.items()}
    for name, session in sessions.items():
        try:
            session.check_files(thoroughly=len(sessions) == 1)
        except KT3DMoSegError as error:
            if len(sessions) == 1:
                raise
            session.doubt = str(error)
            warn(f"{name}: {error}")
    files = {source.annotation.name for source in clips.values()}
    (folder,) = {source.annotation.parent for source in clips.values()}
    for path in listed(folder) if folder.is_dir() else []:
        if path.name not in files and path.name.lower() in {file.lower() for file in files}:
            warn(f"{path} is of none of the clips by its case")
    return sessions


@lru_cache(_KEPT_FRAMES)
def _gray(path: Path) -> ByteArray:
    return read_frame(path, "luma")


class ClipLog:
    """The log ``<clip>.log.jsonl`` of a clip."""

    def __init__(self, annotation: Path) -> None:
        self.path = annotation.with_suffix(".log.jsonl")
        self._read: tuple[object, list[dict[str, Any]]] = (None, [])

    def entries(self) -> list[dict[str, Any]]:
        """Return all entries, the first first; FileFormatError with the line that is damaged."""
        if not (version := file_version(self.path)):
            return []
        if self._read[0] != version:
            lines = read_bytes(self.path, _MAX_LOG).splitlines()
            found = [_entry(line, f"{self.path}: line {k}") for k, line in enumerate(lines, 1)]
            self._read = version, found
        return self._read[1]

    def add(self, by: object, **what: object) -> None:
        """Add an entry of now; InvalidValueError for a state or name that is none."""
        if what.get("state", WORK_STATES[0]) not in WORK_STATES:
            expected = f"one of {', '.join(WORK_STATES)}"
            raise InvalidValueError("state", expected=expected, found=repr(what["state"])[:80])
        _check_name("assigned", what.get("assigned", ""))
        # What is saved may have been drawn by nobody in particular.
        if "revision" not in what or "state" in what:
            _check_name("by", by, least=1)
        entry = {"time": datetime.now(UTC).isoformat(timespec="seconds"), "by": str(by).strip()} | what
        with hold_folder(self.path.parent):
            before = read_bytes(self.path, _MAX_LOG).decode() if self.path.exists() else ""
            write_text(self.path, f"{before}{json.dumps(entry, ensure_ascii=False)}\n")

    def add_save(self, by: str, before: model.Annotation, saved: model.Annotation) -> None:
        """Add what was saved."""
        old, new = ({item.id: item for item in side.objects} for side in (before, saved))
        found = {
            "added": [item.name for number, item in new.items() if number not in old],
            "changed": [item.name for number, item in new.items() if number in old and old[number] != item],
            "removed": [item.name for number, item in old.items() if number not in new],
            "lassos": ["changed"] if before.marks != saved.marks else [],
        }
        self.add(by, revision=saved.revision, **{what: names for what, names in found.items() if names})

    def last(self, what: str) -> dict[str, Any] | None:
        """Return the last entry with this, ``state`` or ``assigned``."""
        return next((entry for entry in reversed(self.entries()) if what in entry), None)

    def minutes(self) -> dict[str, float]:
        """Return how long each person worked: between saves of theirs not more than five minutes apart."""
        saved = defaultdict(list)
        for entry in self.entries():
            saved[entry["by"]].append(datetime.fromisoformat(entry["time"]))
        gaps = {by: [(b - a).total_seconds() for a, b in pairwise(times)] for by, times in saved.items()}
        return {by: sum(gap for gap in all_of if gap <= _PAUSE) / 60 for by, all_of in gaps.items()}


def file_version(path: Path) -> tuple[int, ...]:
    """Return what changes whenever a file is written; empty when there is none."""
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_mtime_ns, status.st_size, status.st_ino


def _check_name(field: str, value: object, least: int = 0) -> None:
    if not isinstance(value, str) or not least <= len(value.strip()) <= LONGEST_NAME:
        expected = f"the annotator's name, of {least} to {LONGEST_NAME} characters"
        raise InvalidValueError(field, expected=expected, found=repr(value)[:80])


def _entry(line: bytes, where: str) -> dict[str, Any]:
    found = parse_json(line, where)
    try:
        datetime.fromisoformat(found["time"])
        good = isinstance(found["by"], str) and found.get("state", WORK_STATES[0]) in WORK_STATES
    except (TypeError, KeyError, ValueError):
        good = False
    if not good:
        raise FileFormatError(where, expected="time, by and what was done", found=repr(found)[:80])
    return dict(found)
