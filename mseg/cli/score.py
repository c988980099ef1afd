"""Score a submission: the headline table, every clip, every metric.

A missing clip, or one on which the method failed, counts as fully wrong and is listed. A submission
with other problems is rejected with all of them (exit code 1); --force scores it all the same.
"""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING

from mseg.cli.arguments import add_force_flag, add_submission

if TYPE_CHECKING:
    from mseg.evaluation.results import ScoreTable


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_submission(parser)
    add_force_flag(parser)
    parser.add_argument("-o", "--output", metavar="FILE", help="write there instead of printing")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="everything, as JSON ('mseg compare' reads it)")
    form.add_argument("--csv", action="store_true", help="one row per clip, as CSV")
    form.add_argument("--markdown", action="store_true", help="the headline table in Markdown")
    form.add_argument("--latex", action="store_true", help="the headline table in LaTeX")


def run(arguments: argparse.Namespace) -> int:
    """Score."""
    from mseg.evaluation.scoring import score_validated
    from mseg.evaluation.validate import validate_submission

    checked = validate_submission(arguments.submission, arguments.data, benchmark=arguments.benchmark)
    if not checked.ok:
        print(checked, file=sys.stderr)
        if not checked.scorable and not (arguments.force and checked.clips):
            print("rejected: repair it, or score it as it is with --force", file=sys.stderr)
            return 1
    content = _render(score_validated(checked, force=arguments.force), arguments)
    if arguments.output:
        from kt3dmoseg.files import write_text

        write_text(arguments.output, content + "\n")
    else:
        print(content)
    return 0


def _render(scores: ScoreTable, arguments: argparse.Namespace) -> str:
    from mseg.evaluation import tables

    if arguments.json:
        from mseg.evaluation.jsonform import to_json

        return json.dumps(to_json(scores), indent=1)
    if arguments.csv:
        return tables.per_clip(scores, scores.metrics).csv().rstrip()
    if arguments.markdown:
        return tables.headline(scores).markdown()
    if arguments.latex:
        return tables.headline(scores).latex()
    parts = [tables.headline(scores), tables.per_clip(scores), tables.all_means(scores)]
    return "\n\n".join(part.text() for part in parts)
