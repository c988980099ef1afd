"""Methods x clips x seeds, cached, in parallel, scored by the protocol."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.io import load
from kt3dmoseg.types import Clip
from mseg.benchmark.data import find_clips
from mseg.benchmark.execution import execute
from mseg.benchmark.results import BenchmarkResult
from mseg.benchmark.store import Store, key
from mseg.benchmark.tasks import Configuration, Outcome, Task, seed_numbers
from mseg.evaluation import classification_error, load_protocol
from mseg.methods import create

Progress = Callable[[int, int, str], None]
"""Called with the number of tasks done, their total, and the name of the last."""


def run(
    benchmark: str = "kt3dmoseg",
    methods: Iterable[str | Configuration] = ("subset",),
    *,
    data: Sequence[str | os.PathLike[str]] = (),
    seeds: int | Sequence[int] = 1,
    parameters: Mapping[str, Any] | None = None,
    workers: int = 1,
    dask: str = "",
    cache: str | os.PathLike[str] | None = None,
    kernels: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> BenchmarkResult:
    """Run methods on every clip of a benchmark that is found, and score them.

    The number of motions of each clip is given to the methods. A clip on which a method fails
    counts as fully wrong.

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
    configurations = configure(methods, parameters or {})
    wanted = seed_numbers(seeds)
    if not wanted or not configurations:
        raise InvalidValueError("benchmark", expected="at least one method and one seed", found="none")
    paths, others = find_clips(protocol, data)
    clips = {name: load(path) for name, path in paths.items()}
    store = Store(Path(cache) if cache else None)
    keys = {
        (configuration.title, name, seed): key(configuration, clip, clip.n_motions, seed)
        for configuration in configurations
        for name, clip in clips.items()
        for seed in wanted
    }
    outcomes = {k: kept for k in keys.values() if (kept := store.read(k))}
    tasks = _tasks(configurations, clips, wanted, keys, outcomes, str(kernels or ""))
    for done, (task, results) in enumerate(execute(tasks, workers=workers, dask=dask), 1):
        for outcome in results:
            store.write(outcome)
            outcomes[outcome.key] = outcome
        if progress:
            progress(done, len(tasks), task.name)
    found = {where: outcomes[k] for where, k in keys.items()}
    return _result(protocol.name, configurations, clips, wanted, found, others)


def configure(
    methods: Iterable[str | Configuration], parameters: Mapping[str, Any]
) -> tuple[Configuration, ...]:
    """Make configurations; a parameter goes to the methods that have it, and one of them must.

    Raises
    ------
    UnknownNameError
        For an unknown method, or a parameter that none of them has.
    """
    made = []
    used: set[str] = set()
    names = [m for m in methods if isinstance(m, str)]
    for method in methods:
        if isinstance(method, Configuration):
            create(method.method, **method.parameters)
            made.append(method)
            continue
        fields = vars(create(method))
        own = {k: v for k, v in parameters.items() if k in fields}
        used |= set(own)
        create(method, **own)
        made.append(Configuration(method, own))
    for name in parameters:
        if name not in used:
            create(names[0] if names else "subset", **{name: parameters[name]})
    return tuple(made)


def _tasks(
    configurations: Sequence[Configuration],
    clips: Mapping[str, Clip],
    seeds: Sequence[int],
    keys: Mapping[tuple[str, str, int], str],
    done: Mapping[str, Outcome],
    kernels: str,
) -> list[Task]:
    """One task per clip and seed that has anything left to run; large clips first."""
    tasks = []
    claimed = set(done)
    for name in sorted(clips, key=lambda n: -len(clips[n].evaluated) * clips[n].n_frames):
        clip = clips[name]
        for seed in seeds:
            work = [(keys[c.title, name, seed], c) for c in configurations]
            todo = tuple((k, c) for k, c in work if k not in claimed)
            claimed.update(k for k, _ in todo)
            if todo:
                tasks.append(Task(clip.without_labels(), clip.n_motions, seed, todo, kernels))
    return tasks


def _result(
    benchmark: str,
    configurations: tuple[Configuration, ...],
    clips: Mapping[str, Clip],
    seeds: tuple[int, ...],
    outcomes: Mapping[tuple[str, str, int], Outcome],
    others: Sequence[str],
) -> BenchmarkResult:
    shape = (len(configurations), len(clips), len(seeds))
    errors, seconds = np.ones(shape), np.full(shape, np.nan)
    failures = []
    for m, configuration in enumerate(configurations):
        for i, (name, clip) in enumerate(clips.items()):
            for s, seed in enumerate(seeds):
                outcome = outcomes[configuration.title, name, seed]
                seconds[m, i, s] = outcome.seconds
                if outcome.labels is None:
                    failures.append((configuration, name, seed, outcome.reason))
                else:
                    errors[m, i, s] = classification_error(clip.labels.label, outcome.labels)
    return BenchmarkResult(
        load_protocol(benchmark),
        configurations,
        {name: clip.n_motions for name, clip in clips.items()},
        seeds,
        errors,
        seconds,
        tuple(failures),
        tuple(others),
    )
