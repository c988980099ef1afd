"""Annotation files that several people or tabs write: a stale copy never overwrites a newer one."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from kt3dmoseg.annotate.document import load_annotation, save_annotation
from kt3dmoseg.annotate.model import Annotation
from kt3dmoseg.errors import KT3DMoSegError
from kt3dmoseg.files import hold_folder


class StaleRevisionError(KT3DMoSegError):
    """The file was saved by somebody else since it was read."""

    def __init__(self, path: Path, current: Annotation, mine: int) -> None:
        super().__init__(
            f"{path}",
            expected=f"revision {mine}",
            found=f"revision {current.revision}",
            fix="read it again and merge the edits",
        )
        self.current = current

    def __reduce__(self) -> tuple[object, ...]:
        """Cross process boundaries intact."""
        return StaleRevisionError, (Path(self.where), self.current, int(self.expected.split()[-1]))


def save_revision(path: str | os.PathLike[str], annotation: Annotation) -> Annotation:
    """Write `annotation` as the next revision of a file, if it was made from the present one.

    Parameters
    ----------
    path : path
        The annotation file; one that does not exist, or no longer, is written whatever the revision.
    annotation : Annotation
        With the revision that it was made from.

    Returns
    -------
    Annotation
        What was written, with its new revision.

    Raises
    ------
    StaleRevisionError
        When the file holds another revision.
    InputFileError, FileFormatError
        When the file cannot be written, or what is there is no annotation.
    """
    target = Path(path)
    with hold_folder(target.parent):
        current = load_annotation(target) if target.exists() else None
        if current is not None and current.revision != annotation.revision:
            raise StaleRevisionError(target, current, annotation.revision)
        saved = replace(annotation, revision=annotation.revision + 1)
        save_annotation(target, saved)
    return saved
