"""Predictions of one method for a folder of clips, written as a submission."""

from __future__ import annotations

import json
import math
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.files import check_writable, parse_json, read_bytes, write_text
from kt3dmoseg.io.predictions import first_few
from kt3dmoseg.parallel import algorithm_version, run_tasks
from mseg.benchmark.runner import Progress, configure
from mseg.benchmark.tasks import BASELINES, Task, lost_task, outcome_key, run_task, seed_numbers
from mseg.evaluation import SubmissionMeta, clip_checksum, write_failure, write_meta, write_prediction
from mseg.evaluation.submission import FAILED, file_of, prediction_files
from mseg.evaluation.validation import load_clips
from mseg.methods import check_whole, create

# Which configuration made the predictions; hidden, so no part of the submission.
_RECORD = ".mseg-run.json"
_LARGEST = 64 << 20


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
    if n_motions is not None:
        check_whole("n_motions", n_motions, 1)
    folder = Path(output)
    configuration = configure([method], parameters or {})[0]
    made: Any = create(configuration.method, **configuration.parameters)
    wanted = seed_numbers(seeds)
    layout = {seed: None if len(wanted) == 1 else seed for seed in wanted}
    clips = load_clips(data)
    given = {name: n_motions or clip.n_motions or None for name, clip in clips.items()}
    keys = {
        (name, seed): outcome_key(configuration, clip, given[name], seed)
        for name, clip in clips.items()
        for seed in wanted
    }
    check_writable(folder)
    record = _open_record(
        folder,
        {
            "method": configuration.method,
            "parameters": {name: repr(value) for name, value in asdict(made).items()},
            "code": algorithm_version(type(made)) or "",
            "n_motions": n_motions,
            "layout": "seed-N" if len(wanted) > 1 else "flat",
        },
    )
    tasks = [
        Task(clips[name].without_labels(), given[name], seed, ((key, configuration),))
        for (name, seed), key in keys.items()
        if key not in record["done"]
        or not any(file_of(folder, name, layout[seed], ending).is_file() for ending in (".csv", FAILED))
    ]
    results = run_tasks(run_task, tasks, lost=lost_task, workers=workers, dask=dask)
    for done, (task, (outcome,)) in enumerate(results, 1):
        if outcome.labels is None:
            file_of(folder, task.clip.name, layout[task.seed], ".csv").unlink(missing_ok=True)
            write_failure(folder, task.clip, outcome.reason, seed=layout[task.seed])
        else:
            write_prediction(folder, task.clip, outcome.labels, seed=layout[task.seed])
        if not math.isnan(outcome.seconds):  # else its workers died: the next run tries again
            record["done"][outcome.key] = outcome.seconds
            record["notes"][outcome.key] = outcome.notes
        write_text(folder / _RECORD, json.dumps(record, indent=1))
        if progress:
            progress(done, len(tasks), task.name)
    seconds = sum(record["done"].get(key, 0.0) for key in keys.values()) / len(wanted)
    meta = SubmissionMeta(
        configuration.title,
        authors=("mseg",),
        n_motions_given=all(given.values()),
        hardware=f"{platform.machine()}, one core per clip",
        seconds=round(seconds, 3),
        baseline=configuration.method in BASELINES,
        outliers=True,
        fingerprints={name: clip_checksum(clip) for name, clip in clips.items()},
        parameters={name: str(value) for name, value in asdict(made).items()},
        notes=_notes({run: record["notes"].get(key, "") for run, key in keys.items()}),
    )
    write_meta(folder, meta)
    return folder


def _notes(by_run: Mapping[tuple[str, int], str]) -> dict[str, str]:
    """Join the notes on each clip, by clip: those on all seeds once, others with their seeds."""
    notes: dict[str, str] = {}
    for name in dict.fromkeys(clip for clip, _ in by_run):
        runs = {seed: note for (clip, seed), note in by_run.items() if clip == name}
        texts = {text: [s for s in runs if runs[s] == text] for text in dict.fromkeys(runs.values()) if text}
        parts = [
            text if len(seeds) == len(runs) else f"seed {first_few(seeds)}: {text}"
            for text, seeds in texts.items()
        ]
        if parts:
            notes[name] = "; ".join(parts)[:2000]
    return notes


def _open_record(folder: Path, configuration: Mapping[str, Any]) -> dict[str, Any]:
    """Read what an earlier run left, refusing to mix two configurations."""
    path = folder / _RECORD
    if path.is_file():
        record = parse_json(read_bytes(path, _LARGEST), f"{path}", _LARGEST)
        was = record.get("configuration", {})
        differs = [key for key in configuration if was.get(key) != configuration[key]]
        found = f"predictions of another ({was.get('method')}; differs in {', '.join(differs)})"
        if not differs:
            return {"notes": {}, **record}
    else:
        files = prediction_files(folder)
        found = f"{first_few([each.name for each in files])}, not written by 'mseg run'"
        if not files:
            return {"configuration": configuration, "done": {}, "notes": {}}
    raise InvalidValueError(
        str(folder),
        expected=f"no predictions, or those of this configuration ({configuration['method']})",
        found=found,
        fix="write to another folder",
    )
