"""Tasks in parallel processes that end with their parent, however it ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.queues import SimpleQueue
from multiprocessing.synchronize import Event
from typing import Any, Protocol, TypeVar

import cv2

from kt3dmoseg.errors import KT3DMoSegError

TaskT = TypeVar("TaskT", contravariant=True)
ResultT = TypeVar("ResultT", covariant=True)
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_messages: SimpleQueue[Any] | None = None


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
    messages: SimpleQueue[Any] = context.SimpleQueue()
    stop = context.Event()
    for name in _ONE_THREAD:  # inherited; a library reads them once, when it is loaded
        os.environ.setdefault(name, "1")
    listener = threading.Thread(target=_listen, args=(messages, tell), daemon=True)
    listener.start()
    pool = ProcessPoolExecutor(workers, context, _start, (messages, stop))
    try:
        for future in as_completed([pool.submit(_call, work, task) for task in tasks]):
            result: ResultT = future.result()
            yield result
    except BrokenProcessPool:
        raise KT3DMoSegError(
            "a worker process was killed",
            fix="perhaps memory ran out: run again with fewer --workers; finished clips are kept",
        ) from None
    finally:
        # After the last task nobody is at work any more; before it, work in progress is given up.
        stop.set()
        pool.shutdown(cancel_futures=True)
        messages.put(None)
        listener.join()


def _call(work: Work[Any, Any], task: object) -> Any:  # noqa: ANN401  # whatever `work` returns
    return work(task, _send)


def _start(messages: SimpleQueue[Any], stop: Event) -> None:
    global _messages  # one channel per worker process
    _messages = messages
    cv2.setNumThreads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent gets it too, and says stop
    parent = multiprocessing.parent_process()
    for wait in (stop.wait, parent.join if parent else stop.wait):
        threading.Thread(target=_end_after, args=(wait,), daemon=True).start()


def _end_after(wait: Callable[[], object]) -> None:
    wait()
    os._exit(1)


def _send(clip: str, done: int, total: int | None) -> None:
    assert _messages is not None
    _messages.put((clip, done, total))


def _listen(messages: SimpleQueue[Any], tell: Callable[[str, int, int | None], None]) -> None:
    while (message := messages.get()) is not None:
        tell(*message)


def _ignore(clip: str, done: int, total: int | None) -> None:
    del clip, done, total
