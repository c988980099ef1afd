"""Published results: one JSON file per method, benchmark and dataset version, and tables made of them.

::

    results/kt3dmoseg/2018/subset.json      what `publish` writes and `read_results` reads and checks

Files hold counts of trajectories, so that a table is exact and a changed figure is a changed line.
"""

from __future__ import annotations

import json
import os
import platform
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import scipy
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import read_bytes, write_text
from kt3dmoseg.parallel import algorithm_version
from kt3dmoseg.types import FloatArray
from mseg.benchmark.results import BenchmarkResult, published_name
from mseg.evaluation.protocol import Protocol, count, list_protocols, load_protocol
from mseg.evaluation.results import ResultsTable, clip_table, error_table
from mseg.methods import create

SCHEMA = "SCHEMA.json"
_LARGEST = 4 << 20
_Count = Annotated[int, Field(ge=0)]


class _Model(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class ClipResult(_Model):
    """One clip; lists have one item per seed."""

    motions: int = Field(ge=1, description="true number of motions")
    scored: int = Field(ge=1, description="trajectories with a true label")
    wrong: list[_Count] = Field(description="scored trajectories that are wrong under the best assignment")
    found: list[_Count] = Field(description="predicted groups among the scored trajectories; 0 = failed")
    seconds: float = Field(ge=0, allow_inf_nan=False, description="CPU time, mean over seeds")
    failures: dict[str, str] = Field(default_factory=dict, description="seed -> why the method failed")


class PublishedResult(_Model):
    """Scores of one method on one version of a benchmark's data."""

    format: Literal["mseg-result"] = "mseg-result"
    version: Literal[1] = 1
    title: str = Field(min_length=1, description="method, and parameters that are not the defaults")
    method: str = Field(min_length=1)
    parameters: dict[str, str] = Field(description="all parameters of the method")
    benchmark: str
    dataset_version: str = Field(pattern=r"^[\w.-]+$")
    dataset_sha256: str = Field(pattern="^[0-9a-f]{64}$", description="of trajectories and labels")
    n_motions: Literal["given", "found"] = Field(description="whether the method was given their number")
    versions: dict[str, str] = Field(description="of the package, the method's algorithm, numpy and scipy")
    hardware: str
    seeds: list[_Count] = Field(min_length=1)
    clips: dict[str, ClipResult] = Field(min_length=1)

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> Self:
        if self.benchmark not in list_protocols():
            raise ValueError(f"benchmark: expected {', '.join(list_protocols())}, found {self.benchmark!r}")
        for name, clip in self.clips.items():
            if not self.protocol.holds(name):
                raise ValueError(f"clips.{name}: expected a clip of {self.protocol.title}")
            if not len(clip.wrong) == len(clip.found) == len(self.seeds) == len(set(self.seeds)):
                raise ValueError(f"clips.{name}: expected {count(len(self.seeds), 'figure')}, one per seed")
            if max(clip.wrong) > clip.scored:
                raise ValueError(
                    f"clips.{name}.wrong: expected at most {clip.scored}, found {max(clip.wrong)}"
                )
        return self

    @property
    def protocol(self) -> Protocol:
        """The benchmark."""
        return load_protocol(self.benchmark)

    @property
    def motions(self) -> dict[str, int]:
        """True number of motions of every clip."""
        return {name: clip.motions for name, clip in self.clips.items()}

    @property
    def errors(self) -> FloatArray:
        """Classification error, (clips, seeds) float64, fractions."""
        return np.array([[wrong / clip.scored for wrong in clip.wrong] for clip in self.clips.values()])

    @property
    def seconds(self) -> float:
        """CPU seconds of one seed on all clips."""
        return sum(clip.seconds for clip in self.clips.values())

    @property
    def path(self) -> Path:
        """Where the file lies in the folder of results."""
        name = re.sub(r"[^\w.=-]+", "-", self.title) + ("-found" if self.n_motions == "found" else "")
        return Path(self.benchmark, self.dataset_version, f"{name}.json")

    def text(self) -> str:
        """Write as JSON, one line per field and per clip."""
        values = self.model_dump()
        clips = values.pop("clips")
        lines = [f" {json.dumps(name)}: {json.dumps(value)}," for name, value in values.items()]
        kept = {name: {k: v for k, v in clip.items() if k != "failures" or v} for name, clip in clips.items()}
        rows = [f"  {json.dumps(name)}: {json.dumps(clip)}" for name, clip in kept.items()]
        return "\n".join(["{", *lines, ' "clips": {', ",\n".join(rows), " }", "}", ""])


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of a file of results, which results/SCHEMA.json holds."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **PublishedResult.model_json_schema(),
        "title": "Result of a method on a benchmark, version 1",
    }


