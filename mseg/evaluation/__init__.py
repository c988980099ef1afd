"""Submissions, their validation, metrics, statistics and reports.

A submission is a folder or zip of predictions (`mseg.evaluation.submission`); `validate_submission`
lists everything that is wrong with it, `score_submission` scores it, `score` does so for paths and
bare arrays.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy.typing as npt

from kt3dmoseg.registry import lazy

if TYPE_CHECKING:
    from mseg.evaluation.comparison import compare as compare
    from mseg.evaluation.example import example_submission as example_submission
    from mseg.evaluation.example import read_label_files as read_label_files
    from mseg.evaluation.leaderboard import Leaderboard as Leaderboard
    from mseg.evaluation.protocol import Group as Group
    from mseg.evaluation.protocol import Protocol as Protocol
    from mseg.evaluation.protocol import list_protocols as list_protocols
    from mseg.evaluation.protocol import load_protocol as load_protocol
    from mseg.evaluation.report import write_report as write_report
    from mseg.evaluation.scoring import ClipScore as ClipScore
    from mseg.evaluation.scoring import ScoreTable as ScoreTable
    from mseg.evaluation.scoring import score as score
    from mseg.evaluation.scoring import score_submission as score_submission
    from mseg.evaluation.submission import Submission as Submission
    from mseg.evaluation.submission import SubmissionMeta as SubmissionMeta
    from mseg.evaluation.submission import clip_checksum as clip_checksum
    from mseg.evaluation.submission import fingerprint as fingerprint
    from mseg.evaluation.submission import read_submission as read_submission
    from mseg.evaluation.submission import write_failure as write_failure
    from mseg.evaluation.submission import write_meta as write_meta
    from mseg.evaluation.submission import write_prediction as write_prediction
    from mseg.evaluation.submission import write_submission as write_submission
    from mseg.evaluation.validation import Validation as Validation
    from mseg.evaluation.validation import validate_submission as validate_submission

# Public names by the module that has them, which is imported on first use: scoring needs a few of them.
_MODULES = {
    "comparison": "compare",
    "example": "example_submission read_label_files",
    "leaderboard": "Leaderboard",
    "protocol": "Group Protocol list_protocols load_protocol",
    "report": "write_report",
    "scoring": "ClipScore ScoreTable score score_submission",
    "submission": "Submission SubmissionMeta clip_checksum fingerprint read_submission"
    " write_failure write_meta write_prediction write_submission",
    "validation": "Validation validate_submission",
}
_PUBLIC = {name: module for module, names in _MODULES.items() for name in names.split()}

_OTHERS = ("codabench", "contingency", "metrics", "results", "statistics")

__all__ = [*_PUBLIC, "classification_error"]  # noqa: PLE0604

if not TYPE_CHECKING:  # a checker refuses names that do not exist
    __getattr__, __dir__ = lazy(__name__, _PUBLIC, {name: name for name in (*_MODULES, *_OTHERS)})


def classification_error(truth: npt.ArrayLike, pred: npt.ArrayLike) -> float:
    """Fraction of trajectories that are wrong under the best one-to-one assignment of labels.

    Parameters
    ----------
    truth : (n,) int
        True motions; 0 = unlabelled, not counted at all.
    pred : (n,) int
        Predicted groups, numbered as they like. 0 = outlier: always wrong. More groups than
        motions: those without a motion are wrong; fewer: so are the motions without a group.

    Returns
    -------
    float
        0 (perfect, up to numbering) to 1.

    Raises
    ------
    InvalidValueError
        When a vector holds no labels, the lengths differ, or no trajectory is labelled.

    Examples
    --------
    >>> classification_error([1, 1, 1, 2], [7, 7, 3, 3])
    0.25
    """
    from mseg.evaluation import contingency, metrics

    return metrics.classification_error(contingency.contingency(truth, pred))
