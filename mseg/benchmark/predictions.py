"""Predictions of one method for a folder of clips, written as a submission."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.files import check_writable, write_text
from kt3dmoseg.parallel import algorithm_version
from kt3dmoseg.types import Clip
from mseg.benchmark.execution import execute
from mseg.benchmark.runner import Progress, configure
from mseg.benchmark.store import key
from mseg.benchmark.tasks import Configuration, Outcome, Task, seed_numbers
from mseg.evaluation import SubmissionMeta, fingerprint, write_failure, write_meta, write_prediction
from mseg.evaluation.submission import FAILED
from mseg.evaluation.validate import load_clips
from mseg.methods import create

# Which configuration made the predictions; hidden, so no part of the submission.
_RECORD = ".mseg-run.json"


def predict(
    data: str | os.PathLike[str],
    output: str | os.PathLike[str],
    method: str = "subset",
    *,
    n_motions: int | None = None,
    seeds: int | Sequence[int] = 1,
    parameters: Mapping[str, Any] | None = None,
    workers: int = 1,
    dask: str = "",
    progress: Progress | None = None,
) -> Path:
    """Segment every clip of a folder and write the predictions; what is there already is kept.

    Parameters
    ----------
    data : path
        Folder of clips, or one clip.
    output : path
        Folder of the submission: ``<clip>.csv``, or ``seed-<seed>/<clip>.csv`` for several seeds.
    method : str
        Name of the method.
    n_motions : int or None
        Number of motions of all clips; None = as many as each clip's labels have, or, where a clip
        has no labels, what the method finds.
    seeds : int or sequence of int
        Number of seeds, counted from 0, or the seeds.
    parameters : mapping, optional
        Parameters of the method.
    workers, dask
        Where to run, see `mseg.benchmark.run`.
    progress : callable, optional
        Called as clips finish.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InvalidValueError
        When the folder holds predictions of another configuration, other numbers of motions or
        another layout, or `n_motions` is not positive.
    """
    if n_motions is not None and n_motions < 1:
        raise InvalidValueError("n_motions", expected="1 or more, or None", found=str(n_motions))
    folder = Path(output)
    configuration = configure([method], parameters or {})[0]
    wanted = seed_numbers(seeds)
    clips = load_clips(data)
    told = {name: n_motions or clip.n_motions or None for name, clip in clips.items()}
    keys = {
        (name, seed): key(configuration, clip, told[name], seed)
        for name, clip in clips.items()
        for seed in wanted
    }
    check_writable(folder)
    record = _open_record(folder, configuration, n_motions, "seed-N" if len(wanted) > 1 else "flat")
    layout = {seed: None if len(wanted) == 1 else seed for seed in wanted}
    tasks = [
        Task(clips[name].without_labels(), told[name], seed, ((k, configuration),))
        for (name, seed), k in keys.items()
        if not (record["done"].get(k) and _exists(folder, name, layout[seed]))
    ]
    for done, (task, outcomes) in enumerate(execute(tasks, workers=workers, dask=dask), 1):
        _write(folder, task, outcomes[0], layout[task.seed])
        record["done"][outcomes[0].key] = outcomes[0].seconds
        write_text(folder / _RECORD, json.dumps(record, indent=1))
        if progress:
            progress(done, len(tasks), task.name)
    seconds = sum(record["done"].get(k, 0.0) for k in keys.values()) / len(wanted)
    write_meta(folder, _meta(configuration, clips, seconds, given=all(told.values())))
    return folder


def _open_record(
    folder: Path, configuration: Configuration, n_motions: int | None, layout: str
) -> dict[str, Any]:
    """Read what an earlier run left, refusing to mix two configurations."""
    wanted = {
        "method": configuration.method,
        "parameters": {k: repr(v) for k, v in _parameters(configuration).items()},
        "code": algorithm_version(type(create(configuration.method, **configuration.parameters))) or "",
        "n_motions": n_motions,
        "layout": layout,
    }
    path = folder / _RECORD
    if not path.is_file():
        return {"configuration": wanted, "done": {}}
    record: dict[str, Any] = json.loads(path.read_text())
    if record["configuration"] != wanted:
        was = record["configuration"]
        differs = [k for k in wanted if was.get(k) != wanted[k]]
        raise InvalidValueError(
            str(folder),
            expected=f"no predictions, or those of this configuration ({configuration.title})",
            found=f"predictions of another ({was.get('method')}; differs in {', '.join(differs)})",
            fix="write to another folder",
        )
    return record


def _exists(folder: Path, clip: str, seed: int | None) -> bool:
    place = folder if seed is None else folder / f"seed-{seed}"
    return any((place / f"{clip}{ending}").is_file() for ending in (".csv", FAILED))


def _write(folder: Path, task: Task, outcome: Outcome, seed: int | None) -> None:
    if outcome.labels is None:
        write_failure(folder, task.clip, outcome.reason, seed=seed)
    else:
        write_prediction(folder, task.clip, outcome.labels, seed=seed)


def _parameters(configuration: Configuration) -> dict[str, Any]:
    method: Any = create(configuration.method, **configuration.parameters)
    return asdict(method)


def _meta(
    configuration: Configuration, clips: Mapping[str, Clip], seconds: float, *, given: bool
) -> SubmissionMeta:
    return SubmissionMeta(
        configuration.title,
        authors=("mseg",),
        n_motions_given=given,
        hardware=f"{platform.machine()}, one core per clip",
        seconds=round(seconds, 3),
        baseline=configuration.method in ("one_motion", "prevalence"),
        outliers=True,
        fingerprints={name: fingerprint(clip) for name, clip in clips.items()},
        parameters={k: str(v) for k, v in _parameters(configuration).items()},
    )