def published_results(result: BenchmarkResult) -> Iterator[PublishedResult]:
    """Yield what is published of a run of `mseg.benchmark.run`, one per configuration."""
    source = result.provenance
    if source is None or result.found is None:
        raise InvalidValueError("publish", expected="the result of mseg.benchmark.run", found="no provenance")
    for m, configuration in enumerate(result.configurations):
        if np.isnan(result.seconds[m]).any():
            fix = "run the same command again"
            raise InvalidValueError(
                f"publish {configuration.title}", expected="every run", found="workers that died", fix=fix
            )
        failures = [each[1:] for each in result.failures if each[0] == configuration]
        method: Any = create(configuration.method, **configuration.parameters)
        clips = {
            name: ClipResult(
                motions=result.motions[name],
                scored=n,
                wrong=np.rint(result.errors[m, i] * n).astype(int).tolist(),
                found=result.found[m, i].tolist(),
                seconds=round(float(result.seconds[m, i].mean()), 2),
                failures={str(seed): reason for clip, seed, reason in failures if clip == name},
            )
            for i, (name, n) in enumerate(result.scored.items())
        }
        yield PublishedResult(
            title=configuration.title,
            method=configuration.method,
            parameters={name: str(value) for name, value in asdict(method).items()},
            benchmark=result.protocol.name,
            dataset_version=source.dataset_version or f"data-{source.dataset_sha256[:8]}",
            dataset_sha256=source.dataset_sha256,
            n_motions=result.number,
            versions={
                "kt3dmoseg": source.toolkit_version,
                "algorithm": algorithm_version(type(method)) or "",
                "numpy": np.__version__,
                "scipy": scipy.__version__,
            },
            hardware=f"{platform.machine()}, one core per clip",
            seeds=list(result.seeds),
            clips=clips,
        )


def publish(result: BenchmarkResult, folder: str | os.PathLike[str]) -> list[Path]:
    """Write one file per configuration into a folder of results; returns their paths.

    Raises
    ------
    InvalidValueError
        When a file there has seeds or clips that this run lacks, or a run was lost with its worker.
    """
    made = {Path(folder) / each.path: each for each in published_results(result)}
    for path, new in made.items():
        old = read_result(path) if path.is_file() else new
        lost = [
            *map(str, sorted(set(old.seeds) - set(new.seeds))),
            *(c for c in old.clips if c not in new.clips),
        ]
        if lost:
            raise InvalidValueError(
                str(path),
                expected="no more seeds and clips than this run has",
                found=f"{', '.join(lost[:5])} there only",
                fix="run all of them, or remove the file",
            )
    for path, new in made.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, new.text())
    return list(made)


def read_result(path: str | os.PathLike[str]) -> PublishedResult:
    """Read one file; FileFormatError names the first field that is wrong."""
    try:
        return PublishedResult.model_validate_json(read_bytes(path, _LARGEST))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        found = ": ".join(part for part in (".".join(map(str, first["loc"])), first["msg"]) if part)
        raise FileFormatError(
            os.fspath(path), expected="a result as 'mseg benchmark --publish' writes it", found=found
        ) from None


def read_results(folder: str | os.PathLike[str]) -> dict[tuple[str, str], list[PublishedResult]]:
    """Read a folder of results, by benchmark and dataset version; methods as Table 1 of Xu et al. has them.

    Raises
    ------
    InputFileError
        When there is none.
    FileFormatError
        When a file is wrong, lies under another name, or two of one dataset are of other data.
    """
    found: dict[tuple[str, str], list[PublishedResult]] = {}
    for path in sorted(Path(folder).glob("*/*/*.json")):
        one = read_result(path)
        if path != Path(folder) / one.path:
            raise FileFormatError(str(path), expected=f"the name {one.path}", found="another")
        group = found.setdefault((one.benchmark, one.dataset_version), [])
        if group and (one.dataset_sha256, one.motions) != (group[0].dataset_sha256, group[0].motions):
            raise FileFormatError(str(path), expected=f"the clips of {group[0].path}", found="others")
        group.append(one)
    if not found:
        raise InputFileError(
            os.fspath(folder), expected="results as BENCHMARK/VERSION/METHOD.json", found="none"
        )
    return {key: sorted(group, key=_order) for key, group in sorted(found.items())}


def _order(result: PublishedResult) -> tuple[bool, int, str]:
    rows = [name.lower().replace("-", "") for name in result.protocol.published]
    name = "prevalence" if result.method == "one_motion" else result.method
    return result.n_motions == "found", rows.index(name) if name in rows else len(rows), result.title


def summary(results: Sequence[PublishedResult]) -> ResultsTable:
    """One row per method of one dataset: mean ± spread over seeds and median of every group, and time."""
    first = results[0]
    known = (published_name(first.protocol, each.method) for each in results)
    extra = {
        "seeds": [str(len(each.seeds)) for each in results],
        "right number of groups, %": [f"{100 * _right_number(each):.0f}" for each in results],
        "CPU s per seed": [f"{each.seconds:.1f}" for each in results],
        "failed runs": [str(sum(len(clip.failures) for clip in each.clips.values())) for each in results],
    }
    return error_table(
        f"{_heading(first)}: classification error in %, lower is better",
        first.protocol,
        first.motions,
        {_row(each): each.errors for each in results},
        [name for name in dict.fromkeys(known) if name],
        extra=extra,
    )


def per_clip(results: Sequence[PublishedResult]) -> ResultsTable:
    """One row per clip of one dataset, one column per method."""
    first = results[0]
    title = f"{_heading(first)}: classification error in % per clip, lower is better"
    return clip_table(title, {_row(each): each.errors for each in results}, first.motions)


def _right_number(result: PublishedResult) -> float:
    """Fraction of runs with as many groups as motions."""
    return float(np.mean([found == clip.motions for clip in result.clips.values() for found in clip.found]))


def _row(result: PublishedResult) -> str:
    return result.title + (", number found" if result.n_motions == "found" else "")


def _heading(result: PublishedResult) -> str:
    version = f"data version {result.dataset_version}"
    return f"{result.protocol.title}, {result.protocol.coverage(result.clips)}, {version}"
