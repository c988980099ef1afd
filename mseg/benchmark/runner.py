"""Methods x clips x seeds: run in parallel and kept, then scored or written as a submission."""

import json
import os
import platform
import re
import time
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias
from uuid import uuid4

import numpy as np
import scipy

from kt3dmoseg.errors import InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import PathLike, check_writable, hold_folder, parse_json, read_bytes, write_text
from kt3dmoseg.frames import recorded_inputs, recorded_source
from kt3dmoseg.io import dataset_paths, load
from kt3dmoseg.parallel import Cache, algorithm_version, cache_key, run_tasks
from kt3dmoseg.registry import strict
from kt3dmoseg.text import several
from kt3dmoseg.types import Clip, IntArray, Labels
from mseg import evaluation
from mseg.benchmark.results import RECIPE, BenchmarkResult, Configuration
from mseg.errors import SegmentationError
from mseg.evaluation.scoring import ScoreTable, clip_score, provenance_of
from mseg.evaluation.submission import FAILED, file_of, prediction_files
from mseg.evaluation.validation import load_clips
from mseg.kernels import kernel_cache
from mseg.methods import check_whole, create, segment

VARIABLE = "KT3DMOSEG_DATA"
_SHARED = Path("..") / "shared" / "data"
# MTPV62 takes 50 of its 62 clips from Hopkins155.
_BORROWED = {"mtpv62": ("hopkins155",)}
BASELINES = ("one_motion", "prevalence")  # one label for a whole clip is meant
_THIS_PROCESS = uuid4().hex
# Which configuration made the predictions of a folder; hidden, so no part of the submission.
_RECORD = ".mseg-run.json"
# Of what made a synthetic drive, all but the versions of libraries and of the flow.
_RECIPE = "source", "options", "algorithms"
_LARGEST_RECORD = 64 << 20

Rows: TypeAlias = Literal["evaluated", "all"]
Progress = Callable[[int, int, str], None]
"""Called with the number of tasks done, their total, and the name of the last."""


class Outcome(NamedTuple):
    """The result of a method on a clip with one seed."""

    labels: IntArray  # empty when it failed
    seconds: float  # CPU time, with that of kernels which another method of the task had made already
    reason: str = ""  # why it failed
    notes: str = ""  # what one must know to trust the labels


@dataclass(frozen=True, eq=False)
class Task:
    """What to run on one clip with one seed: methods that share kernels."""

    clip: Clip  # without labels
    n_motions: int | None  # given to the methods
    seed: int
    work: Mapping[str, Configuration]  # by the keys of their outcomes
    kernels: str = ""  # folder where kernels are kept for later runs
    rows: Rows = "evaluated"  # what is labelled, see `mseg.segment`

    @property
    def name(self) -> str:
        """For progress and schedulers."""
        return f"{self.clip.name}, seed {self.seed}"


