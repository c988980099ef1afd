"""Proposed regions, for a person to accept, correct or reject.

A proposer is a callable that takes a `Request` and returns either a list of `AnnotatedObject`, or
`Labels` of the request's trajectories (1 = background; the rest becomes regions around the
trajectories of each label). Third parties register theirs in the entry point group
``kt3dmoseg.proposers``; one that returns labels needs nothing of this package but its types.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from kt3dmoseg.annotate.model import BACKGROUND, AnnotatedObject, Annotation, Motion
from kt3dmoseg.annotate.proposals.outlines import objects_from_labels
from kt3dmoseg.registry import Registry
from kt3dmoseg.types import Labels, Trajectories

PROPOSERS = Registry(
    "proposer",
    {
        "residual": "kt3dmoseg.annotate.proposals.residual:propose",
        "tracklets": "kt3dmoseg.annotate.proposals.tracklets:propose",
        "masks": "kt3dmoseg.annotate.proposals.from_masks:propose",
    },
    group="kt3dmoseg.proposers",
)


@dataclass(frozen=True, eq=False)
class Request:
    """What a proposer is told.

    Parameters
    ----------
    clip : str
        Name of the clip.
    annotation : Annotation
        The annotation so far; it also knows frames and image size.
    trajectories : Trajectories
        Of the whole clip.
    frames : tuple of Path
        The clip's frames.
    masks : Path or None
        Folder with masks, one sub-folder or zip file per clip.
    kitti : Path or None
        KITTI raw root.
    """

    clip: str
    annotation: Annotation
    trajectories: Trajectories
    frames: tuple[Path, ...]
    masks: Path | None = None
    kitti: Path | None = None


def propose(name: str, request: Request) -> list[AnnotatedObject]:
    """Ask a proposer for objects.

    Parameters
    ----------
    name : str
        A name in `PROPOSERS`.
    request : Request
        The clip.

    Returns
    -------
    list of AnnotatedObject
        With ids and motion numbers that the annotation does not use yet.

    Raises
    ------
    UnknownNameError
        When there is no such proposer.
    KT3DMoSegError
        When the proposer cannot work on this clip; the message is the reason.
    """
    answer = PROPOSERS.load(name)(request)
    found = objects_from_labels(request.trajectories, answer) if isinstance(answer, Labels) else list(answer)
    return _renumbered(found, request.annotation)


def _renumbered(found: list[AnnotatedObject], annotation: Annotation) -> list[AnnotatedObject]:
    first_id = max((item.id for item in annotation.objects), default=0) + 1
    first_motion = max(annotation.motions, default=0)
    return [
        replace(
            item,
            id=first_id + k,
            motion=_shifted(item.motion, first_motion),
        )
        for k, item in enumerate(found)
    ]


def _shifted(motion: Motion, by: int) -> Motion:
    return motion + by if isinstance(motion, int) and motion != BACKGROUND else motion
