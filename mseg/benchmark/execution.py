"""Running tasks here, in processes, or on a Dask cluster; dead workers' tasks run again."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Any

from kt3dmoseg.errors import InputFileError, MissingDependencyError
from mseg.benchmark.tasks import Outcome, Task, lost_task, run_task

# How often workers may die without a single task finished before the rest is given up.
_MAX_BREAKS = 3
_CONNECT_SECONDS = 20


def execute(
    tasks: Sequence[Task], *, workers: int = 1, dask: str = ""
) -> Iterator[tuple[Task, list[Outcome]]]:
    """Run tasks and yield each with its outcomes as it finishes.

    Results do not depend on where or in which order the tasks run: a task carries its seed.

    Parameters
    ----------
    tasks : sequence of Task
        The work.
    workers : int
        Processes on this machine; 1 = in this process.
    dask : str
        Address of a Dask scheduler, ``"tcp://host:8786"``; replaces `workers`.

    Raises
    ------
    MissingDependencyError
        When `dask` is given and ``distributed`` is not installed.
    InputFileError
        When no scheduler answers at that address.
    """
    if dask:
        yield from _on_cluster(tasks, dask)
    elif workers > 1 and len(tasks) > 1:
        yield from _in_processes(list(tasks), workers)
    else:
        for task in tasks:
            yield task, run_task(task)


def _in_processes(tasks: list[Task], workers: int) -> Iterator[tuple[Task, list[Outcome]]]:
    waiting, breaks = dict(enumerate(tasks)), 0
    while waiting and breaks < _MAX_BREAKS:
        before = len(waiting)
        # A broken pool takes its other tasks with it; whatever is unfinished goes to a new one.
        with contextlib.suppress(BrokenProcessPool):
            for index, outcomes in _one_pool(waiting, workers):
                yield waiting.pop(index), outcomes
        breaks = breaks + 1 if len(waiting) == before else 0
    for task in waiting.values():
        yield task, lost_task(task, f"worker processes died {_MAX_BREAKS} times")


def _one_pool(tasks: dict[int, Task], workers: int) -> Iterator[tuple[int, list[Outcome]]]:
    pool = ProcessPoolExecutor(min(workers, len(tasks)), mp_context=get_context("spawn"))
    try:
        futures = {pool.submit(run_task, task): index for index, task in tasks.items()}
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _on_cluster(tasks: Sequence[Task], address: str) -> Iterator[tuple[Task, list[Outcome]]]:
    distributed = _distributed()
    try:
        client = distributed.Client(address, timeout=_CONNECT_SECONDS)
    except (OSError, ValueError) as error:
        raise InputFileError(
            address, expected="a Dask scheduler", found=str(error) or "no answer", fix="is it running?"
        ) from error
    with client:
        # Impure: a task is run, never looked up by its arguments. Dask runs it again elsewhere
        # when its worker dies.
        futures = {client.submit(run_task, task, pure=False, retries=_MAX_BREAKS): task for task in tasks}
        for future in distributed.as_completed(futures):
            yield futures[future], _gathered(future, futures[future], distributed)


def _gathered(future: Any, task: Task, distributed: Any) -> list[Outcome]:  # noqa: ANN401
    try:
        outcomes: list[Outcome] = future.result()
    except distributed.scheduler.KilledWorker:
        return lost_task(task, "its Dask workers died, one after the other")
    return outcomes


def _distributed() -> Any:  # noqa: ANN401
    try:
        import distributed
    except ImportError as error:
        raise MissingDependencyError(
            "--dask needs distributed", fix="pip install 'kt3dmoseg[dask]'"
        ) from error
    return distributed