@strict
def run(
    benchmark: str = "kt3dmoseg",
    methods: str | Iterable[str | Configuration] = "subset",
    *,
    data: PathLike | Sequence[PathLike] = (),
    seeds: int | Sequence[int] = 1,
    parameters: Mapping[str, Any] | None = None,
    number: Literal["given", "found"] = "given",
    workers: int = 1,
    dask: str = "",
    cache: PathLike | None = None,
    kernels: PathLike | None = None,
    progress: Progress | None = None,
) -> BenchmarkResult:
    """Run methods on every clip of a benchmark that is found, and score them.

    A clip on which a method fails counts as fully wrong.

    Parameters
    ----------
    benchmark : str
        Name of a protocol, see `mseg.evaluation.list_protocols`.
    methods : str, or iterable of str or Configuration
        What to run.
    data : path or sequence of paths
        Folders of clips; default: see `mseg.benchmark.find_clips`.
    seeds : int or sequence of int
        Number of seeds, counted from 0, or the seeds.
    parameters : mapping, optional
        Parameters for those of the methods that have them.
    number : {"given", "found"}
        Whether the methods are given the number of motions of each clip, or find it. One that cannot fails.
    workers : int
        Processes on this machine.
    dask : str
        Address of a Dask scheduler, instead of processes.
    cache : path, optional
        Folder of outcomes: what is there already is not run again.
    kernels : path, optional
        Folder of kernels, for sweeps over what comes after them.
    progress : callable, optional
        Called as tasks finish.

    Raises
    ------
    UnknownNameError, InputFileError, SegmentationError
        For a benchmark, method or parameter that does not exist; without clips; when every run failed (with a
        `cache`, the reasons are kept there).
    """
    protocol, wanted = evaluation.load_protocol(benchmark), _seeds(seeds)
    configurations = _configure([methods] if isinstance(methods, str) else methods, parameters or {})
    if not configurations:
        raise InvalidValueError("benchmark", expected="at least one method", found="none")
    paths, others = find_clips(protocol, data)
    every = {name: replace(load(path), name=name) for name, path in paths.items()}
    clips = {name: clip for name, clip in every.items() if clip.n_motions}
    if not clips:
        found = f"{several(list(every), 5)} without"
        raise InvalidValueError(benchmark, expected="clips with labels", found=found)
    others += every.keys() - clips.keys()
    motions = {name: clip.n_motions for name, clip in clips.items()}
    runs = _Runs(configurations, clips, motions if number == "given" else {}, wanted)
    store = Cache(cache)
    outcomes = {key: kept for key in runs.keys.values() if (kept := read_outcome(store, key))}
    where: Any = {"kernels": str(kernels or ""), "workers": workers, "dask": dask}
    for key, outcome in runs.outcomes(set(outcomes), progress, **where):
        outcomes[key] = outcome
        keep_outcome(store, key, outcome)
    checksums = {name: evaluation.clip_checksum(clip) for name, clip in clips.items()}
    source = provenance_of(clips, checksums, protocol.version_of(checksums) or recipe(clips))
    tables, notes = [], []
    for m, made in enumerate(configurations):
        runs_of = {(name, seed): outcomes[runs.keys[m, name, seed]] for name in clips for seed in wanted}
        scores = (
            clip_score(name, seed, clips[name].labels, None if out.reason else out.labels, out.reason)
            for (name, seed), out in runs_of.items()
        )
        predicted = cache_key({f"{name} {seed}": out.labels for (name, seed), out in runs_of.items()})
        of_method, meta = replace(source, submission_sha256=predicted), evaluation.SubmissionMeta(made.title)
        tables.append(ScoreTable(tuple(scores), meta, protocol, of_method))
        notes += [(made, name, seed, out.notes) for (name, seed), out in runs_of.items() if out.notes]
    seconds = np.array([outcomes[key].seconds for key in runs.keys.values()])
    shape = (len(configurations), len(clips), len(wanted))
    result = BenchmarkResult(
        configurations, tuple(tables), seconds.reshape(shape), tuple(sorted(others)), tuple(notes), number
    )
    reasons = [f"{made.title} on {name}: {reason}" for made, name, _, reason in result.failures]
    _check_success(protocol.name, reasons, len(runs.keys))
    return result


def recipe(clips: Mapping[str, Clip]) -> str:
    """Name the version of drives that `kt3dmoseg synth` made by what made them; empty for other clips.

    Processors differ in how they round a grey level, so positions of the same drives differ a little.
    """
    if not all(recorded_source(clip.provenance, "synthetic") for clip in clips.values()):
        return ""
    made = {name: recorded_inputs(clip.provenance) for name, clip in sorted(clips.items())}
    return RECIPE + cache_key({n: [i.get(key) for key in _RECIPE] for n, i in made.items()})[:8]


