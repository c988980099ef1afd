"""Keep scored submissions in a small SQLite file and rank them per benchmark.

A partial submission, or one with failed clips, is listed below the complete ones, without a rank.
Scores on different data are never ranked together.
"""

from __future__ import annotations

import argparse

from mseg.cli.arguments import add_benchmark_flag

_ACTIONS = ("add", "list", "rank", "export")


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="{" + ",".join(_ACTIONS) + "}")
    add = actions.add_parser("add", help="score a submission and keep the scores")
    add.add_argument(
        "submission", metavar="SUBMISSION", help="folder or zip, or a file written by 'mseg score --json'"
    )
    add.add_argument("data", nargs="?", metavar="DATA", help="folder of clips with labels")
    add_benchmark_flag(add)
    listing = actions.add_parser("list", help="everything that is kept, oldest first")
    rank = actions.add_parser("rank", help="ranked, per benchmark and data")
    export = actions.add_parser("export", help="ranked, as a page or Markdown")
    export.add_argument("-o", "--output", required=True, metavar="FILE", help="ends in .html or .md")
    for each in (rank, export):
        each.add_argument("--benchmark", default="", metavar="NAME", help="only this one")
    for each in (add, listing, rank, export):
        each.add_argument(
            "--db",
            default="leaderboard.sqlite",
            metavar="FILE",
            help="the leaderboard (default: %(default)s)",
        )


def run(arguments: argparse.Namespace) -> int:
    """Do what was asked."""
    from mseg.evaluation.leaderboard import Leaderboard

    if arguments.action == "add":
        print(_add(arguments))
        return 0
    board = Leaderboard(arguments.db, create=False)
    if arguments.action == "list":
        print(board.listing().text())
    elif arguments.action == "rank":
        print("\n\n".join(table.text() for table in board.ranked(arguments.benchmark)))
    else:
        from mseg.evaluation.leaderboard.export import export

        export(board, arguments.output, benchmark=arguments.benchmark)
        print(f"wrote {arguments.output}")
    return 0


def _add(arguments: argparse.Namespace) -> str:
    from kt3dmoseg.errors import InvalidValueError
    from mseg.evaluation.jsonform import load_scores
    from mseg.evaluation.leaderboard import Leaderboard
    from mseg.evaluation.scoring import score_submission

    if arguments.submission.endswith(".json") and arguments.data is None:
        scores = load_scores(arguments.submission)
    elif arguments.data is None:
        raise InvalidValueError(
            "data", expected="a folder of clips", found="nothing", fix="give it after the submission"
        )
    else:
        scores = score_submission(arguments.submission, arguments.data, benchmark=arguments.benchmark)
    number, new = Leaderboard(arguments.db, create=True).add(scores)
    state = "complete" if scores.complete else f"{scores.benchmark.coverage(scores.names)}"
    return f"{'added' if new else 'already there'}: entry {number}, {scores.meta.method}, {state}"
