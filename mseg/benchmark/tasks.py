"""The unit of work: several methods on one clip with one seed; its outcomes, and where they are kept."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any
from uuid import uuid4

import numpy as np
import scipy

from kt3dmoseg.errors import InvalidValueError, KT3DMoSegError
from kt3dmoseg.parallel import Cache, algorithm_version, cache_key
from kt3dmoseg.types import Clip, IntArray
from mseg.methods import check_whole, create, segment
from mseg.methods.kernel_cache import kernel_cache

BASELINES = ("one_motion", "prevalence")  # one label for a whole clip is meant
_THIS_PROCESS = uuid4().hex


@dataclass(frozen=True)
class Configuration:
    """A method and the parameters that differ from its defaults."""

    method: str  # name in `mseg.methods.METHODS`
    parameters: Mapping[str, Any] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Name for tables, with the parameters: ``"subset alpha=5"``."""
        return " ".join([self.method, *(f"{key}={value}" for key, value in self.parameters.items())])


@dataclass(frozen=True, eq=False)
class Outcome:
    """The result of a method on a clip."""

    key: str  # of the configuration, clip and seed
    labels: IntArray | None  # None when it failed
    seconds: float  # CPU time, with that of kernels which another method of the task had made already
    reason: str = ""  # why it failed
    notes: str = ""  # what one must know to trust the labels


@dataclass(frozen=True, eq=False)
class Task:
    """Configurations to run on one clip with one seed; they share kernels."""

    clip: Clip  # without labels
    n_motions: int | None  # given to the methods
    seed: int
    work: tuple[tuple[str, Configuration], ...]  # keys and what to run
    kernels: str = ""  # folder where kernels are kept for later runs

    @property
    def name(self) -> str:
        """For progress and schedulers."""
        return f"{self.clip.name}, seed {self.seed}"


def seed_numbers(seeds: int | Sequence[int]) -> tuple[int, ...]:
    """Return the seeds; of a number of them, those counted from 0."""
    if not isinstance(seeds, (Sequence, range, np.ndarray)):
        check_whole("seeds", seeds, 1)
        return tuple(range(seeds))
    for seed in seeds:
        check_whole("seeds", seed, 0)
    if not len(seeds) or len(set(seeds)) < len(seeds):
        raise InvalidValueError("seeds", expected="one or more, each once", found=str(list(seeds))[:80])
    return tuple(map(int, seeds))


def run_task(task: Task, progress: Callable[..., None] | None = None) -> list[Outcome]:
    """Run a task; a method that cannot segment the clip gives an outcome with a reason."""
    with kernel_cache(task.kernels or None) as cache:
        outcomes = []
        for key, configuration in task.work:
            saved, start = cache.saved_seconds, time.process_time()
            labels, reason, notes = _attempt(task, configuration)
            seconds = time.process_time() - start + cache.saved_seconds - saved
            outcomes.append(Outcome(key, labels, seconds, reason, notes))
        return outcomes


def lost_task(task: Task, reason: str) -> list[Outcome]:
    """Outcomes of a task that no worker survived."""
    return [Outcome(key, None, float("nan"), reason) for key, _ in task.work]


def _attempt(task: Task, configuration: Configuration) -> tuple[IntArray | None, str, str]:
    name, clip = configuration.method, task.clip
    try:
        result = segment(clip, name, n_motions=task.n_motions, seed=task.seed, **configuration.parameters)
    except (KT3DMoSegError, MemoryError, np.linalg.LinAlgError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        # The caller that shows it names the clip.
        return None, re.sub(rf"^{re.escape(clip.name)}[:,] ", "", reason), ""
    notes = () if name in BASELINES else result.report["notes"]
    return np.array(result.labels), "", "; ".join(notes)


def outcome_key(configuration: Configuration, clip: Clip, n_motions: int | None, seed: int) -> str:
    """Hash of method, all its parameters, the clip's content, number of motions, seed and versions.

    The versions are those of numpy, scipy and the method's code (`kt3dmoseg.parallel.algorithm_version`).
    No other process finds the outcomes of a method whose code states no version. All seeds of a method
    that draws nothing have one key.
    """
    method: Any = create(configuration.method, **configuration.parameters)
    camera = None if clip.camera is None else clip.camera.K
    return cache_key(
        {
            "method": configuration.method,
            "parameters": asdict(method),
            "clip": clip.name,
            "content": [clip.dense.xy, clip.dense.visible, clip.evaluated, clip.dense.image_size, camera],
            "n_motions": n_motions,
            "seed": 0 if getattr(method, "deterministic", False) else seed,
            "versions": [np.__version__, scipy.__version__, algorithm_version(type(method)) or _THIS_PROCESS],
        }
    )


def read_outcome(cache: Cache, key: str) -> Outcome | None:
    """Return a kept outcome, when it is there."""
    kept = cache.get(key)
    if kept is None or "notes" not in kept:  # of an earlier version
        return None
    reason, labels = str(kept["reason"]), kept["labels"].astype(np.int64)
    return Outcome(key, None if reason else labels, float(kept["seconds"]), reason, str(kept["notes"]))


def keep_outcome(cache: Cache, outcome: Outcome) -> None:
    """Keep an outcome; one of a worker that died is not kept, since it is no evidence on the method."""
    if not np.isnan(outcome.seconds):
        labels = np.zeros(0, dtype=np.int64) if outcome.labels is None else outcome.labels
        texts = {"reason": outcome.reason, "notes": outcome.notes}
        cache.put(outcome.key, {"labels": labels, "seconds": outcome.seconds, **texts})
