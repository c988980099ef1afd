"""Write one self-contained HTML page about a submission, which opens offline.

With --frames the trajectories are drawn on the pictures (FRAMES/<clip>/000001.png, ...). The table
is also written beside the page where asked for.
"""

from __future__ import annotations

import argparse
import sys

from mseg.cli.arguments import add_force_flag, add_submission

_EXTRAS = {
    "latex": "also write the table as .tex",
    "markdown": "also write the table as .md",
    "csv": "also write .csv, global_results-*.csv and per-sequence_results-*.csv",
    "json": "also write all scores as .json",
}


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_submission(parser)
    parser.add_argument(
        "-o", "--output", default="report.html", metavar="FILE", help="the page (default: %(default)s)"
    )
    parser.add_argument("--frames", metavar="FOLDER", help="pictures, one sub-folder per clip")
    add_force_flag(parser)
    for name, text in _EXTRAS.items():
        parser.add_argument(f"--{name}", action="store_true", help=text)


def run(arguments: argparse.Namespace) -> int:
    """Write the report."""
    from mseg.evaluation.report import write_report

    wrote = write_report(
        arguments.submission,
        arguments.data,
        arguments.output,
        frames=arguments.frames,
        benchmark=arguments.benchmark,
        force=arguments.force,
        extras=[name for name in _EXTRAS if getattr(arguments, name)],
    )
    for path in wrote:
        size = path.stat().st_size / 1000
        shown = f"{size:.1f} kB" if size < 1000 else f"{size / 1000:.1f} MB"
        print(f"wrote {path} ({shown})", file=sys.stderr)
    return 0
