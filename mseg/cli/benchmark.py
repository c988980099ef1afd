"""Run methods on every clip of a benchmark that is found, over several seeds, and print the tables.

Outcomes are kept in a folder (--cache), so that a re-run, or one with more methods or seeds, runs
only what is new. What is missing of the benchmark is said; the published rows are for all of it.
"""

from __future__ import annotations

import argparse

from mseg.cli.arguments import add_running_flags, progress_bar

_PAPER = ("affine", "homography", "fundamental", "keradd", "coreg", "subset")
_STDOUT = "-"
_CACHE = "out/benchmark"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "benchmark", metavar="BENCHMARK", help="protocol: kt3dmoseg, hopkins155, hopkins12 or mtpv62"
    )
    parser.add_argument(
        "--methods", nargs="+", default=list(_PAPER), metavar="NAME",
        help=f"methods (default: {' '.join(_PAPER)})",
    )  # fmt: skip
    parser.add_argument(
        "--data", nargs="+", default=[], metavar="FOLDER",
        help="folders of clips (default: the protocol's folder in $KT3DMOSEG_DATA or ../shared/data)",
    )  # fmt: skip
    parser.add_argument("--cache", default=_CACHE, metavar="FOLDER", help=f"outcomes (default: {_CACHE})")
    parser.add_argument("--no-cache", action="store_true", help="run everything, keep nothing")
    parser.add_argument(
        "--kernels", metavar="FOLDER", help="keep kernels there, for sweeps over alpha or fusion"
    )
    parser.add_argument(
        "--json",
        nargs="?",
        const=_STDOUT,
        metavar="FILE",
        help="everything as JSON: written to FILE beside the tables, or printed in their place",
    )
    parser.add_argument("--markdown", action="store_true", help="print Markdown tables")
    add_running_flags(parser, seeds_help="number of seeds, counted from 0 (default: 1)")


def run(arguments: argparse.Namespace) -> None:
    """Benchmark."""
    from kt3dmoseg.options import parse_assignments
    from mseg.benchmark import run as run_benchmark

    with progress_bar(quiet=arguments.quiet) as progress:
        result = run_benchmark(
            arguments.benchmark,
            arguments.methods,
            data=arguments.data,
            seeds=arguments.seeds,
            parameters=parse_assignments(arguments.parameter),
            workers=arguments.workers,
            dask=arguments.dask,
            cache=None if arguments.no_cache else arguments.cache,
            kernels=arguments.kernels,
            progress=progress,
        )
    if arguments.json:
        import json

        from kt3dmoseg.files import write_text

        everything = json.dumps(result.as_dict(), indent=1)
        if arguments.json == _STDOUT:
            print(everything)
            return
        write_text(arguments.json, everything + "\n")
    tables = [result.per_clip(), result.summary()]
    print("\n\n".join(t.markdown() if arguments.markdown else t.text() for t in tables))
