"""Compare submissions: a table and paired statistics, and whether the seed noise explains it.

Each of A B ... is a submission, or a file written by 'mseg score --json'. For submissions, the
data come last: mseg compare A B DATA (or --data DATA).
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING

from kt3dmoseg.errors import InvalidValueError
from mseg.cli.arguments import add_benchmark_flag

if TYPE_CHECKING:
    from mseg.evaluation.comparison import Comparison
    from mseg.evaluation.results import ScoreTable


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "submissions", nargs="+", metavar="A", help="submissions or score files, then the data"
    )
    parser.add_argument(
        "--data", metavar="DATA", help="folder of clips with labels; by default the last argument"
    )
    add_benchmark_flag(parser)
    parser.add_argument("--metric", default="error", help="what to compare by (default: error)")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Compare."""
    from mseg.evaluation.comparison import compare

    names, data = list(arguments.submissions), arguments.data
    if data is None and not all(map(_is_scores, names)):
        data = names.pop()
        if _is_scores(data):
            raise InvalidValueError(
                data, expected="the data (a folder of clips)", found="scores", fix="give the data last"
            )
    found = compare(_tables(names, data, arguments.benchmark), metric=arguments.metric)
    print(json.dumps(_as_dict(found), indent=2) if arguments.json else _text(found))
    return 0


def _is_scores(name: str) -> bool:
    return name.endswith(".json")


def _tables(names: list[str], data: str | None, benchmark: str) -> list[ScoreTable]:
    from mseg.evaluation.jsonform import load_scores
    from mseg.evaluation.scoring import score_submission
    from mseg.evaluation.validate import load_clips

    if data is not None and (Path(data) / "meta.toml").exists():
        raise InvalidValueError(
            data, expected="the data (a folder of clips)", found="a submission", fix="give the data last"
        )
    clips = load_clips(data) if data is not None else {}
    return [
        load_scores(name) if _is_scores(name) else score_submission(name, clips, benchmark=benchmark)
        for name in names
    ]


def _text(found: Comparison) -> str:
    from mseg.evaluation.comparison import comparison_table, pairs_table

    sentences = "\n".join(f"- {pair.sentence}" for pair in found.pairs)
    return "\n\n".join([comparison_table(found).text(), pairs_table(found).text(), sentences])


def _as_dict(found: Comparison) -> dict[str, object]:
    return {
        "metric": found.metric,
        "means": {
            n: float(t.per_clip(found.metric).mean()) for n, t in zip(found.names, found.tables, strict=True)
        },
        "pairs": [dataclasses.asdict(pair) for pair in found.pairs],
    }
