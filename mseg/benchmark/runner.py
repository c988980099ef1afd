"""Methods x clips x seeds, cached, in parallel, scored by the protocol."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from kt3dmoseg.errors import InputFileError, InvalidValueError
from kt3dmoseg.io import dataset_paths, load
from kt3dmoseg.parallel import Cache, run_tasks
from kt3dmoseg.types import Clip, Labels
from mseg.benchmark.results import BenchmarkResult
from mseg.benchmark.tasks import (
    Configuration,
    Task,
    keep_outcome,
    lost_task,
    outcome_key,
    read_outcome,
    run_task,
    seed_numbers,
)
from mseg.evaluation import Protocol, classification_error, clip_checksum, load_protocol
from mseg.evaluation.scoring import provenance_of
from mseg.methods import create

VARIABLE = "KT3DMOSEG_DATA"
_SHARED = Path("..") / "shared" / "data"
# MTPV62 takes 50 of its 62 clips from Hopkins155.
_BORROWED = {"mtpv62": ("hopkins155",)}

Progress = Callable[[int, int, str], None]
"""Called with the number of tasks done, their total, and the name of the last."""


def run(
    benchmark: str = "kt3dmoseg",
    methods: Iterable[str | Configuration] = ("subset",),
    *,
    data: Sequence[str | os.PathLike[str]] = (),
    seeds: int | Sequence[int] = 1,
    parameters: Mapping[str, Any] | None = None,
    number: Literal["given", "found"] = "given",
    workers: int = 1,
    dask: str = "",
    cache: str | os.PathLike[str] | None = None,
    kernels: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> BenchmarkResult:
    """Run methods on every clip of a benchmark that is found, and score them.

    A clip on which a method fails counts as fully wrong.

    Parameters
    ----------
    benchmark : str
        Name of a protocol, see `mseg.evaluation.list_protocols`.
    methods : iterable of str or Configuration
        What to run.
    data : sequence of paths
        Folders of clips; default: see `mseg.benchmark.find_clips`.
    seeds : int or sequence of int
        Number of seeds, counted from 0, or the seeds.
    parameters : mapping, optional
        Parameters for those of the methods that have them.
    number : {"given", "found"}
        Whether the methods are given the number of motions of each clip, or find it. One that cannot fails.
    workers : int
        Processes on this machine.
    dask : str
        Address of a Dask scheduler, instead of processes.
    cache : path, optional
        Folder of outcomes: what is there already is not run again.
    kernels : path, optional
        Folder of kernels, for sweeps over what comes after them.
    progress : callable, optional
        Called as tasks finish.

    Returns
    -------
    BenchmarkResult

    Raises
    ------
    UnknownNameError
        For a benchmark, method or parameter that does not exist.
    InputFileError
        When there are no clips.
    """
    protocol = load_protocol(benchmark)
    configurations = configure([methods] if isinstance(methods, str) else methods, parameters or {})
    wanted = seed_numbers(seeds)
    if not configurations:
        raise InvalidValueError("benchmark", expected="at least one method", found="none")
    paths, others = find_clips(protocol, data)
    clips = [load(path) for path in paths.values()]
    numbers = [_given(clip, number) for clip in clips]
    shape = (len(configurations), len(clips), len(wanted))
    keys = {
        (m, i, s): outcome_key(configurations[m], clips[i], numbers[i], wanted[s])
        for m, i, s in np.ndindex(shape)
    }
    store = Cache(cache)
    outcomes = {key: outcome for key in keys.values() if (outcome := read_outcome(store, key))}
    tasks = _tasks(configurations, clips, numbers, wanted, keys, set(outcomes), str(kernels or ""))
    for done, (task, made) in enumerate(
        run_tasks(run_task, tasks, lost=lost_task, workers=workers, dask=dask), 1
    ):
        for outcome in made:
            outcomes[outcome.key] = outcome
            keep_outcome(store, outcome)
        if progress:
            progress(done, len(tasks), task.name)
    errors, seconds, failures, notes = np.ones(shape), np.full(shape, np.nan), [], []
    found = np.zeros(shape, dtype=np.int64)
    for (m, i, s), key in keys.items():
        outcome = outcomes[key]
        seconds[m, i, s] = outcome.seconds
        if outcome.labels is None:
            failures.append((configurations[m], clips[i].name, wanted[s], outcome.reason))
        else:
            truth = clips[i].labels.label
            errors[m, i, s] = classification_error(truth, outcome.labels)
            found[m, i, s] = Labels(outcome.labels[truth > 0]).n_motions
        if outcome.notes:
            notes.append((configurations[m], clips[i].name, wanted[s], outcome.notes))
    named = dict(zip(paths, clips, strict=True))
    motions = {name: clip.n_motions for name, clip in named.items()}
    checksums = {name: clip_checksum(clip) for name, clip in named.items()}
    return BenchmarkResult(
        protocol,
        configurations,
        motions,
        wanted,
        errors,
        seconds,
        tuple(failures),
        tuple(others),
        tuple(notes),
        found,
        {name: int((clip.labels.label > 0).sum()) for name, clip in named.items()},
        provenance_of(named, checksums, protocol.version_of(checksums)),
        number,
    )


def find_clips(
    protocol: Protocol, data: Sequence[str | os.PathLike[str]] = ()
) -> tuple[dict[str, Path], list[str]]:
    """Find the clips of a benchmark.

    Parameters
    ----------
    protocol : Protocol
        The benchmark.
    data : sequence of paths
        Folders of clips; of clips of one name the first counts. By default the folder that the
        protocol names (and for MTPV62 that of Hopkins155) in ``$KT3DMOSEG_DATA``, or else in
        ``../shared/data``.

    Returns
    -------
    clips : dict of str to Path
        The clips that belong to the benchmark, sorted by name.
    others : list of str
        Names of clips that lie there and do not belong to it.

    Raises
    ------
    InputFileError
        When a folder is missing or none of its clips belongs to the benchmark.
    """
    folders = [Path(folder) for folder in data] or _default_folders(protocol)
    found: dict[str, Path] = {}
    for folder in folders:
        found = {**dataset_paths(folder), **found}
    clips = {name: found[name] for name in sorted(found) if protocol.holds(name)}
    if not clips:
        there = f"{len(found)} others ({', '.join(list(found)[:3])})"
        raise InputFileError(", ".join(map(str, folders)), expected=f"clips of {protocol.title}", found=there)
    return clips, sorted(set(found) - set(clips))


def configure(
    methods: Iterable[str | Configuration], parameters: Mapping[str, Any]
) -> tuple[Configuration, ...]:
    """Make configurations, each once; a parameter goes to the methods that have it, and one of them must."""
    made, used, first = [], set[str](), ""
    for method in methods:
        configuration = method
        if not isinstance(configuration, Configuration):
            first = first or configuration
            own = {k: v for k, v in parameters.items() if k in vars(create(configuration))}
            used |= set(own)
            configuration = Configuration(configuration, own)
        create(configuration.method, **configuration.parameters)
        made.append(configuration)
    for name, value in parameters.items():
        if name not in used:
            create(first or "subset", **{name: value})
    return tuple({configuration.title: configuration for configuration in made}.values())


def _default_folders(protocol: Protocol) -> list[Path]:
    named = os.environ.get(VARIABLE)
    root = Path(named) if named else _SHARED
    folder = _named(root, protocol.data)
    if not folder.is_dir():
        raise InputFileError(
            str(folder), expected=f"the clips of {protocol.title}", found="no such folder",
            fix=f"give --data DIR, or set {VARIABLE} to the folder that holds {protocol.data}/",
        )  # fmt: skip
    borrowed = (_named(root, name) for name in _BORROWED.get(protocol.name, ()))
    return [folder, *(other for other in borrowed if other.is_dir())]


def _named(root: Path, name: str) -> Path:
    """Find a folder by its name, or by that of the archive it comes from: ``Hopkins155`` for hopkins155."""
    alike = sorted(path for path in root.glob("*/") if path.name.lower() == name.lower())
    return root / name if (root / name).is_dir() or not alike else alike[0]


def _given(clip: Clip, number: str) -> int | None:
    if number not in ("given", "found"):
        raise InvalidValueError("number", expected="given or found", found=f"{number!r:.40}")
    return clip.n_motions if number == "given" else None


def _tasks(
    configurations: Sequence[Configuration],
    clips: Sequence[Clip],
    numbers: Sequence[int | None],
    seeds: Sequence[int],
    keys: Mapping[tuple[int, int, int], str],
    claimed: set[str],
    kernels: str,
) -> list[Task]:
    """One task per clip and seed that has anything left to run; large clips first."""
    tasks = []
    for i in sorted(range(len(clips)), key=lambda i: -len(clips[i].evaluated) * clips[i].n_frames):
        for s, seed in enumerate(seeds):
            work = [(keys[m, i, s], configuration) for m, configuration in enumerate(configurations)]
            todo = tuple((key, configuration) for key, configuration in work if key not in claimed)
            claimed.update(key for key, _ in todo)
            if todo:
                tasks.append(Task(clips[i].without_labels(), numbers[i], seed, todo, kernels))
    return tasks
