"""The one pool of processes and the one cache of arrays that building and benchmarks share."""

import hashlib
import io
import json
import multiprocessing
import os
import signal
import sys
import threading
import traceback
import zipfile
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Generic, TypeAlias, TypeVar, cast

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InputFileError, InvalidValueError, KT3DMoSegError, optional
from kt3dmoseg.files import PathLike, atomic_path, sha256_arrays

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")
Progress: TypeAlias = Callable[..., None]

_MAX_DEATHS = 3
_CONNECT_SECONDS = 20
_POLL = 0.2  # seconds between two looks whether work is to be stopped
_ENVIRONMENT = {  # read once: by a library when it is loaded, by glibc when the process starts
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
    # Freed arrays of a frame's size stay with the process: to return and fetch them costs a worker an
    # eighth of its time.
    "MALLOC_MMAP_THRESHOLD_": f"{1 << 25}",
    "MALLOC_TRIM_THRESHOLD_": f"{1 << 27}",
}


def run_tasks(
    work: Callable[[TaskT, Progress], ResultT],
    tasks: Sequence[TaskT],
    *,
    lost: Callable[[TaskT, str], ResultT],
    workers: int = 1,
    dask: str = "",
    progress: Progress | None = None,
) -> Iterator[tuple[TaskT, ResultT]]:
    """Run ``work(task, progress)`` here, in processes or on a Dask cluster; yield each task with its result.

    `work` and the tasks are pickled when they leave this process, which does the work itself with one worker
    or a single task. A worker process computes with one thread and ends with this process, however that ends.
    When one dies, only its task is run again; the third time ``lost(task, reason)`` is its result. An
    exception in a task is raised here and ends the run. `dask` is the address of a scheduler, which replaces
    `workers`; `progress` is called here with what tasks hand to theirs, Dask's apart.
    """
    report = progress or _ignore
    if not isinstance(workers, int) or workers < 1:
        raise InvalidValueError("workers", expected="a whole number, at least 1", found=f"{workers!r:.60}")
    if dask:
        yield from _on_cluster(work, tasks, dask, lost)
    elif workers > 1 and len(tasks) > 1:
        yield from _Pool(work, tasks, workers, report, lost).results()
    else:
        yield from ((task, work(task, report)) for task in tasks)


@dataclass
class _Pool(Generic[TaskT, ResultT]):
    """Worker processes, each with a pipe of its own: no lock that a dying worker could leave closed."""

    work: Callable[[TaskT, Progress], ResultT]
    tasks: Sequence[TaskT]
    workers: int
    progress: Progress
    lost: Callable[[TaskT, str], ResultT]

    def __post_init__(self) -> None:
        self.waiting, self.deaths = deque(range(len(self.tasks))), Counter[int]()
        self.processes: dict[Connection, BaseProcess] = {}
        self.running: dict[Connection, int] = {}

    def results(self) -> Iterator[tuple[TaskT, ResultT]]:
        try:
            while self.waiting or self.running:
                while len(self.processes) < min(self.workers, len(self.waiting) + len(self.running)):
                    self.processes.update([_started(self.work)])
                for ready in wait(list(self.processes)):
                    yield from self._receive(cast(Connection, ready))
        finally:
            for process in self.processes.values():
                process.kill()
            for process in self.processes.values():
                process.join()

    def _receive(self, connection: Connection) -> Iterator[tuple[TaskT, ResultT]]:
        try:
            kind, value = connection.recv()
        except (EOFError, OSError):
            self._end(connection)
            yield from self._dead(self.running.pop(connection, None))
            return
        if kind == "progress":
            self.progress(*value)
            return
        if kind == "error":
            raise value
        if kind == "result":
            yield self.tasks[self.running.pop(connection)], value
        if not self.waiting:
            self._end(connection)
            return
        index = self.running[connection] = self.waiting.popleft()
        with suppress(OSError):  # of a worker that just died: the next look at the pipe finds it
            connection.send(self.tasks[index])

    def _end(self, connection: Connection) -> None:
        connection.close()
        self.processes.pop(connection).join()

    def _dead(self, index: int | None) -> Iterator[tuple[TaskT, ResultT]]:
        if index is None:
            fix = "in a script, start the work under: if __name__ == '__main__'; or use one worker"
            raise KT3DMoSegError("worker processes end before their first task", fix=fix)
        self.deaths[index] += 1
        if self.deaths[index] < _MAX_DEATHS:
            self.waiting.appendleft(index)
        else:
            task = self.tasks[index]
            yield task, self.lost(task, f"its worker processes died {_MAX_DEATHS} times")


def _started(work: Callable[[Any, Progress], Any]) -> tuple[Connection, BaseProcess]:
    """Start a process that does `work` on one task after the other, with a pipe to it."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, work))
    with _inherited():
        process.start()
    theirs.close()  # so that the end of the process ends what can be read
    return ours, process


def _serve(connection: Connection, work: Callable[[Any, Progress], Any]) -> None:
    """Do one task after the other, in a worker process, until the parent closes the pipe or ends."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    message: tuple[str, Any] = ("ready", None)
    with suppress(EOFError, OSError):
        while True:
            connection.send(message)
            task = connection.recv()
            try:
                message = "result", work(task, lambda *values: connection.send(("progress", values)))
            except Exception as error:
                error.add_note(traceback.format_exc())  # of this process, which the parent's does not show
                message = "error", error


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


