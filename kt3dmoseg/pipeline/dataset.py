"""From frames to dataset files: one HDF5 file per clip, in parallel, up to date or rebuilt with a reason."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

import cv2
import h5py
import numpy as np
import scipy

import kt3dmoseg
from kt3dmoseg import pipeline, tracking
from kt3dmoseg.annotate import Annotation, save_annotation
from kt3dmoseg.annotate.model import BUILT, PROPOSALS
from kt3dmoseg.errors import InputFileError, InvalidValueError, KT3DMoSegError, MissingDependencyError
from kt3dmoseg.files import PathLike, check_writable, hold_folder, sha256_file, sha256_files
from kt3dmoseg.flow import backend_identity, create
from kt3dmoseg.frames import (
    FrameFolder,
    FrameSource,
    KittiClip,
    find_sources,
    one_source,
    recorded_inputs,
    source_names,
)
from kt3dmoseg.io import hdf5
from kt3dmoseg.options import from_mapping, option_names
from kt3dmoseg.parallel import Progress, cache_key, run_tasks
from kt3dmoseg.pipeline import BuildOptions
from kt3dmoseg.pipeline.inputs import find_labels, find_tracks, label_clip, read_tracks
from kt3dmoseg.registry import unknown_name
from kt3dmoseg.synthetic import plan_drives
from kt3dmoseg.synthetic.drives import Part, SyntheticDrive
from kt3dmoseg.text import several
from kt3dmoseg.tracking import TrackOptions, subsample_background, track
from kt3dmoseg.types import ByteArray, Clip, IntArray, Labels, Trajectories

_Task: TypeAlias = tuple[FrameSource, dict[str, list[Path]], Path | None]  # what labels it, its tracks
_Report: TypeAlias = Callable[[int, int | None], None]
_SMALLEST = 8  # trajectories; a synthetic vehicle with fewer is no motion of the benchmark
_LIBRARIES = {"kt3dmoseg": kt3dmoseg, "numpy": np, "scipy": scipy, "opencv": cv2, "h5py": h5py}


@dataclass(frozen=True)
class Outcome:
    """What became of one clip.

    Parameters
    ----------
    name : str
        The clip.
    status : {"built", "up to date", "failed"}
        What happened.
    reason : str
        Why it was built, or why it failed, in one line.
    path : Path
        Its file.
    counts : mapping of str to int
        Frames, trajectories, evaluated and motions of a clip that was built.
    labels : {"annotation", "masks", ""}
        What it is labelled by.
    notes : tuple of str
        What a person should know of its frames and labels.
    """

    name: str
    status: Literal["built", "up to date", "failed"]
    reason: str
    path: Path
    counts: Mapping[str, int]
    labels: str = ""
    notes: tuple[str, ...] = ()


def build_clip(
    source: PathLike | FrameSource,
    *,
    annotation: PathLike | None = None,
    masks: PathLike | None = None,
    shift: int | None = None,
    tracks: PathLike | None = None,
    flow_parameters: Mapping[str, Any] | None = None,
    cache: PathLike | None = None,
    progress: Callable[[int, int | None], None] | None = None,
    **options: Any,  # noqa: ANN401
) -> Clip:
    """Build one clip from its frames: a folder, a video, or what `find_sources` and `kitti_sources` list.

    `annotation` is the file, or `masks` the folder of DAVIS or KITTI MOTS masks, that labels come from;
    `shift` is added to the frame numbers in the masks' names. `tracks` is a file with the trajectories of
    another tracker. `flow_parameters` are those of the backend; `cache` is a folder in which flow fields are
    kept and looked up by content; `progress` is called with (frames done, frames in all or None). `options`
    are fields of `BuildOptions` and of `kt3dmoseg.tracking.TrackOptions`.

    With labels all foreground and the drawn part of the background are evaluated, else every trajectory,
    label 0. InputFileError or FileFormatError for frames, annotation or masks that cannot be read;
    InvalidValueError or UnknownNameError for a bad option.
    """
    settings = _Settings(options, flow_parameters, cache, shift, tracks is not None)
    if isinstance(source, (str, os.PathLike)):
        source = one_source(source)
    [files] = find_labels([source.name], annotation, masks)
    [given] = [None] if tracks is None else find_tracks([source.name], tracks)
    return _Job((source, files, given), settings).build(progress)


def build_dataset(
    frames: PathLike | Sequence[FrameSource],
    output: PathLike,
    *,
    annotations: PathLike | None = None,
    masks: PathLike | None = None,
    shift: int | None = None,
    tracks: PathLike | None = None,
    workers: int | None = None,
    dask: str = "",
    force: bool = False,
    propose: PathLike | None = None,
    flow_parameters: Mapping[str, Any] | None = None,
    cache: PathLike | None = None,
    progress: Callable[[str, int, int | None], None] | None = None,
    report: Callable[[Outcome], None] | None = None,
    **options: Any,  # noqa: ANN401
) -> list[Outcome]:
    """Build every clip of a folder into one HDF5 file each.

    A clip whose file was built from the same inputs (sources, options, versions) is left alone.
    Files are written atomically; after an interruption the same call finishes the work, and gives
    the same bytes whatever the number of workers. A clip that fails does not stop the others.

    Parameters
    ----------
    frames : path or sequence of FrameSource
        What `find_sources` understands: a folder of clips, one clip, a video, a KITTI raw root.
    output : path
        Folder of the files ``<clip>.h5``.
    annotations, masks : path, optional
        Folders that labels come from, ``<clip>.json`` or ``<clip>/*.png``; a clip without stays
        unlabelled, but one clip at least must have some.
    shift : int, optional
        Add this to the frame numbers in the masks' names.
    tracks : path, optional
        Folder of trajectories, ``<clip>.npz`` or any other format that is read, instead of tracking; a clip
        without fails.
    workers : int, optional
        Number of processes; by default one per core. Each computes with one thread.
    dask : str
        Address of a Dask scheduler, instead of processes; its workers must see the same folders.
    force : bool
        Build also what is up to date.
    propose : path, optional
        Folder in which ``<clip>.proposals.json`` is written for every clip that nothing labels: outlines for
        `kt3dmoseg label`, of what the proposer "mseg" finds to move. They are never read as labels.
    flow_parameters, cache
        As in `build_clip`.
    progress : callable, optional
        Called with (clip, frames done, frames in all or None).
    report : callable, optional
        Called with each clip's outcome as it comes.
    **options
        Fields of `BuildOptions` and of `kt3dmoseg.tracking.TrackOptions`.

    Returns
    -------
    list of Outcome
        In the order of the clips' names.

    Raises
    ------
    InputFileError
        When `frames` holds nothing, `annotations` or `masks` hold none of any clip, or `output` cannot be
        written or is being built by another process.
    InvalidValueError, UnknownNameError
        For a bad option.
    MissingDependencyError
        When the flow backend needs a package that is not installed.
    """
    settings = _Settings(options, flow_parameters, cache, shift, tracks is not None)
    if shift is not None and masks is None:
        raise InvalidValueError("shift", expected="masks, whose frame numbers it changes", found="none")
    sources = find_sources(frames) if isinstance(frames, (str, os.PathLike)) else list(frames)
    names = source_names(sources)
    labels = find_labels(names, annotations, masks)
    given = [None] * len(names) if tracks is None else find_tracks(names, tracks)
    tasks = list(zip(sources, labels, given, strict=True))
    # Of a system that does not say how many cores this process may use, all.
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

    def lost(task: _Task, reason: str) -> Outcome:
        advice = "perhaps memory ran out: run again with fewer workers; finished clips are kept"
        name = task[0].name
        return Outcome(name, "failed", f"{reason}; {advice}", Path(output, f"{name}.h5"), {})

    outcomes = []
    check_writable(Path(output))
    with hold_folder(output, alone="build") as folder:
        work = partial(_build_file, settings, folder, force)
        if propose is not None:
            check_writable(Path(propose))
            work = partial(_build_and_propose, settings, folder, force, Path(propose))
        where: Any = {"workers": cores if workers is None else workers, "dask": dask}
        for _, outcome in run_tasks(work, tasks, lost=lost, progress=progress, **where):
            outcomes.append(outcome)
            if report is not None:
                report(outcome)
    return sorted(outcomes, key=lambda outcome: outcome.name)


def build_synthetic(
    output: PathLike,
    *,
    part: Part | None = None,
    seed: int = 0,
    first: int | None = None,
    **options: Any,  # noqa: ANN401
) -> list[Outcome]:
    """Make the synthetic benchmark: render, track and label its drives, one clip file each.

    Drives that are there already are left alone; an interrupted run is finished by the same call. `part` is
    "public" or "test", for only this half; `seed` 0 is the benchmark, others give other drives, under other
    names; `first` takes only so many drives of each half. `options`, result and errors are those of
    `build_dataset`, without annotations and masks.
    """
    plans = [p for p in plan_drives(seed) if part in (None, p.part) and (first is None or p.number <= first)]
    return build_dataset(
        [SyntheticDrive(plan) for plan in plans], output, **{"smallest": _SMALLEST} | options
    )


class _Settings:
    """What clips depend on apart from frames and labels, and the cache; worker processes get it, too."""

    def __init__(
        self,
        options: Mapping[str, Any],
        flow: Mapping[str, Any] | None,
        cache: PathLike | None,
        shift: int | None,
        tracked: bool,
    ) -> None:
        own, tracker = option_names(BuildOptions), option_names(TrackOptions)
        for name in options:
            if name not in (*own, *tracker):
                raise unknown_name("option", name, [*own, *tracker])
        self.build = from_mapping(BuildOptions, {k: v for k, v in options.items() if k in own})
        self.tracks = from_mapping(TrackOptions, {k: v for k, v in options.items() if k in tracker})
        self.flow, self.cache, self.shift = create(self.build.flow, **(flow or {})), cache, shift
        self.options = asdict(self.build) | asdict(self.tracks)
        self.flow_identity: Any = backend_identity(self.flow)
        if tracked:  # by another tracker: what ours would do neither counts nor may be asked for
            plain = {**asdict(TrackOptions()), "flow": BuildOptions.flow}
            asked = [key for key in plain if key != "min_length" and self.options.pop(key) != plain[key]]
            if asked:
                expected = "no options of tracking with given trajectories, but for min_length"
                raise InvalidValueError("tracks", expected=expected, found=", ".join(asked))
            self.flow_identity = ""


def _build_file(settings: _Settings, output: Path, force: bool, task: _Task, progress: Progress) -> Outcome:
    """Build one clip unless its file is up to date; an error is a failed outcome."""
    cv2.setNumThreads(1)  # also with one worker, which is the calling process
    source, labels = task[0], "".join(task[1])
    name, target = source.name, output / f"{source.name}.h5"
    try:
        job = _Job(task, settings)
        reason = _reason_to_build(target, job.inputs, force)
        if not reason:
            return Outcome(name, "up to date", "", target, {}, labels)
        clip = job.build(partial(progress, name))
        for unfinished in output.glob(f".{target.name}.*.part"):  # of a build that was killed
            unfinished.unlink(missing_ok=True)
        hdf5.write(clip, target)
    except MissingDependencyError:  # the same for every clip
        raise
    except KT3DMoSegError as error:
        return Outcome(name, "failed", str(error), target, {})
    sizes = clip.n_frames, len(clip.dense), len(clip.evaluated), clip.n_motions
    counts = dict(zip(("frames", "trajectories", "evaluated", "motions"), sizes, strict=True))
    counts |= clip.provenance.get("dropped", {})
    return Outcome(name, "built", reason, target, counts, labels, tuple(job.notes))


def _build_and_propose(
    settings: _Settings, output: Path, force: bool, folder: Path, task: _Task, progress: Progress
) -> Outcome:
    """Build one clip; write proposals where nothing labels it and none of the same trajectories are there."""
    from kt3dmoseg.annotate import proposals

    outcome = _build_file(settings, output, force, task, progress)
    name, file = outcome.name, folder / f"{outcome.name}{BUILT}"
    kept = file.exists() and outcome.status == "up to date"
    if outcome.status == "failed" or outcome.labels or kept or (folder / f"{name}.json").exists():
        return outcome
    try:
        dense = hdf5.read(outcome.path).dense
        empty = Annotation(name, dense.image_size or (0, 0), dense.n_frames, annotator="build --propose")
        source = task[0]  # proposers read pictures, not videos
        paths = source.paths() if isinstance(source, FrameFolder | KittiClip) else []
        request = proposals.Request(name, empty, dense, tuple(paths))
        objects = proposals.propose("mseg", request)
        save_annotation(file, replace(empty, objects=tuple(objects)), PROPOSALS)
    except KT3DMoSegError as error:
        return replace(outcome, reason=f"{outcome.reason}; nothing proposed: {error}".removeprefix("; "))
    return replace(outcome, counts={**outcome.counts, "proposals": len(objects)})


class _Job:
    """One clip to build, checked, without a frame decoded.

    Its `inputs` are everything that the bytes of the clip depend on, as JSON values; a null flow means a
    backend that depends on more than its parameters.
    """

    def __init__(self, task: _Task, settings: _Settings) -> None:
        self.source, self.files, self.tracks = task
        self.settings, self.info = settings, self.source.inspect()
        self.notes = [*self.info.notes]
        labels = {kind: sha256_file(paths[0]) for kind, paths in self.files.items()}
        if masks := self.files.get("masks"):
            content = {"files": sha256_files(masks), "names": [path.name for path in masks]}
            labels["masks"] = cache_key(content | {"shift": settings.shift})
        self.inputs = {
            "name": self.source.name,
            "source": self.info.description,
            "labels": labels,
            "options": settings.options,
            "flow": settings.flow_identity,
            "versions": {name: library.__version__ for name, library in _LIBRARIES.items()},
            "algorithms": {"tracking": tracking.ALGORITHM_VERSION, "pipeline": pipeline.ALGORITHM_VERSION},
        }
        if self.tracks is not None:
            self.inputs["tracks"] = {"sha256": sha256_file(self.tracks)}

    def build(self, progress: Callable[[int, int | None], None] | None) -> Clip:
        """Track, label, subsample."""
        source, settings, numbers = self.source, self.settings, self.source.numbers()
        report = None if progress is None else lambda done, _: progress(done, len(numbers))
        frames = source.frames(settings.build.colour)
        provenance: dict[str, Any] = {"format": "kt3dmoseg-build", "inputs": self.inputs}
        if self.tracks is not None:
            dense, dropped = read_tracks(self.tracks, frames, numbers, settings.tracks.min_length)
            provenance |= {"dropped": dropped} if dropped else {}
        else:
            dense = self._track(frames, report)
        if isinstance(source, SyntheticDrive):
            labels: Labels | None = source.label(dense)
            provenance["attributes"] = dict(source.measure())
        else:
            names = self.info.names or [f"{number:06d}.png" for number in numbers]
            labels = label_clip(source.name, self.files, dense, names, settings.shift, self.notes)
        info, (rows, chosen) = self.info, self._evaluated(labels, len(dense))
        known, kept = [{*each.motions.tolist()} if each else set() for each in (labels, chosen)]
        for what, lacking in (("labelled as", {*chosen.names} - known), ("evaluated of", known - kept)):
            if lacking:
                named = [chosen.names.get(label, f"motion {label}") for label in sorted(lacking)]
                self.notes.append(f"nothing is {what} {several(named)}")
        return Clip(
            source.name, dense, rows, chosen, np.array(numbers), info.timestamps, info.camera, provenance
        )

    def _track(self, frames: Iterator[ByteArray], report: _Report | None) -> Trajectories:
        settings = self.settings
        options = asdict(settings.tracks)
        try:
            return track(frames, settings.flow, cache=settings.cache, progress=report, **options)
        except InvalidValueError as error:  # of the frames' arrays: name their source
            raise InvalidValueError(f"{self.source.where}: {error}") from None

    def _evaluated(self, labels: Labels | None, count: int) -> tuple[IntArray, Labels]:
        if labels is None:
            return np.arange(count), Labels(np.zeros(count, dtype=np.int64))
        chosen = self.settings.build
        # The clip's name takes part, so that a clip's draw does not depend on the others.
        rng = np.random.default_rng([chosen.seed, *self.source.name.encode()])
        rows = subsample_background(labels, rng, chosen.fraction, chosen.smallest)
        return rows, Labels(labels.label[rows], labels.background, labels.names)


def _reason_to_build(target: Path, wanted: Mapping[str, Any], force: bool) -> str:
    """Explain why a clip's file must be written (with `force`, always); empty when it is up to date.

    An intact clip that no build has made is refused, unless forced: it may be the only copy.
    """
    if not target.exists():
        return "new"
    try:
        found = recorded_inputs(hdf5.provenance(target))
    except KT3DMoSegError as error:
        return f"the file there is no intact clip ({error})"
    if not found and not force:
        expected = "no file, or a clip that was built from frames"
        fix = "give another output folder, or force=True to write over it"
        raise InputFileError(f"{target}", expected=expected, found="another clip", fix=fix)
    if wanted["flow"] is None:
        return "the fields of this flow backend may depend on more than its parameters"
    changes = list(_differences(found, wanted, "")) if found else []
    more = f"; {len(changes) - 3} more changes" if len(changes) > 3 else ""
    return "; ".join(changes[:3]) + more or "forced" * force


def _differences(old: object, new: object, where: str) -> Iterator[str]:
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in sorted({*old, *new}):
            yield from _differences(old.get(key), new.get(key), f"{where} {key}".strip())
    elif old != new and (old is None or new is None):
        yield f"{where} {'added' if old is None else 'removed'}"
    elif old != new:
        checksum = where.startswith("labels") or where.endswith("sha256")
        yield f"{where} changed" if checksum else f"{where} was {old!r}, now {new!r}"
