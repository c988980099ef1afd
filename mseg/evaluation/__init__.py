"""Submissions, their validation, metrics, statistics and reports.

A submission is a folder or zip of predictions (`mseg.evaluation.submission`); `validate_submission`
lists everything that is wrong with it, `score_submission` scores it, `score` does so for paths and
bare arrays.
"""

import numpy.typing as npt

from mseg.evaluation import codabench, contingency, metrics, results, statistics  # noqa: F401
from mseg.evaluation.comparison import compare
from mseg.evaluation.example import example_submission, read_label_files
from mseg.evaluation.leaderboard import Leaderboard
from mseg.evaluation.protocol import Group, Protocol, list_protocols, load_protocol
from mseg.evaluation.report import write_report
from mseg.evaluation.scoring import ClipScore, ScoreTable, score, score_submission
from mseg.evaluation.submission import (
    Submission,
    SubmissionMeta,
    clip_checksum,
    read_submission,
    write_failure,
    write_meta,
    write_prediction,
    write_submission,
)
from mseg.evaluation.validation import Validation, validate_submission

__all__ = ["ClipScore", "Group", "Leaderboard", "Protocol", "ScoreTable", "Submission", "SubmissionMeta"]
__all__ += ["Validation", "classification_error", "clip_checksum", "compare", "example_submission"]
__all__ += ["list_protocols", "load_protocol", "read_label_files", "read_submission", "score"]
__all__ += ["score_submission", "validate_submission", "write_failure", "write_meta", "write_prediction"]
__all__ += ["write_report", "write_submission"]


def classification_error(truth: npt.ArrayLike, pred: npt.ArrayLike) -> float:
    """Fraction of trajectories that are wrong under the best one-to-one assignment of labels, 0 to 1.

    Of true motions (n,), 0 = unlabelled, not counted at all. Predicted groups (n,) are numbered as they like;
    0 = outlier: always wrong. More groups than motions: those without a motion are wrong; fewer: so are the
    motions without a group. InvalidValueError when a vector holds no labels, the lengths differ, or no
    trajectory is labelled.

    Examples
    --------
    >>> classification_error([1, 1, 1, 2], [7, 7, 3, 3])
    0.25
    """
    return metrics.classification_error(contingency.contingency(truth, pred))
