"""The unit of work: several methods on one clip with one seed."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kt3dmoseg.errors import KT3DMoSegError
from kt3dmoseg.types import Clip, IntArray
from mseg.methods import segment
from mseg.methods.kernel_cache import kernel_cache


@dataclass(frozen=True)
class Configuration:
    """A method and the parameters that differ from its defaults.

    Parameters
    ----------
    method : str
        Name in `mseg.methods.METHODS`.
    parameters : mapping of str to object
        Options of the method.
    """

    method: str
    parameters: Mapping[str, Any] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Name for tables, with the parameters: ``"subset alpha=5"``."""
        return " ".join([self.method, *(f"{key}={value}" for key, value in self.parameters.items())])


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a method made of a clip.

    Parameters
    ----------
    key : str
        Of the configuration, clip and seed, see `mseg.benchmark.store.key`.
    labels : (n,) int64 or None
        None when it failed.
    seconds : float
        CPU time, including that of kernels which another method of the task had made already.
    reason : str
        Why it failed; empty when it did not.
    """

    key: str
    labels: IntArray | None
    seconds: float
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Task:
    """Configurations to run on one clip with one seed; they share kernels.

    Parameters
    ----------
    clip : Clip
        The sequence, without labels.
    n_motions : int or None
        What the methods are told.
    seed : int
        Seed of every configuration.
    work : tuple of (key, Configuration)
        What to run.
    kernels : str
        Folder where kernels are kept for later runs; empty = nowhere.
    """

    clip: Clip
    n_motions: int | None
    seed: int
    work: tuple[tuple[str, Configuration], ...]
    kernels: str = ""

    @property
    def name(self) -> str:
        """For progress and schedulers."""
        return f"{self.clip.name}, seed {self.seed}"


def seed_numbers(seeds: int | Sequence[int]) -> tuple[int, ...]:
    """Return the seeds; of a number of them, those counted from 0."""
    return tuple(range(seeds)) if isinstance(seeds, int) else tuple(seeds)


def run_task(task: Task) -> list[Outcome]:
    """Run a task; a method that cannot segment the clip gives an outcome with a reason."""
    with kernel_cache(task.kernels or None) as cache:
        outcomes = []
        for key, configuration in task.work:
            saved, start = cache.saved_seconds, time.process_time()
            labels, reason = _attempt(task, configuration)
            seconds = time.process_time() - start + cache.saved_seconds - saved
            outcomes.append(Outcome(key, labels, seconds, reason))
        return outcomes


def lost_task(task: Task, reason: str) -> list[Outcome]:
    """Outcomes of a task that no worker survived."""
    return [Outcome(key, None, float("nan"), reason) for key, _ in task.work]


def _reason(error: Exception, clip: str) -> str:
    """Say why in one line, without the clip's name: whoever tells it stands the name before it."""
    said = " ".join(str(error).split()) or type(error).__name__
    return re.sub(rf"^{re.escape(clip)}[:,] ", "", said)


def _attempt(task: Task, configuration: Configuration) -> tuple[IntArray | None, str]:
    try:
        result = segment(
            task.clip,
            configuration.method,
            n_motions=task.n_motions,
            seed=task.seed,
            **configuration.parameters,
        )
    except (KT3DMoSegError, MemoryError, np.linalg.LinAlgError) as error:
        return None, _reason(error, task.clip.name)
    return np.array(result.labels), ""
