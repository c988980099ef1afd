"""Proposed regions, for a person to accept, correct or reject.

A proposer is a callable that takes a `Request` and returns either a list of `AnnotatedObject`, or
`Labels` of the request's trajectories (1 = background; the rest becomes regions around the
trajectories of each label). Third parties register theirs in the entry point group
``kt3dmoseg.proposers``; one that returns labels needs nothing of this package but its types.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from kt3dmoseg.annotate.formats import load
from kt3dmoseg.annotate.formats.masks import polygons_of
from kt3dmoseg.annotate.geometry import area, arrays
from kt3dmoseg.annotate.model import BACKGROUND, REJECT, AnnotatedObject, Annotation, KeyFrame, Polygon
from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import read_bytes, zip_bytes
from kt3dmoseg.matching import is_hidden
from kt3dmoseg.registry import Registry
from kt3dmoseg.types import BoolArray, FloatArray, Labels, Trajectories

PROPOSERS = Registry(
    "proposer",
    {
        "residual": "kt3dmoseg.annotate.proposals.residual:propose",
        "tracklets": "kt3dmoseg.annotate.proposals.tracklets:propose",
        "masks": "kt3dmoseg.annotate.proposals:propose_masks",
    },
    group="kt3dmoseg.proposers",
)
_MAX_FILE = 64 << 20
_MASK_FORMATS = ("davis", "mots_png")
# Seeds lie 8 pixels apart where there is texture; smooth parts of a car leave gaps of some 30 pixels.
_REACH = 16
_SHRINK = 13
_FEWEST = 8
_EVERY = 4


@dataclass(frozen=True, eq=False)
class Request:
    """The input of a proposer.

    Parameters
    ----------
    clip : str
        Name of the clip.
    annotation : Annotation
        The annotation so far; with its frames and image size.
    trajectories : Trajectories
        Of the whole clip.
    frames : tuple of Path
        The clip's frames.
    masks : Path or None
        Folder with masks, one sub-folder or text file per clip.
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
    """Run a proposer of `PROPOSERS`; its objects get ids and motions that the annotation does not use yet.

    Raises UnknownNameError, or another KT3DMoSegError with why the proposer cannot work on this clip.
    """
    answer = PROPOSERS.load(name)(request)
    found = objects_from_labels(request.trajectories, answer) if isinstance(answer, Labels) else list(answer)
    first_id = max((item.id for item in request.annotation.objects), default=0) + 1
    used = max(request.annotation.motions, default=0)
    shifted = [o.motion if o.motion in (BACKGROUND, REJECT) else o.motion + used for o in found]
    return [
        replace(item, id=first_id + k, motion=motion)
        for k, (item, motion) in enumerate(zip(found, shifted, strict=True))
    ]


def propose_masks(request: Request) -> list[AnnotatedObject]:
    """Read ``<masks>/<clip>/*.png`` (DAVIS or MOTS) or ``<masks>/<clip>.txt`` (MOTS), as an import does."""
    if request.masks is None:
        raise InputFileError("masks", found="no folder of masks", fix="start with --masks FOLDER")
    text = request.masks / f"{request.clip}.txt"
    empty, names = request.annotation.emptied(), [frame.name for frame in request.frames]
    if text.is_file():
        return list(load("mots_txt").parse(read_bytes(text, _MAX_FILE), empty, names).objects)
    files = [f for f in sorted((request.masks / request.clip).glob("*.png")) if not is_hidden(f.name)]
    if not files:
        raise InputFileError(f"{request.masks / request.clip}", expected="masks, *.png", found="none")
    content = zip_bytes({file.name: read_bytes(file, _MAX_FILE) for file in files})
    problems = []
    for name in _MASK_FORMATS:
        try:
            return list(load(name).parse(content, empty, names).objects)
        except FileFormatError as error:
            problems.append(error)
    raise problems[0]


def objects_from_labels(trajectories: Trajectories, labels: Labels) -> list[AnnotatedObject]:
    """Outline the trajectories of every label but 0 and the background, by default 1; the largest first.

    Key frames are on every 4th frame and where visibility changes. Labels with fewer than 8 trajectories
    in every frame are left out.
    """
    motions = [int(m) for m in labels.motions if m != (labels.background or 1)]
    motions.sort(key=lambda m: -int((labels.label == m).sum()))
    objects: list[AnnotatedObject] = []
    for motion in motions:
        keys = _key_frames(trajectories, labels.label == motion)
        if any(key.polygons for key in keys):
            number = len(objects) + 1
            name = labels.names.get(motion, f"proposal {number}")
            objects.append(AnnotatedObject(number, name, "other", number, keys))
    return objects


def outline(points: FloatArray, image_size: tuple[int, int]) -> list[Polygon]:
    """Outline the union of discs around points, shrunk back: a hull that follows concave shapes."""
    width, height = image_size
    canvas = np.zeros((height + 2 * _REACH, width + 2 * _REACH), dtype=np.uint8)
    for x, y in np.rint(points).astype(int) + _REACH:
        cv2.circle(canvas, (int(x), int(y)), _REACH, 1, -1)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _SHRINK + 1, 2 * _SHRINK + 1))
    inner = cv2.erode(canvas, disc)[_REACH:-_REACH, _REACH:-_REACH].astype(np.bool_)
    polygons = polygons_of(inner, tolerance=1.0)
    sizes = [abs(area(polygon)) for polygon in arrays(polygons)]
    # Parts smaller than a tenth of the largest are single stray trajectories.
    return [polygon for polygon, size in zip(polygons, sizes, strict=True) if size >= 0.1 * max(sizes)]


def _key_frames(trajectories: Trajectories, rows: BoolArray) -> tuple[KeyFrame, ...]:
    assert trajectories.image_size is not None
    keys: list[KeyFrame] = []
    counts = (trajectories.visible & rows[:, None]).sum(axis=0)
    for frame, count in enumerate(counts):
        if count < _FEWEST:
            if not keys or keys[-1].visibility != "outside":
                keys.append(KeyFrame(frame, "outside"))
            continue
        last = frame + 1 == len(counts) or counts[frame + 1] < _FEWEST
        if not keys or keys[-1].visibility == "outside" or last or frame - keys[-1].frame >= _EVERY:
            points = trajectories.xy[rows & trajectories.visible[:, frame], frame]
            polygons = outline(points, trajectories.image_size)
            if polygons:
                keys.append(KeyFrame(frame, "visible", tuple(polygons)))
    return tuple(keys) or (KeyFrame(0, "outside"),)
