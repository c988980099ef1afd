"""Outcomes on disk, found by a hash of everything that they depend on."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import scipy

from kt3dmoseg.files import atomic_path, sha256_arrays
from kt3dmoseg.parallel import algorithm_version
from kt3dmoseg.types import Clip
from mseg.benchmark.tasks import Configuration, Outcome
from mseg.methods import create

_THIS_PROCESS = uuid4().hex


def key(configuration: Configuration, clip: Clip, n_motions: int | None, seed: int) -> str:
    """Hash of method, all its parameters, the clip's content, number of motions, seed and versions.

    The versions are those of numpy, scipy and the method's code (`kt3dmoseg.parallel.algorithm_version`),
    so results of a method that was changed are never taken for those of the new one. No other process
    finds the results of a method whose code states no version. All seeds of a method that draws nothing
    have one key.
    """
    method: Any = create(configuration.method, **configuration.parameters)
    parameters = asdict(method)
    content = {
        "method": configuration.method,
        "parameters": parameters,
        "clip": clip.name,
        "content": clip_hash(clip),
        "n_motions": n_motions,
        "seed": 0 if getattr(method, "deterministic", False) else seed,
        "versions": [np.__version__, scipy.__version__, algorithm_version(type(method)) or _THIS_PROCESS],
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=repr).encode()).hexdigest()[:40]


def clip_hash(clip: Clip) -> str:
    """Hash of what a method sees of a clip."""
    size = np.array(clip.dense.image_size or (0, 0))
    intrinsics = np.zeros(0) if clip.camera is None or clip.camera.K is None else clip.camera.K
    return sha256_arrays(clip.dense.xy, clip.dense.visible, clip.evaluated, size, intrinsics)


class Store:
    """A folder of outcomes, one small file each, written atomically.

    Parameters
    ----------
    folder : Path or None
        Where; None remembers nothing.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder

    def read(self, key: str) -> Outcome | None:
        """Return the outcome of that key, when it is there."""
        path = self.folder / f"{key}.npz" if self.folder else None
        if path is None or not path.is_file():
            return None
        with np.load(path, allow_pickle=False) as stored:
            reason = str(stored["reason"])
            labels = None if reason else stored["labels"].astype(np.int64)
            return Outcome(key, labels, float(stored["seconds"]), reason)

    def write(self, outcome: Outcome) -> None:
        """Keep an outcome; one of a worker that died is not kept, since it says nothing of the method."""
        if self.folder is None or np.isnan(outcome.seconds):
            return
        labels = np.zeros(0, dtype=np.int64) if outcome.labels is None else outcome.labels
        with atomic_path(self.folder / f"{outcome.key}.npz") as temporary, temporary.open("wb") as stream:
            np.savez(stream, labels=labels, seconds=outcome.seconds, reason=outcome.reason)
