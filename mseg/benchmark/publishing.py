"""Published results: one JSON file per method, benchmark and dataset version.

::

    results/kt3dmoseg/2018/subset.json      what `publish` writes and `read_results` reads and checks

Files hold counts of trajectories, so that a table is exact and a changed figure is a changed line.
"""

import json
import os
import platform
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

import numpy as np
import scipy
from pydantic import BaseModel, Field, model_validator

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import PathLike, read_bytes, write_text
from kt3dmoseg.parallel import algorithm_version
from kt3dmoseg.text import count
from kt3dmoseg.types import FloatArray
from mseg.benchmark.results import RECIPE, BenchmarkResult
from mseg.evaluation.protocol import Protocol, list_protocols, load_protocol
from mseg.evaluation.results import published_name
from mseg.evaluation.scoring import ScoreTable, read_model
from mseg.methods import create

SCHEMA = "SCHEMA.json"
_LARGEST = 4 << 20
_Count = Annotated[int, Field(ge=0)]


class ClipResult(BaseModel, strict=True, extra="forbid", frozen=True):
    """One clip; lists have one item per seed."""

    motions: int = Field(ge=1, description="true number of motions")
    scored: int = Field(ge=1, description="trajectories with a true label")
    wrong: list[_Count] = Field(description="scored trajectories that are wrong under the best assignment")
    found: list[_Count] = Field(description="predicted groups among the scored trajectories; 0 = failed")
    seconds: float = Field(ge=0, allow_inf_nan=False, description="CPU time, mean over seeds")
    failures: dict[str, str] = Field(default_factory=dict, description="seed -> why the method failed")


class PublishedResult(BaseModel, strict=True, extra="forbid", frozen=True):
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
    authors: list[str] = Field(default=[], description="of a submission; of our own the source is documented")
    link: str = Field(default="", description="paper or code")
    supervised: bool = Field(default=False, description="whether trained with labels, of other clips")
    baseline: bool = Field(default=False, description="whether one label for a whole clip is meant")
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
            if (most := max(clip.wrong)) > clip.scored:
                raise ValueError(f"clips.{name}.wrong: expected at most {clip.scored}, found {most}")
        return self

    @property
    def protocol(self) -> Protocol:
        """The benchmark."""
        return load_protocol(self.benchmark)

    @property
    def data(self) -> tuple[str, dict[str, int]]:
        """What results of one dataset version have in common."""
        made = self.dataset_version.startswith(RECIPE)
        return "" if made else self.dataset_sha256, self.motions

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
    def right(self) -> float:
        """Share of the runs in which as many groups were found as there are motions."""
        return float(np.mean([found == each.motions for each in self.clips.values() for found in each.found]))

    @property
    def failed(self) -> int:
        """Number of runs that failed."""
        return sum(len(clip.failures) for clip in self.clips.values())

    @property
    def published(self) -> str:
        """Name of the method's row in the published table; empty where it has none."""
        return published_name(self.protocol, self.method)

    @property
    def row(self) -> str:
        """Name of the method in tables."""
        return self.title + (", number found" if self.n_motions == "found" else "")

    @property
    def heading(self) -> str:
        """Title of tables of the dataset."""
        version = f"data version {self.dataset_version}"
        return f"{self.protocol.title}, {self.protocol.coverage(self.clips)}, {version}"

    @property
    def path(self) -> Path:
        """Where the file lies in the folder of results."""
        name = re.sub(r"[^\w.=-]+", "-", self.title) + ("-found" if self.n_motions == "found" else "")
        return Path(self.benchmark, self.dataset_version, f"{name}.json")

    def text(self) -> str:
        """Write as JSON, one line per field and per clip."""
        optional = {"authors", "link", "supervised", "baseline"} - self.model_fields_set
        values = self.model_dump(exclude={"clips", *optional})
        lines = [f" {json.dumps(name)}: {json.dumps(value)}," for name, value in values.items()]
        clips = {name: clip.model_dump(exclude_defaults=True) for name, clip in self.clips.items()}
        rows = [f"  {json.dumps(name)}: {json.dumps(clip)}" for name, clip in clips.items()]
        return "\n".join(["{", *lines, ' "clips": {', ",\n".join(rows), " }", "}", ""])


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of a file of results, which results/SCHEMA.json holds."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **PublishedResult.model_json_schema(),
        "title": "Result of a method on a benchmark, version 1",
    }


