"""Segment every clip of a folder with a method and write the predictions.

The output is a submission: 'mseg validate' and 'mseg score' read it. What is there already is kept,
so an interrupted run goes on; a folder that holds predictions of another configuration is refused.
"""

from __future__ import annotations

import argparse
import sys

from mseg.cli.arguments import add_running_flags, positive, progress_bar


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("data", metavar="DATA", help="folder of clips, or one clip")
    parser.add_argument("-o", "--output", required=True, metavar="FOLDER", help="where predictions go")
    parser.add_argument("--method", default="subset", metavar="NAME", help="method (default: subset)")
    parser.add_argument(
        "--n-motions",
        type=positive,
        metavar="N",
        help="number of motions of every clip (default: that of its labels)",
    )
    add_running_flags(parser, seeds_help="number of seeds; several go to seed-0/, seed-1/, ... (default: 1)")


def run(arguments: argparse.Namespace) -> None:
    """Segment."""
    from kt3dmoseg.options import parse_assignments
    from mseg.benchmark import predict
    from mseg.evaluation.layout import count
    from mseg.evaluation.submission import FAILED

    with progress_bar(quiet=arguments.quiet) as progress:
        folder = predict(
            arguments.data,
            arguments.output,
            arguments.method,
            n_motions=arguments.n_motions,
            seeds=arguments.seeds,
            parameters=parse_assignments(arguments.parameter),
            workers=arguments.workers,
            dask=arguments.dask,
            progress=progress,
        )
    failed = {path: path.read_text().strip() for path in sorted(folder.rglob(f"*{FAILED}"))}
    for path, reason in failed.items():
        print(f"failed: {path.relative_to(folder)}: {reason}", file=sys.stderr)
    print(f"wrote {folder}" + (f" ({count(len(failed), 'run')} failed)" if failed else ""))
    print(f"check it: mseg validate {folder} {arguments.data}")
    print(f"score it: mseg score {folder} {arguments.data}")
