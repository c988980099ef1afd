"""The scoring program of a Codabench competition: the same validator and scorer, its file layout."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from kt3dmoseg.errors import KT3DMoSegError
from kt3dmoseg.files import write_text
from mseg.evaluation.metrics import all_metrics
from mseg.evaluation.report import report_html
from mseg.evaluation.scoring import score_validated
from mseg.evaluation.validation import validate_submission


def main(arguments: Sequence[str], *, benchmark: str = "") -> int:
    """Score ``INPUT/res`` against ``INPUT/ref`` and write ``OUTPUT/scores.json`` and the report.

    The arguments are INPUT and OUTPUT, on Codabench ``/app/input`` and ``/app/output``. Returns 0; 1 when
    the submission is rejected, with every problem on standard error; 2 when the folders are not as they
    should be.
    """
    if len(arguments) != 2:
        print("usage: score.py INPUT OUTPUT", file=sys.stderr)
        return 2
    source, target = Path(arguments[0]), Path(arguments[1])
    try:
        checked = validate_submission(source / "res", source / "ref", benchmark=benchmark)
        print(checked, file=sys.stderr)
        if not checked.scorable:
            return 1
        scores = score_validated(checked)
        columns = {name: scores[name] * metric.scale for name, metric in all_metrics().items()}
        columns |= {"error_median": 100 * scores.summary().median, "failed": float(len(scores.failures))}
        write_text(target / "scores.json", json.dumps(columns) + "\n")
        write_text(target / "detailed_results.html", report_html([checked], [scores], overlays=False))
    except KT3DMoSegError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return 0
