"""What the tests of evaluation share."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from mseg.evaluation import SubmissionMeta, write_submission
from mseg.evaluation.example import made_up_clips

CLIPS = made_up_clips()
NAMES = sorted(CLIPS)
META = SubmissionMeta("tested", ("A. Tester",), dataset_version="made up")


def truth(scale: int = 1) -> dict[str, np.ndarray]:
    """The true labels of the made-up clips."""
    return {name: scale * clip.labels.label for name, clip in CLIPS.items()}


def perfect(folder: Path, *, meta: SubmissionMeta = META, seeds: int = 0, format: str = "csv") -> Path:
    """Write a submission that is the truth."""
    runs = {seed: truth() for seed in range(seeds)} if seeds else truth()
    return write_submission(folder, CLIPS.values(), runs, meta, format=format)


def zip_folder(folder: Path, archive: Path, prefix: str = "") -> Path:
    """Zip the content of a folder."""
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as out:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                out.write(path, prefix + path.relative_to(folder).as_posix())
    return archive


def codes(checked) -> list[str]:
    return [problem.code for problem in checked.problems]
