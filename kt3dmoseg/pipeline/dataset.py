"""A dataset: one HDF5 file per clip, in parallel, resumable, up to date or rebuilt with a reason."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2

from kt3dmoseg.errors import InputFileError, InvalidValueError, KT3DMoSegError, MissingDependencyError
from kt3dmoseg.files import check_writable, hold_folder
from kt3dmoseg.frames import FrameSource, find_sources
from kt3dmoseg.io import hdf5
from kt3dmoseg.io.fields import check_name
from kt3dmoseg.parallel import Progress, run_tasks
from kt3dmoseg.pipeline.clip import Job, Settings, check_label_paths, label_files, reason_to_build
from kt3dmoseg.pipeline.masks import has_masks


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
    """

    name: str
    status: Literal["built", "up to date", "failed"]
    reason: str
    path: Path
    counts: Mapping[str, int]
    labels: str = ""


def build_dataset(
    frames: str | os.PathLike[str] | Sequence[FrameSource],
    output: str | os.PathLike[str],
    *,
    annotations: str | os.PathLike[str] | None = None,
    masks: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    dask: str = "",
    force: bool = False,
    flow_parameters: Mapping[str, Any] | None = None,
    cache: str | os.PathLike[str] | None = None,
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
    workers : int, optional
        Number of processes; by default one per core. Each computes with one thread.
    dask : str
        Address of a Dask scheduler, instead of processes; its workers must see the same folders.
    force : bool
        Build also what is up to date.
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
    settings = Settings.of(options, flow_parameters)
    sources = find_sources(frames) if isinstance(frames, (str, os.PathLike)) else list(frames)
    _check_names(sources)
    check_label_paths([source.name for source in sources], annotations, masks)
    _check_masks(sources, masks)
    if workers is not None and workers < 1:
        raise InvalidValueError("workers", expected="at least 1", found=str(workers))
    count = workers or len(os.sched_getaffinity(0))
    with _sole_writer(Path(output)) as folder:
        build = _Build(folder, annotations, masks, settings, cache, force)
        outcomes = []
        for _, outcome in run_tasks(
            build, sources, lost=build.lost, workers=count, dask=dask, progress=progress
        ):
            outcomes.append(outcome)
            if report is not None:
                report(outcome)
    return sorted(outcomes, key=lambda outcome: outcome.name)


@dataclass(frozen=True)
class _Build:
    """What workers do with each clip; one that is up to date is left alone, an error is a failed outcome."""

    output: Path
    annotations: str | os.PathLike[str] | None
    masks: str | os.PathLike[str] | None
    settings: Settings
    cache: str | os.PathLike[str] | None
    force: bool

    def __call__(self, source: FrameSource, progress: Progress) -> Outcome:
        cv2.setNumThreads(1)  # also with one worker, which is the calling process
        name, target = source.name, self.output / f"{source.name}.h5"
        try:
            files = label_files(name, self.annotations, self.masks)
            job, labels = Job(source, files, self.settings), "".join(files)
            reason = reason_to_build(target, job.inputs, force=self.force)
            if not reason:
                return Outcome(name, "up to date", "", target, {}, labels)
            clip = job.build(self.cache, lambda done, total: progress(name, done, total))
            for partial in self.output.glob(f".{target.name}.*.part"):  # of a build that was killed
                partial.unlink(missing_ok=True)
            hdf5.write(clip, target)
        except MissingDependencyError:  # the same for every clip
            raise
        except KT3DMoSegError as error:
            return Outcome(name, "failed", str(error), target, {})
        sizes = clip.n_frames, len(clip.dense), len(clip.evaluated), clip.n_motions
        counts = dict(zip(("frames", "trajectories", "evaluated", "motions"), sizes, strict=True))
        return Outcome(name, "built", reason, target, counts, labels)

    def lost(self, source: FrameSource, reason: str) -> Outcome:
        advice = "perhaps memory ran out: run again with fewer --workers; finished clips are kept"
        target = self.output / f"{source.name}.h5"
        return Outcome(source.name, "failed", f"{reason}; {advice}", target, {})


@contextmanager
def _sole_writer(output: Path) -> Iterator[Path]:
    """Make the folder and hold it for this process; leave none where nothing came of it."""

    def refuse() -> None:
        raise InputFileError(
            f"{output}",
            expected="no other build",
            found="another build running in this folder",
            fix="wait for it",
        )

    with hold_folder(output, busy=refuse) as folder:
        try:
            check_writable(folder)
            yield folder
        finally:
            with suppress(OSError):
                folder.rmdir()  # succeeds only when it is empty


def _check_names(sources: Sequence[FrameSource]) -> None:
    names = [source.name for source in sources]
    for name in names:
        check_name(name, "name")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        both = " and ".join(source.where for source in sources if source.name == twice[0])
        raise InvalidValueError(
            f"clip {twice[0]}", expected="one source", found=both, fix="rename or remove one"
        )


def _check_masks(sources: Sequence[FrameSource], given: str | os.PathLike[str] | None) -> None:
    """Check that masks belong to clips by name: one clip's must not label all, nor a wrong folder none."""
    if given is None:
        return
    masks = Path(given)
    if len(sources) > 1 and has_masks(masks):
        raise InvalidValueError(
            f"{masks}",
            expected=f"one folder of masks per clip, as {masks / sources[0].name}",
            found=f"masks, and {len(sources)} clips",
            fix="build their clip alone, or move them into a folder of its name",
        )
    if not any(has_masks(folder) for folder in (masks, *(masks / source.name for source in sources))):
        raise InputFileError(
            f"{masks}", expected=f"masks (.png) there, or in {masks / sources[0].name}", found="none"
        )
