"""Commands that run methods."""

from __future__ import annotations

import inspect
import json as json_
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from kt3dmoseg.app import Either, Flag, Folder, Name, Parameters, Positive, progress_bar

_N_MOTIONS = "Number of motions of every clip (default: that of its labels)."
_DATA = "Folders of clips (default: the protocol's folder in $KT3DMOSEG_DATA or ../shared/data)."
_JSON = "Everything as JSON: written to FILE in addition to the tables, or printed in their place."
_PUBLISH = "Write the scores there, one file per method and dataset version: BENCHMARK/VERSION/METHOD.json."
_NUMBER = "Give the methods the number of motions of each clip, or let them find it."
_PAPER = ("affine", "homography", "fundamental", "keradd", "coreg", "subset")

Names = Annotated[
    tuple[str, ...],
    Parameter(metavar="NAME", consume_multiple=(1, None), show_default=" ".join, help="Methods."),
]
Settings = Annotated[
    Parameters, Parameter(help="Parameter of a method, see 'mseg methods NAME'; may be repeated.")
]
Workers = Annotated[Positive, Parameter(help="Processes.")]
Dask = Annotated[str, Parameter(metavar="ADDRESS", help="Dask scheduler, tcp://host:8786.")]
Quiet = Annotated[Flag, Parameter(help="No progress bar.")]


def methods(
    method: Annotated[str, Parameter(help="Describe this one.")] = "",
    /,
    *,
    json: Annotated[Flag, Parameter(help="Print JSON.")] = False,
) -> None:
    """List the methods, or describe one: source, input, cost and parameters."""
    from mseg.methods import METHODS

    names = [method] if method else METHODS.names()
    if json:
        print(json_.dumps([_described(name) for name in names], indent=1))
    elif method:
        found = _described(method)
        print(f"{method}: {found['description']}\n\nparameters (-p name=value):")
        for parameter in found["parameters"]:
            print(f"  {parameter['name']} = {parameter['default']}\n      {parameter['help']}")
    else:
        width = max(map(len, names))
        for name in names:
            purpose = _described(name)["description"].partition("\n")[0]
            print(f"{name:<{width}}  {purpose}")


def _described(name: str) -> dict[str, Any]:
    """Docstring and parameters of a method."""
    from kt3dmoseg.options import describe
    from mseg.methods import METHODS

    try:
        cls = METHODS.load(name)
    except ImportError as error:
        return {"name": name, "description": f"(not available: {error})", "parameters": []}
    parameters = [dict(zip(("name", "default", "help"), row, strict=True)) for row in describe(cls)]
    return {"name": name, "description": inspect.cleandoc(cls.__doc__ or ""), "parameters": parameters}


def run(
    data: Annotated[Either, Parameter(help="Folder of clips, or one clip.")],
    /,
    *,
    output: Annotated[Folder, Parameter(alias="-o", help="Where predictions go.")],
    method: Annotated[Name, Parameter(help="Method.")] = "subset",
    n_motions: Annotated[Positive | None, Parameter(help=_N_MOTIONS)] = None,
    seeds: Annotated[Positive, Parameter(help="Number of seeds; several go to seed-0/, seed-1/, ...")] = 1,
    parameter: Settings = (),
    workers: Workers = 1,
    dask: Dask = "",
    quiet: Quiet = False,
) -> int:
    """Segment every clip of a folder with a method and write the predictions.

    The output is a submission: 'mseg validate' and 'mseg score' read it. What is there already is kept,
    so an interrupted run goes on; a folder that holds other predictions is refused. Exit code 1 when the
    method failed on every clip.
    """
    from kt3dmoseg.options import parse_assignments
    from mseg.benchmark import predict
    from mseg.evaluation.protocol import count
    from mseg.evaluation.submission import FAILED, META, parse_meta, prediction_files

    with progress_bar("task", quiet=quiet) as progress:
        folder = predict(
            data,
            output,
            method,
            n_motions=n_motions,
            seeds=seeds,
            parameters=parse_assignments(parameter),
            workers=workers,
            dask=dask,
            progress=progress,
        )
    files = prediction_files(folder)
    failed = [path for path in files if path.suffix == FAILED]
    lines = [f"failed: {path.relative_to(folder)}: {path.read_text().strip()}" for path in failed]
    meta, _ = parse_meta((folder / META).read_bytes())
    lines += [f"note: {clip}: {note}" for clip, note in meta.notes.items()]
    lines.append(f"wrote {folder}" + (f" ({count(len(failed), 'run')} failed)" if failed else ""))
    lines.append(f"check it: mseg validate {folder} {data}\nscore it: mseg score {folder} {data}")
    print("\n".join(lines), file=sys.stderr)
    return 1 if len(failed) == len(files) else 0


def benchmark(
    benchmark: Annotated[str, Parameter(help="Protocol: kt3dmoseg, hopkins155, hopkins12 or mtpv62.")],
    /,
    *,
    methods: Names = _PAPER,
    data: Annotated[tuple[Folder, ...], Parameter(consume_multiple=(1, None), help=_DATA)] = (),
    cache: Annotated[Folder, Parameter(help="Outcomes.")] = Path("out/benchmark"),
    no_cache: Annotated[Flag, Parameter(help="Run everything, keep nothing.")] = False,
    kernels: Annotated[
        Folder | None, Parameter(help="Keep kernels there, for sweeps over alpha or fusion.")
    ] = None,
    json: Annotated[list[str] | None, Parameter(metavar="FILE", consume_multiple=(0, 1), help=_JSON)] = None,
    markdown: Annotated[Flag, Parameter(help="Print Markdown tables.")] = False,
    publish: Annotated[Folder | None, Parameter(help=_PUBLISH)] = None,
    number: Annotated[Literal["given", "found"], Parameter(help=_NUMBER)] = "given",
    seeds: Annotated[Positive, Parameter(help="Number of seeds, counted from 0.")] = 1,
    parameter: Settings = (),
    workers: Workers = 1,
    dask: Dask = "",
    quiet: Quiet = False,
) -> int:
    """Run methods on every clip of a benchmark that is found, over several seeds, and print the tables.

    Outcomes are kept in a folder (--cache), so that a re-run, or one with more methods or seeds, runs
    only what is new. What is missing of the benchmark is listed; the published rows are for all of it.
    Exit code 1 when every run failed.
    """
    from kt3dmoseg.files import write_text
    from kt3dmoseg.options import parse_assignments
    from mseg.benchmark import run

    with progress_bar("task", quiet=quiet) as progress:
        result = run(
            benchmark,
            list(methods),
            data=data,
            seeds=seeds,
            parameters=parse_assignments(parameter),
            number=number,
            workers=workers,
            dask=dask,
            cache=None if no_cache else cache,
            kernels=kernels,
            progress=progress,
        )
    if json in ([], ["-"]):
        print(json_.dumps(result.as_dict(), indent=1))
    else:
        if json:
            write_text(json[0], json_.dumps(result.as_dict(), indent=1) + "\n")
        tables = [table for table in (result.per_clip(), result.by_axis(), result.summary()) if table]
        print("\n\n".join(t.markdown() if markdown else t.text() for t in tables))
    if publish:
        from mseg.benchmark.publishing import publish as write

        for path in write(result, publish):
            print(f"wrote {path}", file=sys.stderr)
    return int(result.errors.size == len(result.failures))
