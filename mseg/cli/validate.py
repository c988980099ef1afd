"""Say everything that is wrong with a submission, numbered, with how to fix it.

Exit code 0: valid; 1: invalid; 2: wrong usage (no such file, no data).
"""

from __future__ import annotations

import argparse
import json

from mseg.cli.arguments import add_submission


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_submission(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Validate."""
    from mseg.evaluation.validate import validate_submission

    found = validate_submission(arguments.submission, arguments.data, benchmark=arguments.benchmark)
    print(json.dumps(found.as_dict(), indent=2) if arguments.json else str(found))
    return 0 if found.ok else 1
