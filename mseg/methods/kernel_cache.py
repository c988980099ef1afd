"""Keeping kernels, so that methods, sweeps of alpha and fusions on one clip do not sample again."""

from __future__ import annotations

import hashlib
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TypeAlias

import numpy as np

from kt3dmoseg import __version__
from kt3dmoseg.files import atomic_path
from kt3dmoseg.types import Float32Array
from mseg import kernels

# A fusion of three views at three gaps; at 1,000 points 4 MB each.
_KEPT = 9
_Entry: TypeAlias = tuple[Float32Array, float]


class KernelCache:
    """Kernels by key, the latest few in memory and, when asked, all of them on disk.

    Parameters
    ----------
    folder : Path or None
        Where ``<key>.npz`` files are kept; None keeps nothing beyond memory.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        self.saved_seconds = 0.0
        """CPU time of the kernels that were found instead of made."""
        self._memory: OrderedDict[str, _Entry] = OrderedDict()

    def get(self, key: str, make: Callable[[], Float32Array]) -> Float32Array:
        """Return the kernel of that key, made when it is not there."""
        entry = self._memory.pop(key, None) or self._from_disk(key)
        if entry is None:
            start = time.process_time()
            kernel = make()
            entry = kernel, time.process_time() - start
            self._to_disk(key, entry)
        else:
            self.saved_seconds += entry[1]
        entry[0].flags.writeable = False
        self._memory[key] = entry
        while len(self._memory) > _KEPT:
            self._memory.popitem(last=False)
        return entry[0]

    def _from_disk(self, key: str) -> _Entry | None:
        path = self.folder / f"{key}.npz" if self.folder else None
        if path is None or not path.is_file():
            return None
        with np.load(path, allow_pickle=False) as stored:
            return stored["kernel"], float(stored["seconds"])

    def _to_disk(self, key: str, entry: _Entry) -> None:
        if self.folder:
            with atomic_path(self.folder / f"{key}.npz") as temporary, temporary.open("wb") as stream:
                np.savez(stream, kernel=entry[0], seconds=entry[1])


_current: ContextVar[KernelCache | None] = ContextVar("kernel_cache", default=None)


@contextmanager
def kernel_cache(folder: str | Path | None = None) -> Iterator[KernelCache]:
    """Share kernels between the `segment` calls inside the block.

    Calls share a kernel when clip, seed and everything that shapes it (hypotheses, gap, residual)
    are the same; alpha, lambda, gamma, the fusion and k-means may differ.

    Parameters
    ----------
    folder : path, optional
        Also keep them there, for later runs. A few megabytes each; safe to delete.

    Examples
    --------
    >>> with kernel_cache():  # doctest: +SKIP
    ...     results = [segment(clip, "subset", n_motions=3, alpha=a) for a in (5, 8, 10)]
    """
    cache = KernelCache(Path(folder) if folder else None)
    token = _current.set(cache)
    try:
        yield cache
    finally:
        _current.reset(token)


def remembered(parts: tuple[object, ...], make: Callable[[], Float32Array]) -> Float32Array:
    """Look a kernel up in the cache in force, or make it.

    Parameters
    ----------
    parts : tuple
        Everything the kernel depends on, by its `repr`, but the version of its making, which is added here.
    make : callable
        Makes the kernel.
    """
    cache = _current.get()
    if cache is None:
        return make()
    of = repr((__version__, kernels.ALGORITHM_VERSION, *parts))
    return cache.get(hashlib.sha256(of.encode()).hexdigest()[:40], make)