def publish(result: BenchmarkResult, folder: PathLike) -> list[Path]:
    """Write one file per configuration of a `mseg.benchmark.run` into a folder; returns their paths.

    InvalidValueError when a file there has seeds or clips that this run lacks, files there are of other data,
    or a run's worker died.
    """
    made = {}
    for m in range(len(result.configurations)):
        new = _published(result, m)
        path = Path(folder) / new.path
        old = former(new, folder) or new
        lost = [*map(str, sorted({*old.seeds} - {*new.seeds})), *(c for c in old.clips if c not in new.clips)]
        if lost:
            expected, found = "no more seeds and clips than this run has", f"{', '.join(lost[:5])} there only"
            fix = "run all of them, or remove the file"
            raise InvalidValueError(str(path), expected=expected, found=found, fix=fix)
        made[path] = new.text()
    for path, text in made.items():
        write_text(path, text)
    return list(made)


def former(new: PublishedResult, folder: PathLike) -> PublishedResult | None:
    """Read the file that a result replaces; InvalidValueError when files next to it are of other data."""
    path = Path(folder) / new.path
    for other in sorted(path.parent.glob("*.json")):
        if (old := read_result(other)).data != new.data:
            expected = f"the data of {new.title}"
            found = f"other clips or labels, called {old.dataset_version}"
            fix = "publish into another folder, or remove what is there"
            raise InvalidValueError(str(other), expected=expected, found=found, fix=fix)
    return read_result(path) if path.is_file() else None


def _published(result: BenchmarkResult, m: int) -> PublishedResult:
    configuration, table = result.configurations[m], result.tables[m]
    if np.isnan(result.seconds[m]).any():
        where, fix = f"publish {configuration.title}", "run the same command again"
        raise InvalidValueError(where, expected="every run", found="workers that died", fix=fix)
    method: Any = create(configuration.method, **configuration.parameters)
    algorithm = algorithm_version(type(method)) or ""
    return collected(
        table,
        result.seconds[m].mean(axis=1),
        title=configuration.title,
        method=configuration.method,
        parameters={name: str(value) for name, value in asdict(method).items()},
        n_motions=result.number,
        versions={"algorithm": algorithm, "numpy": np.__version__, "scipy": scipy.__version__},
        hardware=f"{platform.machine()}, one core per clip",
    )


def collected(
    scores: ScoreTable,
    seconds: Iterable[float],
    versions: Mapping[str, str] = MappingProxyType({}),
    **facts: Any,  # noqa: ANN401  # fields of the result
) -> PublishedResult:
    """Collect what is published of scores, with the seconds of each clip."""
    source, clips = scores.provenance, {}
    for name, each in zip(scores.names, seconds, strict=True):
        runs = [scores.of(name, seed) for seed in scores.seeds]
        clips[name] = ClipResult(
            motions=runs[0].n_motions,
            scored=runs[0].n,
            wrong=[round(run.values["error"] * run.n) for run in runs],
            found=[run.n_found for run in runs],
            seconds=round(float(each), 6),
            failures={str(run.seed): run.reason for run in runs if run.reason},
        )
    return PublishedResult(
        benchmark=scores.benchmark.name,
        dataset_version=source.dataset_version or f"data-{source.dataset_sha256[:8]}",
        dataset_sha256=source.dataset_sha256,
        versions={"kt3dmoseg": source.toolkit_version, **versions},
        seeds=scores.seeds,
        clips=clips,
        **facts,
    )


def read_result(path: PathLike) -> PublishedResult:
    """Read one file; FileFormatError names the first field that is wrong."""
    expected = "a result that 'mseg benchmark' published"
    return read_model(PublishedResult, read_bytes(path, _LARGEST), os.fspath(path), expected)


def read_results(folder: PathLike) -> dict[tuple[str, str], list[PublishedResult]]:
    """Read a folder of results, by benchmark and dataset version; methods as Table 1 of Xu et al. has them.

    InputFileError when there is none; FileFormatError when a file is wrong, lies under another name, or two
    of one dataset are of other data.
    """
    found: dict[tuple[str, str], list[PublishedResult]] = {}
    for path in sorted(Path(folder).glob("*/*/*.json")):
        one = read_result(path)
        if path != Path(folder) / one.path:
            raise FileFormatError(str(path), expected=f"the name {one.path}", found="another")
        group = found.setdefault((one.benchmark, one.dataset_version), [])
        if group and one.data != group[0].data:
            raise FileFormatError(str(path), expected=f"the clips of {group[0].path}", found="others")
        # Pages take figures by their place, in whatever order a file has its clips.
        group.append(one.model_copy(update={"clips": dict(sorted(one.clips.items()))}))
    if not found:
        expected = "results as BENCHMARK/VERSION/METHOD.json"
        raise InputFileError(os.fspath(folder), expected=expected, found="none")
    return {key: sorted(group, key=_order) for key, group in sorted(found.items())}


def _order(result: PublishedResult) -> tuple[bool, int, str]:
    rows = [*result.protocol.published, ""]
    return result.n_motions == "found", rows.index(result.published), result.title