@contextmanager
def _inherited() -> Iterator[None]:
    """Let processes that start in the block inherit `_ENVIRONMENT` where it is not set, and no Ctrl-C."""
    blocks = hasattr(signal, "pthread_sigmask")  # not on Windows
    if blocks:
        resource_tracker.ensure_running()  # which would unblock the signal when it starts itself
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    added = _ENVIRONMENT.keys() - os.environ.keys()
    os.environ.update({name: _ENVIRONMENT[name] for name in added})
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]
        if blocks:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _ignore(*_: object) -> None:
    """Ignore progress: the default without a callback."""


def _on_cluster(
    work: Callable[[TaskT, Progress], ResultT],
    tasks: Sequence[TaskT],
    address: str,
    lost: Callable[[TaskT, str], ResultT],
) -> Iterator[tuple[TaskT, ResultT]]:
    distributed = optional("distributed", "a Dask cluster needs", "dask")
    try:
        client = distributed.Client(address, timeout=_CONNECT_SECONDS)
    except (OSError, ValueError) as error:
        found = str(error) or "no answer"
        raise InputFileError(
            address, expected="a Dask scheduler", found=found, fix="is it running?"
        ) from error
    # Impure: a task is run, never looked up by its arguments. When its worker dies, Dask runs it elsewhere.
    options = {"pure": False, "retries": _MAX_DEATHS}
    with client:
        futures = {client.submit(work, task, _ignore, **options): task for task in tasks}
        for future in distributed.as_completed(futures):
            task = futures[future]
            try:
                result = future.result()
            except distributed.scheduler.KilledWorker:
                result = lost(task, "its Dask workers died, one after the other")
            yield task, result


def run_apart(work: Callable[..., ResultT], *given: object, stop: threading.Event) -> ResultT:
    """Return ``work(*given)``, computed in a process of its own that is killed as soon as `stop` is set.

    What goes there and back is pickled; an exception of `work` is raised here. Raises KT3DMoSegError when
    stopped, or when it dies.
    """
    connection, process = _started(_apply)
    kind, value = "", None
    try:
        with suppress(EOFError, OSError):  # it died
            connection.send((work, given))
            while kind not in ("result", "error") and not stop.is_set():
                if connection.poll(_POLL):
                    kind, value = connection.recv()
    finally:
        process.kill()
        process.join()
        connection.close()
    if kind == "error":
        raise cast(Exception, value)
    if kind != "result":
        raise KT3DMoSegError("cancelled" if stop.is_set() else f"its process died, code {process.exitcode}")
    return cast(ResultT, value)


def _apply(task: tuple[Callable[..., ResultT], Iterable[object]], _: Progress) -> ResultT:
    work, given = task
    return work(*given)


class Cache:
    """Arrays on disk by key, one ``.npz`` file each, written atomically; without a folder nothing is kept.

    Several processes may share a folder. What is damaged, or has got under another key's name, counts as
    absent. Whatever the arrays depend on belongs into the key, so nothing here can be out of date.
    """

    def __init__(self, folder: PathLike | None) -> None:
        self.folder = None if folder is None else Path(folder)

    def get(self, key: str) -> dict[str, npt.NDArray[Any]] | None:
        """Return the arrays of a key, by name; None when they are not there."""
        if self.folder is None:
            return None
        try:
            # Not np.load of the file: that checks no checksum where it reads less than was written.
            with zipfile.ZipFile(self.folder / key[:2] / f"{key}.npz") as archive:
                arrays = {
                    name.removesuffix(".npy"): np.load(io.BytesIO(archive.read(name)), allow_pickle=False)
                    for name in archive.namelist()
                }
        except Exception:  # each kind of damage raises a class of its own
            return None
        return arrays if str(arrays.pop("key", "")) == _contents(key, arrays) else None

    def put(self, key: str, arrays: Mapping[str, npt.ArrayLike]) -> None:
        """Keep arrays by name; none may be called ``key`` or hold objects."""
        if self.folder is not None:
            path = self.folder / key[:2] / f"{key}.npz"
            with atomic_path(path) as temporary, temporary.open("wb") as stream:
                np.savez(stream, key=_contents(key, arrays), **dict(arrays))  # type: ignore[arg-type]  # numpy 2.1 has a flag


def _contents(key: str, names: Iterable[str]) -> str:
    return " ".join([key, *sorted(names)])


def cache_key(description: Mapping[str, object]) -> str:
    """Hexadecimal SHA-256 of JSON values, arrays (dtype, shape, content), and others with a complete repr."""

    def described(value: object) -> str:
        return sha256_arrays(value) if isinstance(value, np.ndarray) else repr(value)

    return hashlib.sha256(json.dumps(description, sort_keys=True, default=described).encode()).hexdigest()


def algorithm_version(cls: type) -> str | None:
    """Version of the code that a class computes with; None when it states none, and so must not be cached.

    That is the nearest ``ALGORITHM_VERSION``, of the class, its module or a package around it, which is
    raised by hand when results change, and the ``__version__`` of the outermost package.
    """
    names = cls.__module__.split(".")
    modules = [sys.modules.get(".".join(names[:count])) for count in range(len(names), 0, -1)]
    versions = [getattr(owner, "ALGORITHM_VERSION", None) for owner in (cls, *modules)]
    algorithm = next((version for version in versions if version is not None), None)
    stated = algorithm, getattr(modules[-1], "__version__", None)
    return "/".join(str(version) for version in stated if version is not None) or None
