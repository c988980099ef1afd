"""Kernels shared between calls: methods, sweeps of alpha and fusions on one clip do not sample again.

So are the representations of methods whose programme draws nothing, between seeds and numbers of motions.
"""

import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg import __version__
from kt3dmoseg.parallel import Cache, cache_key
from mseg import kernels

# A fusion of three views at three gaps; at 1,000 points 4 MB each.
_KEPT = 9
Arrays: TypeAlias = dict[str, npt.NDArray[Any]]


class KernelCache:
    """Kernels by what they depend on, the latest few in memory and, in a folder if given, all of them."""

    def __init__(self, folder: str | Path | None = None) -> None:
        self.saved_seconds = 0.0
        """CPU time of the kernels that were found instead of made."""
        self._disk = Cache(folder)
        self._memory: OrderedDict[str, Arrays] = OrderedDict()

    def get(self, depends_on: Mapping[str, object], make: Callable[[], Arrays]) -> Arrays:
        """Return arrays, made when they are not there; versions are added to what they depend on."""
        key = cache_key({"versions": [__version__, kernels.ALGORITHM_VERSION], **depends_on})
        entry = self._memory.pop(key, None) or self._disk.get(key)
        if entry is None:
            start = time.process_time()
            entry = make()
            entry["seconds"] = np.array(time.process_time() - start)
            self._disk.put(key, entry)
        else:
            self.saved_seconds += float(entry["seconds"])
        for array in entry.values():
            array.flags.writeable = False
        self._memory[key] = entry
        if len(self._memory) > _KEPT:
            self._memory.popitem(last=False)
        return entry


current_cache: ContextVar[KernelCache | None] = ContextVar("kernel_cache", default=None)
"""The cache in force."""


def shared(depends_on: Mapping[str, object], make: Callable[[], Arrays]) -> Arrays:
    """Return what `make` returns, or returned to a call that depended on the same in the cache in force."""
    cache = current_cache.get()
    return make() if cache is None else cache.get(depends_on, make)


@contextmanager
def kernel_cache(folder: str | Path | None = None) -> Iterator[KernelCache]:
    """Share kernels between the `segment` calls inside the block.

    Calls share a kernel when clip, seed and everything that shapes it (hypotheses, gap, residual)
    are the same; alpha, lambda, gamma, the fusion and k-means may differ. With a folder, later runs do too.
    """
    cache = KernelCache(folder)
    token = current_cache.set(cache)
    try:
        yield cache
    finally:
        current_cache.reset(token)
