"""Reproduce Table 1 of Xu, Cheong and Li (CVPR 2018): all methods and benchmarks, with the printed figures.

Runs all methods x benchmarks x seeds that are not in the cache yet, so it can be stopped and started
again, and writes one Markdown page: error (mean over clips and seeds, and the standard deviation of the
mean over seeds), the published figure, and seconds per sequence. What is missing of a benchmark is listed.

    python tools/reproduce_table1.py --seeds 3 --workers 2 --write table.md

The data are looked for in $KT3DMOSEG_DATA, or else in ../shared/data.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from kt3dmoseg.errors import InputFileError, KT3DMoSegError
from kt3dmoseg.files import write_text
from kt3dmoseg.options import parse_assignments
from kt3dmoseg.text import count
from mseg import methods
from mseg.benchmark import BenchmarkResult, Configuration, run
from mseg.evaluation.results import ResultsTable, published_name

BENCHMARKS = ("hopkins155", "hopkins12", "mtpv62", "kt3dmoseg")
_COMMAND = "python tools/reproduce_table1.py"


def main(argv: Sequence[str] | None = None) -> int:
    arguments = _arguments(argv)
    try:
        configurations = [_configuration(text) for text in arguments.methods or methods.list()]
        tables = [
            table for name in arguments.benchmarks if (table := _reproduce(name, configurations, arguments))
        ]
    except KT3DMoSegError as error:
        print(f"reproduce_table1: {error}", file=sys.stderr)
        return error.exit_code
    page = "\n\n".join([_heading(arguments), *(table.markdown() for table in tables)]) + "\n"
    if arguments.write:
        write_text(arguments.write, page)
    print(page)
    return 0


def comparison(result: BenchmarkResult) -> ResultsTable:
    """Lay out our figures with the published ones, one row per configuration."""
    protocol = result.protocol
    groups = [(g, result.protocol.clips_of(g, result.motions)) for g in protocol.groups]
    present = [(g, [result.clips.index(name) for name in names]) for g, names in groups if names]
    columns = ["method"]
    for group, rows in present:
        columns += [f"{group.title} ({len(rows)} of {group.n_clips})", "published"]
    columns += ["median", "published", "s per sequence", "failed"]
    lines = []
    for m, configuration in enumerate(result.configurations):
        published = protocol.published.get(published_name(protocol, configuration.method), {})
        cells = []
        for group, rows in present:
            cells += [_mean(result.errors[m, rows]), _figure(published.get(group.name, {}), "mean")]
        median = f"{100 * np.median(result.errors[m].mean(axis=1)):.2f}"
        cells += [median, _figure(published.get("all", {}), "median"), f"{np.nanmean(result.seconds[m]):.2f}"]
        failed = {clip for made, clip, *_ in result.failures if made == configuration}
        lines.append([configuration.title, *cells, str(len(failed))])
    seeds = count(len(result.seeds), "seed")
    title = f"{protocol.title}: {protocol.coverage(result.clips)}, {seeds}; error in %"
    return ResultsTable(title, columns, lines, _notes(result))


def _reproduce(
    name: str, configurations: list[Configuration], arguments: argparse.Namespace
) -> ResultsTable | None:
    try:
        result = run(
            name,
            configurations,
            seeds=arguments.seeds,
            workers=arguments.workers,
            dask=arguments.dask,
            cache=arguments.cache,
            progress=lambda done, total, last: print(f"{name} {done}/{total} {last}", file=sys.stderr),
        )
    except InputFileError as error:
        print(f"{name} left out: {error}", file=sys.stderr)
        return None
    return comparison(result)


def _configuration(text: str) -> Configuration:
    """Read ``name`` or ``name:parameter=value,parameter=value``."""
    name, _, parameters = text.partition(":")
    values: dict[str, Any] = dict(parse_assignments(parameters.split(",") if parameters else []))
    return Configuration(name, values)


def _heading(arguments: argparse.Namespace) -> str:
    chosen = f" --methods {' '.join(arguments.methods)}" if arguments.methods else ""
    return (
        "# Table 1 next to the printed one\n\n"
        f"Made by `{_COMMAND} --seeds {arguments.seeds}{chosen} --write ...`. Ours: mean over clips and "
        "seeds ± standard deviation over seeds of the mean over clips; CPU seconds of one core. The "
        "published figures are for the complete benchmarks. A clip on which a method fails counts as fully "
        "wrong."
    )


def _notes(result: BenchmarkResult) -> list[str]:
    reasons: dict[tuple[str, str], list[str]] = {}
    for configuration, clip, _, reason in result.failures:
        clips = reasons.setdefault((configuration.title, reason), [])
        clips += [clip] if clip not in clips else []
    failed = [
        f"{title} failed on {', '.join(clips)}: {reason}." for (title, reason), clips in reasons.items()
    ]
    missing = result.protocol.n_clips - len(result.clips)
    absent = [f"{missing} of {result.protocol.n_clips} sequences are missing{_absent(result)}."]
    minutes = np.nansum(result.seconds) / len(result.seeds) / 60
    cost = (
        f"All methods together: {minutes:.1f} CPU minutes per seed, shared kernels counted for each method."
    )
    return [*(absent if missing else []), *failed, *result.protocol.notes, cost]


def _absent(result: BenchmarkResult) -> str:
    names = [name for name in result.protocol.clips if name not in result.motions]
    return f" ({', '.join(names)})" if names else ""


def _mean(errors: np.ndarray[Any, np.dtype[np.float64]]) -> str:
    per_seed = 100 * errors.mean(axis=0)
    spread = f" ± {per_seed.std(ddof=1):.2f}" if len(per_seed) > 1 else ""
    return f"{per_seed.mean():.2f}{spread}"


def _figure(values: Mapping[str, float], statistic: str) -> str:
    return f"{values[statistic]:.2f}" if statistic in values else "-"


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--benchmarks", nargs="+", default=list(BENCHMARKS), choices=BENCHMARKS)
    parser.add_argument("--methods", nargs="+", metavar="NAME[:PARAMETER=VALUE,...]", help="default: all")
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds, counted from 0")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes on this machine")
    parser.add_argument("--dask", default="", metavar="ADDRESS", help="Dask scheduler, instead of processes")
    parser.add_argument("--cache", default="out/table1", metavar="DIR", help="outcomes; resumes from them")
    parser.add_argument("--write", default="", metavar="FILE", help="Markdown page to write")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())
