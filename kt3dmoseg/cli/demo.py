"""The whole way on synthetic drives: render, annotate, build, segment, validate, score, report.

Takes about a minute; nothing is downloaded. Every step says which command does it on real
data.
"""

from __future__ import annotations

import argparse


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    from kt3dmoseg.demo import DemoOptions
    from kt3dmoseg.options import add_arguments

    parser.add_argument(
        "-o", "--output", metavar="FOLDER", default="demo-out", help="folder (default: %(default)s)"
    )
    add_arguments(parser, DemoOptions, skip=["methods"])
    usual = " ".join(DemoOptions.methods)
    parser.add_argument(
        "--methods",
        nargs="+",
        metavar="NAME",
        default=argparse.SUPPRESS,
        help=f"names of mseg.methods.list() (default: {usual})",
    )


def run(arguments: argparse.Namespace) -> None:
    """Run the demo and tell its story."""
    from kt3dmoseg.demo import DemoOptions, run_demo
    from kt3dmoseg.options import from_namespace

    if hasattr(arguments, "methods"):  # words, with or without commas
        arguments.methods = " ".join(arguments.methods).replace(",", " ").split()
    run_demo(arguments.output, from_namespace(DemoOptions, arguments), tell=_print)


def _print(line: str) -> None:
    print(line, flush=True)
