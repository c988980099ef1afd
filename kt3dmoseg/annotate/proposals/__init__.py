"""Proposed regions, for a person to accept, correct or reject.

A proposer is a callable that takes a `Request` and returns either a list of `AnnotatedObject`, or
`Labels` of the request's trajectories (1 = background; the rest becomes regions around the
trajectories of each label). Third parties register theirs in the entry point group
``kt3dmoseg.proposers``; one that returns labels needs nothing of this package but its types.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from kt3dmoseg.annotate.formats import content_of, load
from kt3dmoseg.annotate.formats.foreign import ForeignObject, assemble
from kt3dmoseg.annotate.formats.masks import mask_of, polygons_of
from kt3dmoseg.annotate.geometry import arrays, without_specks
from kt3dmoseg.annotate.model import PROPOSALS, AnnotatedObject, Annotation, Polygon, load_annotation
from kt3dmoseg.annotate.propagation import TrackMotion, propagate
from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.neighbours import groups
from kt3dmoseg.registry import Registry
from kt3dmoseg.types import FloatArray, Labels, Trajectories

PROPOSERS = Registry(
    "proposer",
    {
        "tracklets": "kt3dmoseg.annotate.proposals.tracklets:propose",
        "masks": "kt3dmoseg.annotate.proposals:propose_masks",
        "built": "kt3dmoseg.annotate.proposals:propose_built",
    },
    group="kt3dmoseg.proposers",
)
# Seeds lie 8 pixels apart where there is texture; smooth parts of a car leave gaps of some 30 pixels.
_REACH = 16
_SHRINK = 13
_FEWEST = 8
_EVERY = 4
_OVERLAP = 0.3  # share of a proposal that lies in objects that are there


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
    built : Path or None
        File of proposals that `kt3dmoseg build --propose` wrote.
    """

    clip: str
    annotation: Annotation
    trajectories: Trajectories
    frames: tuple[Path, ...]
    masks: Path | None = None
    kitti: Path | None = None
    built: Path | None = None


def propose(name: str, request: Request) -> list[AnnotatedObject]:
    """Run a proposer of `PROPOSERS`; its objects get ids and motions that the annotation does not use yet.

    What lies in objects of the annotation is left out. The order is the proposer's.

    Raises UnknownNameError, or another KT3DMoSegError with why the proposer cannot work on this clip.
    """
    found = PROPOSERS.load(name)(request)
    if isinstance(found, Labels):
        found = objects_from_labels(request.trajectories, found, request.annotation)
    return request.annotation.with_free_numbers(_new(found, request))


def _new(found: list[AnnotatedObject], request: Request) -> list[AnnotatedObject]:
    """Those of the objects found of which less than `_OVERLAP` lies in regions of the annotation."""
    given, kept = request.annotation, []
    regions = propagate(given, TrackMotion(request.trajectories)).values() if given.objects else ()
    for item in found:
        own = shared = 0
        for key in item.key_frames if regions else ():
            mask = mask_of(arrays(key.polygons), given.image_size)
            there = [polygon for known in regions for polygon in known[key.frame].polygons]
            own, shared = own + mask.sum(), shared + (mask & mask_of(there, given.image_size)).sum()
        if shared <= _OVERLAP * own:
            kept.append(item)
    return kept


def propose_masks(request: Request) -> list[AnnotatedObject]:
    """Read ``<masks>/<clip>/*.png`` (DAVIS or MOTS) or ``<masks>/<clip>.txt`` (MOTS), as an import does."""
    if request.masks is None:
        raise InputFileError("masks", found="no folder of masks", fix="start with masks=FOLDER")
    text = request.masks / f"{request.clip}.txt"
    empty, names = request.annotation.emptied(), [frame.name for frame in request.frames]
    content = content_of(text if text.is_file() else request.masks, request.clip, ".zip")
    if content is None:
        raise InputFileError(f"{request.masks / request.clip}", expected="masks, *.png", found="none")
    if text.is_file():
        return list(load("mots_txt").parse(content, empty, names).objects)
    try:
        return list(load("davis").parse(content, empty, names).objects)
    except FileFormatError as error:
        with suppress(FileFormatError):
            return list(load("mots_png").parse(content, empty, names).objects)
        raise error


def propose_built(request: Request) -> list[AnnotatedObject]:
    """Read what `kt3dmoseg build --propose` wrote, which must be of the request's clip."""
    if request.built is None or not request.built.exists():
        fix = "build the clip with propose=True"
        raise InputFileError(f"{request.built}", expected="proposals", found="no such file", fix=fix)
    found, like = load_annotation(request.built, PROPOSALS), request.annotation
    wanted = {name: getattr(like, name) for name in ("clip", "image_size", "n_frames")}
    return list(found.expect(f"{request.built}: ", **wanted).objects)


def objects_from_labels(
    trajectories: Trajectories, labels: Labels, like: Annotation
) -> list[AnnotatedObject]:
    """Outline the trajectories of every label but 0 and the background, by default 1; in their order.

    What lies apart is outlined by itself: a method may take several movers for one. Key frames are on every
    4th frame and where visibility changes. What has fewer than 8 trajectories in every frame is left out.
    """
    objects: list[AnnotatedObject] = []
    motions = [motion for motion in labels.motions.tolist() if motion != (labels.background or 1)]
    whole = {motion: np.flatnonzero(labels.label == motion) for motion in motions}
    parts = [
        (motion, part) for motion, rows in whole.items() for part in groups(trajectories, rows) or [rows]
    ]
    for motion, rows in parts:
        seen, number = trajectories.visible[rows], len(objects) + 1
        shown = np.pad(seen.sum(axis=0) >= _FEWEST, 1)
        item, last = ForeignObject(labels.names.get(motion, f"proposal {number}"), motion=number), -_EVERY
        for frame in np.flatnonzero(shown[1:-1]).tolist():
            if frame - last >= _EVERY or not shown[frame] or not shown[frame + 2]:  # the padded neighbours
                points = trajectories.xy[rows[seen[:, frame]], frame]
                if polygons := outline(points, like.image_size):
                    item.add(frame, polygons)
                    last = frame
        if item.polygons:
            objects += assemble({number: item}, like, np.flatnonzero(~shown[1:-1]).tolist()).objects
    return objects


def outline(points: FloatArray, image_size: tuple[int, int]) -> list[Polygon]:
    """Outline the union of discs around points, shrunk back: a hull that follows concave shapes."""
    width, height = image_size
    canvas = np.zeros((height + 2 * _REACH, width + 2 * _REACH), dtype=np.uint8)
    for point in np.rint(points).astype(int) + _REACH:
        cv2.circle(canvas, point.tolist(), _REACH, 1, -1)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _SHRINK + 1, 2 * _SHRINK + 1))
    inner = cv2.erode(canvas, disc)[_REACH:-_REACH, _REACH:-_REACH].astype(np.bool_)
    return without_specks(polygons_of(inner, tolerance=1.0))  # of single stray trajectories
