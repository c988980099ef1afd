"""Tasks in parallel processes that end with their parent, however it ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any, Protocol, TypeVar

import cv2

from kt3dmoseg.errors import KT3DMoSegError

TaskT = TypeVar("TaskT", contravariant=True)
ResultT = TypeVar("ResultT", covariant=True)
_ENVIRONMENT = {  # read once: by a library when it is loaded, by glibc when the process starts
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    # Freed arrays of a frame's size stay with the process: to give them back and fetch them anew costs
    # a worker an eighth of its time.
    "MALLOC_MMAP_THRESHOLD_": f"{1 << 25}",
    "MALLOC_TRIM_THRESHOLD_": f"{1 << 27}",
}
_said: Connection | None = None


class Work(Protocol[TaskT, ResultT]):
    """A module-level function that does one task."""

    def __call__(self, task: TaskT, progress: Callable[[str, int, int | None], None], /) -> ResultT:
        """Do the task."""
        ...


def in_processes(
    work: Work[TaskT, ResultT],
    tasks: Sequence[TaskT],
    workers: int,
    progress: Callable[[str, int, int | None], None] | None,
) -> Iterator[ResultT]:
    """Give the results of the tasks as they come.

    Parameters
    ----------
    work : callable
        Called as ``work(task, progress)`` in a worker.
    tasks : sequence
        What to do.
    workers : int
        Number of processes, one thread each; with 1 the calling process does it all.
    progress : callable or None
        What the workers' `progress` calls arrive at, in this process.
    """
    tell = progress or _ignore
    if workers == 1:
        cv2.setNumThreads(1)
        yield from (work(task, tell) for task in tasks)
        return
    context = multiprocessing.get_context("spawn")
    # Pipes, no locks or events: a worker that dies holding a lock would block everyone else.
    heard, said = context.Pipe(duplex=False)
    held, lifeline = context.Pipe(duplex=False)
    listener = threading.Thread(target=_listen, args=(heard, tell), daemon=True)
    listener.start()
    pool = ProcessPoolExecutor(workers, context, _start, (said, held))
    try:
        with _inherited(_ENVIRONMENT):  # the processes start with their first tasks
            futures = [pool.submit(_call, work, task) for task in tasks]
        for future in as_completed(futures):
            result: ResultT = future.result()
            yield result
        pool.shutdown()
    except BrokenProcessPool:
        raise KT3DMoSegError(
            "a worker process was killed",
            fix="perhaps memory ran out: run again with fewer --workers; finished clips are kept",
        ) from None
    finally:
        lifeline.close()  # gives up work in progress, if there is any
        pool.shutdown(cancel_futures=True)
        said.send(None)
        listener.join()


@contextmanager
def _inherited(values: Mapping[str, str]) -> Iterator[None]:
    """Give processes that start in the block these variables, where they are not set already."""
    added = values.keys() - os.environ.keys()
    os.environ.update({name: values[name] for name in added})
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]


def _call(work: Work[Any, Any], task: object) -> Any:  # noqa: ANN401  # whatever `work` returns
    return work(task, _send)


def _start(said: Connection, held: Connection) -> None:
    global _said  # one channel per worker process
    _said = said
    cv2.setNumThreads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent gets it too, and drops the lifeline
    threading.Thread(target=_end_with_lifeline, args=(held,), daemon=True).start()


def _end_with_lifeline(held: Connection) -> None:
    """Wait for the other end to close: by the parent, or by the system when the parent is gone."""
    with suppress(EOFError, OSError):
        held.recv_bytes()
    os._exit(1)


def _send(clip: str, done: int, total: int | None) -> None:
    assert _said is not None
    _said.send((clip, done, total))  # shorter than PIPE_BUF, so messages of workers do not mix


def _listen(heard: Connection, tell: Callable[[str, int, int | None], None]) -> None:
    while (message := heard.recv()) is not None:
        tell(*message)


def _ignore(clip: str, done: int, total: int | None) -> None:
    del clip, done, total