@strict
def predict(
    data: PathLike,
    output: PathLike,
    method: str = "subset",
    *,
    n_motions: int | None = None,
    number: Literal["given", "found"] = "given",
    seeds: int | Sequence[int] = 1,
    parameters: Mapping[str, Any] | None = None,
    rows: Rows = "evaluated",
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
    number : {"given", "found"}
        With "found", the method finds the number of every clip. One that cannot fails.
    seeds, parameters, workers, dask, progress
        As of `mseg.benchmark.run`.
    rows : {"evaluated", "all"}
        With "all", the labels of all trajectories are written, too, into another folder, ``<output>-all``;
        see `mseg.segment`.

    Raises
    ------
    InvalidValueError, SegmentationError
        When the folder holds predictions of another configuration, of other clips, seeds or layout, or
        `n_motions` is not positive; when the method failed on every clip (the reasons are in the folder).
    """
    folder, wanted = Path(output), _seeds(seeds)
    [configuration] = _configure([method], parameters or {})
    made: Any = create(method, **configuration.parameters)
    clips = load_clips(data)
    given = _given(clips, n_motions, number)
    runs = _Runs([configuration], clips, given, wanted, rows)
    if folder.resolve() == Path(data).resolve():
        fix = "write to another folder"
        raise InvalidValueError(f"{folder}", expected="a folder of predictions", found="the data", fix=fix)
    check_writable(folder)
    values, layout = asdict(made), "seed-N" if len(wanted) > 1 else "flat"
    description = {
        "method": method,
        "parameters": {name: repr(value) for name, value in values.items()},
        "code": algorithm_version(type(made)) or "",
        "n_motions": number if n_motions is None else int(n_motions),
        "layout": layout,
        "rows": rows,
    }
    with hold_folder(folder, alone="run"):
        folders = [folder, *([Path(f"{folder}-all")] if rows == "all" else [])]
        record = _open_record(folder, description)

        def place(name: str, seed: int) -> str:
            return name if layout == "flat" else f"seed-{seed}/{name}"

        # Files of an outcome, by its key: their names, with clip and seed.
        files: dict[str, dict[str, tuple[str, int | None]]] = {}
        for (_, name, seed), key in runs.keys.items():
            files.setdefault(key, {})[place(name, seed)] = name, None if layout == "flat" else seed
        _check_others(folder, clips, wanted if layout != "flat" else ())
        written = record["made"]  # file -> key of the outcome in it, seconds, notes
        kept = {
            key
            for key, places in files.items()
            if all(
                written.get(file, [""])[0] == key and _is_there(folders, *run) for file, run in places.items()
            )
        }
        for key, outcome in runs.outcomes(kept, progress, workers=workers, dask=dask):
            for file in files[key].keys() & written.keys():
                del written[file]  # until it is written
                write_text(folder / _RECORD, json.dumps(record, indent=1))
            for name, seed_of_file in files[key].values():
                _write_outcome(folders, clips[name], outcome, seed_of_file)
            if not np.isnan(outcome.seconds):  # else its workers died: the next run tries again
                written |= {file: [key, outcome.seconds, outcome.notes] for file in files[key]}
            write_text(folder / _RECORD, json.dumps(record, indent=1))
        runs_made = {
            (name, seed): written.get(place(name, seed), ["", 0.0, ""]) for _, name, seed in runs.keys
        }
        seconds = sum(each[1] for each in runs_made.values()) / len(wanted)
        noted = {run: each[2] for run, each in runs_made.items()}
        meta = evaluation.SubmissionMeta(
            configuration.title,
            authors=("mseg",),
            n_motions_given=any(given.values()),  # those of clips with labels always are
            hardware=f"{platform.machine()}, one core per clip",
            seconds=round(seconds, 3),
            baseline=method in BASELINES,
            outliers=True,
            fingerprints={name: evaluation.clip_checksum(clip) for name, clip in clips.items()},
            parameters={name: str(value) for name, value in values.items()},
            notes={name: text for name in clips if (text := _note(noted, name, wanted))},
        )
        evaluation.write_meta(folder, meta)
    failed = [path for path in prediction_files(folder) if path.suffix == FAILED]
    reasons = [f"{path.relative_to(folder)}: {path.read_text().strip()}" for path in failed]
    _check_success(f"{folder}", reasons, len(runs.keys))
    return folder


def _given(clips: Mapping[str, Clip], n_motions: int | None, number: str) -> dict[str, int | None]:
    """Numbers of motions that the method is given, by clip."""
    if n_motions is not None:
        check_whole("n_motions", n_motions, 1)
        if number == "found":
            found = f"{n_motions}"
            raise InvalidValueError("n_motions", expected="none where it is to be found", found=found)
        return dict.fromkeys(clips, int(n_motions))
    return {name: clip.n_motions or None if number == "given" else None for name, clip in clips.items()}


def _check_success(where: str, reasons: Sequence[str], n_runs: int) -> None:
    if len(reasons) == n_runs:
        raise SegmentationError(where, expected="a run that succeeds", found=several(reasons, 3))


def find_clips(
    protocol: evaluation.Protocol, data: PathLike | Sequence[PathLike] = ()
) -> tuple[dict[str, Path], list[str]]:
    """Find the clips of a benchmark: paths by sorted name, and names of clips there that are not its.

    `data` are folders of clips; of clips of one name the first counts. By default it is the folder that the
    protocol names (and for MTPV62 that of Hopkins155) in ``$KT3DMOSEG_DATA``, or else in ``../shared/data``.
    InputFileError when a folder is missing or none of its clips belongs to the benchmark.
    """
    folders = [Path(folder) for folder in ([data] if isinstance(data, (str, os.PathLike)) else data)]
    if not folders:
        root = Path(os.environ.get(VARIABLE) or _SHARED)
        folder = _named(root, protocol.data)
        if not folder.is_dir():
            fix = f"give data=FOLDER, or set {VARIABLE} to the folder that holds {protocol.data}/"
            expected = f"the clips of {protocol.title}"
            raise InputFileError(str(folder), expected=expected, found="no such folder", fix=fix)
        borrowed = (_named(root, name) for name in _BORROWED.get(protocol.name, ()))
        folders = [folder, *(other for other in borrowed if other.is_dir())]
    found: dict[str, Path] = {}
    for folder in folders:
        found = {**dataset_paths(folder), **found}
    clips = {name: found[name] for name in sorted(found) if protocol.holds(name)}
    if not clips:
        there = f"{len(found)} others ({', '.join(list(found)[:3])})"
        raise InputFileError(", ".join(map(str, folders)), expected=f"clips of {protocol.title}", found=there)
    return clips, sorted(set(found) - set(clips))


def _named(root: Path, name: str) -> Path:
    """Find a folder by its name, or by that of the archive it comes from: ``Hopkins155`` for hopkins155."""
    alike = sorted(path for path in root.glob("*/") if path.name.lower() == name.lower())
    return root / name if (root / name).is_dir() or not alike else alike[0]


def _configure(
    methods: Iterable[str | Configuration], parameters: Mapping[str, Any]
) -> tuple[Configuration, ...]:
    """Make configurations, each once; a parameter goes to the methods that have it, and one of them must."""
    made, unused, named = {}, dict(parameters), "subset"
    for method in methods:
        configuration = method
        if isinstance(configuration, str):
            known = vars(create(configuration))
            named, own = configuration, {k: v for k, v in parameters.items() if k in known}
            unused = {k: v for k, v in unused.items() if k not in own}
            configuration = Configuration(configuration, own)
        configuration = _without_defaults(configuration)
        made[configuration.title] = configuration
    create(named, **unused)  # which it does not have: raises the error that names the nearest
    return tuple(made.values())


def _without_defaults(configuration: Configuration) -> Configuration:
    """Keep the parameters that differ from the defaults, as the method has them, however they were typed."""
    default: Any = create(configuration.method)
    method: Any = create(configuration.method, **configuration.parameters)
    values = {field.name: getattr(method, field.name) for field in fields(method) if field.init}
    own = {name: value for name, value in values.items() if value != getattr(default, name)}
    return Configuration(configuration.method, own)


def _seeds(seeds: int | Sequence[int]) -> tuple[int, ...]:
    """Return the seeds; of a number of them, those counted from 0."""
    if not isinstance(seeds, (Sequence, np.ndarray)):
        check_whole("seeds", seeds, 1)
        return tuple(range(seeds))
    for seed in seeds:
        check_whole("seeds", seed, 0)
    if not len(seeds) or len(set(seeds)) < len(seeds):
        raise InvalidValueError("seeds", expected="one or more, each once", found=str(list(seeds))[:80])
    return tuple(map(int, seeds))


# --- running ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Runs:
    configurations: Sequence[Configuration]
    clips: Mapping[str, Clip]
    numbers: Mapping[str, int | None]  # of motions, given to the methods
    seeds: Sequence[int]
    rows: Rows = "evaluated"

    @cached_property
    def keys(self) -> dict[tuple[int, str, int], str]:
        """Keys of outcomes, by number of the configuration, clip and seed."""
        return {
            (m, name, seed): outcome_key(configuration, clip, self.numbers.get(name), seed)
            for m, configuration in enumerate(self.configurations)
            for name, clip in self.clips.items()
            for seed in self.seeds
        }

    def outcomes(
        self,
        kept: Container[str],
        progress: Progress | None,
        kernels: str = "",
        **where: Any,  # noqa: ANN401
    ) -> Iterator[tuple[str, Outcome]]:
        """Run what is not kept, large clips first, and yield outcomes with their keys as they finish."""
        todo: dict[tuple[str, int], dict[str, Configuration]] = {}
        claimed = set[str]()
        for (m, name, seed), key in self.keys.items():
            if key not in claimed and key not in kept:
                claimed.add(key)
                todo.setdefault((name, seed), {})[key] = self.configurations[m]
        tasks = [
            Task(self.clips[name].without_labels(), self.numbers.get(name), seed, work, kernels, self.rows)
            for (name, seed), work in todo.items()
        ]
        tasks.sort(key=lambda task: -len(task.clip.evaluated) * task.clip.n_frames)
        total = len(tasks)
        for done, (task, made) in enumerate(_made(tasks, **where), 1):
            yield from made.items()
            total += 0 if made else len(task.work)  # each of which is to be run by itself
            if progress:
                progress(done, total, task.name)


def _made(tasks: Sequence[Task], **where: Any) -> Iterator[tuple[Task, dict[str, Outcome]]]:  # noqa: ANN401
    """Run tasks; one of several methods that is lost has no outcomes, and each of them is run by itself.

    So a method that ends its worker costs no other method the clip.
    """
    alone: list[Task] = []

    def lost(task: Task, reason: str) -> dict[str, Outcome]:
        if len(task.work) == 1:
            return lost_task(task, reason)
        alone.extend(replace(task, work={key: made}) for key, made in task.work.items())
        return {}

    yield from run_tasks(run_task, tasks, lost=lost, **where)
    # Dask blames all tasks that wait for a worker that dies, the pool only the one that runs.
    batches = [[task] for task in alone] if where.get("dask") else [alone] * bool(alone)
    for batch in batches:
        yield from run_tasks(run_task, batch, lost=lost_task, **where)


def run_task(task: Task, progress: Callable[..., None] | None = None) -> dict[str, Outcome]:
    """Run a task; a method that cannot segment the clip gives an outcome with a reason."""
    outcomes: dict[str, Outcome] = {}
    with kernel_cache(task.kernels or None) as cache:
        for key, made in task.work.items():
            saved, start = cache.saved_seconds, time.process_time()
            labels, reason, notes = np.zeros(0, dtype=np.int64), "", ()
            method = create(made.method, **made.parameters)  # a worker that lacks it ends the run
            try:
                given: Any = {"n_motions": task.n_motions, "seed": task.seed}
                found = segment(task.clip, method, rows=task.rows, **given)
                labels, notes = np.array(found.labels), found.report["notes"]
            except MemoryError as error:  # says nothing of the method either
                outcomes |= lost_task(replace(task, work={key: made}), f"{error}" or "no memory is left")
                continue
            except InputFileError:  # the disk's fault, as of kernels that cannot be kept
                raise
            except KT3DMoSegError as error:
                reason = " ".join(str(error).split()) or type(error).__name__
                # The caller that shows it names the clip.
                reason = re.sub(rf"^{re.escape(task.clip.name)}[:,] ", "", reason)
            seconds = time.process_time() - start + cache.saved_seconds - saved
            noted = "" if made.method in BASELINES else "; ".join(notes)
            outcomes[key] = Outcome(labels, seconds, reason, noted)
    return outcomes


def lost_task(task: Task, reason: str) -> dict[str, Outcome]:
    """Outcomes of a task that no worker survived, or for which memory did not suffice."""
    return dict.fromkeys(task.work, Outcome(np.zeros(0, dtype=np.int64), float("nan"), reason))


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
    if kept is None or kept.keys() != {*Outcome._fields}:  # of an earlier version
        return None
    texts = str(kept["reason"]), str(kept["notes"])
    return Outcome(kept["labels"].astype(np.int64), float(kept["seconds"]), *texts)


def keep_outcome(cache: Cache, key: str, outcome: Outcome) -> None:
    """Keep an outcome; one of a worker that died, or without memory, is no evidence on the method."""
    if not np.isnan(outcome.seconds):
        cache.put(key, outcome._asdict())


# --- the folder of predictions ----------------------------------------------------------------------


def _is_there(folders: Sequence[Path], clip: str, seed: int | None) -> bool:
    """Whether an earlier run has written a clip's labels into every folder, or why there are none."""
    failed = file_of(folders[0], clip, seed, FAILED).is_file()
    return failed or all(file_of(folder, clip, seed, ".csv").is_file() for folder in folders)


def _write_outcome(folders: Sequence[Path], clip: Clip, outcome: Outcome, seed: int | None) -> None:
    """Write the labels of the evaluated trajectories, and into a second folder those of all."""
    if outcome.reason:
        for folder in folders:
            file_of(folder, clip.name, seed, ".csv").unlink(missing_ok=True)
        evaluation.write_failure(folders[0], clip, outcome.reason, seed=seed)
    elif len(folders) == 1:
        evaluation.write_prediction(folders[0], clip, outcome.labels, seed=seed)
    else:
        evaluation.write_prediction(folders[0], clip, outcome.labels[clip.evaluated], seed=seed)
        whole = replace(clip, evaluated=np.arange(len(clip.dense)), labels=Labels(outcome.labels))
        evaluation.write_prediction(folders[1], whole, outcome.labels, seed=seed)


def _note(notes: Mapping[tuple[str, int], str], clip: str, seeds: Sequence[int]) -> str:
    """Join the notes on a clip: one on all seeds as it is, others with their seeds."""
    runs = {seed: notes[clip, seed] for seed in seeds}
    parts = []
    for text in dict.fromkeys(filter(None, runs.values())):
        those = [seed for seed in seeds if runs[seed] == text]
        parts.append(text if len(those) == len(seeds) else f"seed {several(those, 5)}: {text}")
    return "; ".join(parts)[:2000]


def _check_others(folder: Path, clips: Container[str], seeds: Sequence[int]) -> None:
    """Refuse predictions of other seeds or clips, which would be scored, too."""
    files, wanted = prediction_files(folder), {f"seed-{seed}" for seed in seeds}
    older = {
        "seeds": sorted({path.parent.name for path in files} - wanted) if seeds else [],
        "clips": sorted({path.stem for path in files if path.stem not in clips}),
    }
    for what, names in older.items():
        if names:
            found, fix = f"{several(names, 5)} of an earlier run", "remove them, or write to another folder"
            raise InvalidValueError(f"{folder}", expected=f"no other {what}", found=found, fix=fix)


def _open_record(folder: Path, description: Mapping[str, Any]) -> dict[str, Any]:
    """Read what an earlier run left, refusing to mix two configurations."""
    path = folder / _RECORD
    if path.is_file():
        record = parse_json(read_bytes(path, _LARGEST_RECORD), f"{path}", _LARGEST_RECORD)
        was = record.get("configuration", {})
        differs = [key for key in description if was.get(key) != description[key]]
        found = f"predictions of another ({was.get('method')}; differs in {', '.join(differs)})"
        if not differs:
            return {"made": {}, **record}
    else:
        files = prediction_files(folder)
        found = f"{several([each.name for each in files], 5)}, not written by 'mseg run'"
        if not files:
            return {"configuration": description, "made": {}}
    raise InvalidValueError(
        str(folder),
        expected=f"no predictions, or those of this configuration ({description['method']})",
        found=found,
        fix="write to another folder",
    )
