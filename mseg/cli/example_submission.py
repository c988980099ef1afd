"""Write a valid submission to start from, or turn label files you already have into one.

Without --from the labels are a simple example: each clip is cut at the median horizontal position.
Without DATA a small made-up dataset is written as well, in OUT-data.
"""

from __future__ import annotations

import argparse

from mseg.cli.arguments import positive
from mseg.evaluation.submission import FORMATS


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "data", nargs="?", metavar="DATA", help="folder of clips; without it, small ones are made up"
    )
    parser.add_argument(
        "-o",
        "--output",
        default="example-submission",
        metavar="FOLDER",
        help="folder to write (default: %(default)s)",
    )
    parser.add_argument(
        "--seeds", type=positive, default=1, metavar="N", help="write N runs, in seed-0, seed-1, ..."
    )
    parser.add_argument("--format", choices=FORMATS, default="csv", help="file format (default: %(default)s)")
    parser.add_argument(
        "--from",
        dest="source",
        metavar="FILES",
        help="label files: .mat with ClusterIdx, or a folder of <clip>.txt, .csv, .mat or .dat",
    )
    parser.add_argument("--method", default="", metavar="NAME", help="name of the method, for meta.toml")
    parser.add_argument("--benchmark", default="", metavar="NAME", help="protocol, for meta.toml")


def run(arguments: argparse.Namespace) -> int:
    """Write it."""
    from mseg.evaluation import example
    from mseg.evaluation.layout import count

    if arguments.source:
        wrote = example.from_label_files(
            arguments.source,
            arguments.data,
            arguments.output,
            method=arguments.method or "unnamed",
            benchmark=arguments.benchmark,
            format=arguments.format,
        )
    else:
        wrote = example.example_submission(
            arguments.data,
            arguments.output,
            seeds=arguments.seeds,
            format=arguments.format,
            method=arguments.method or "example: left and right",
            benchmark=arguments.benchmark,
        )
    print(f"wrote {wrote.folder} ({count(wrote.clips, 'clip')})")
    print(f"check it: mseg validate {wrote.folder} {wrote.data}")
    print(f"score it: mseg score {wrote.folder} {wrote.data}")
    return 0
