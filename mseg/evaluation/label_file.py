"""The labels of one clip from one file: a prediction file of a submission, or plain text."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.types import Clip, IntArray
from mseg.errors import RejectedSubmissionError
from mseg.evaluation.archive import MAX_FILE_BYTES
from mseg.evaluation.joining import join_labels
from mseg.evaluation.prediction import SUFFIXES, parse_prediction
from mseg.evaluation.problems import numbered

LABEL_FILES = (*SUFFIXES, ".txt")


def read_label_file(path: str | os.PathLike[str], clip: Any) -> IntArray:  # noqa: ANN401  # checked
    """Read predicted labels in the order of ``clip.evaluated``.

    Parameters
    ----------
    path : path
        ``.csv``, ``.npz`` or ``.h5`` with `track` and `label`, or ``.txt`` with one label per line.
    clip : Clip
        The clip that they are for.

    Raises
    ------
    InvalidValueError
        When `clip` is none: ids can only be joined to a clip.
    RejectedSubmissionError
        With every problem of the file.
    FileFormatError, InputFileError
        When a text holds no labels, or labels for another clip; when there is no such file.
    """
    if not isinstance(clip, Clip):
        raise InvalidValueError(
            "truth", expected="a clip or its file, to join ids", found=type(clip).__name__
        )
    file = Path(path)
    if file.suffix.lower() == ".txt":
        from mseg.evaluation.label_vectors import fit_to_clip, read_label_text

        return fit_to_clip(read_label_text(file), clip, f"{file}")
    parsed = parse_prediction(read_bytes(file, MAX_FILE_BYTES), file.name.lower(), clip.name)
    problems = parsed.problems
    if not problems:
        labels, problems = join_labels(parsed.track, parsed.label, clip, file.name)
        if labels is not None:
            return labels
    raise RejectedSubmissionError(f"{file}: {numbered(problems)}")
