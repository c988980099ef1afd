"""Regions from KITTI's tracklets: 3D boxes of labelled objects, projected into the image."""

from __future__ import annotations

import re
from filecmp import cmp
from pathlib import Path

import cv2
import numpy as np

from kt3dmoseg import catalog
from kt3dmoseg.annotate.formats.foreign import ForeignObject, assemble
from kt3dmoseg.annotate.model import AnnotatedObject, Polygon
from kt3dmoseg.annotate.proposals import Request
from kt3dmoseg.errors import InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.kitti import RawDrive, Tracklet

_NEAR = 0.5
_SMALLEST = 12.0
_FULLY_OCCLUDED = 2
# Metres over the clip that the boxes of a parked object wander by drawing and GPS errors.
_PARKED = 1.0
_RAW = re.compile(
    r"(?P<date>\d{4}_\d\d_\d\d)_drive_(?P<drive>\d{4})_sync/image_0(?P<camera>\d)/data/(?P<number>\d{10})\.\w+$"
)
_KIND_OF = {"person (sitting)": "pedestrian"}


def propose(request: Request) -> list[AnnotatedObject]:
    """Propose the tracklets that move in the world; see `kt3dmoseg.annotate.proposals`."""
    if request.kitti is None:
        raise InputFileError("tracklets", found="no KITTI folder", fix="start with kitti=FOLDER")
    drive, numbers = _drive(request, request.kitti)
    tracklets = drive.tracklets()
    found: dict[int | str, ForeignObject] = {}
    for tracklet, moves in zip(tracklets, _moving(drive, tracklets, numbers), strict=True):
        number, kind = len(found) + 1, tracklet.kind.lower()
        item = ForeignObject(f"{kind} {number}", _KIND_OF.get(kind, kind), number, "from a KITTI tracklet")
        for frame, image in enumerate(numbers):
            polygon = _polygon(drive, tracklet, image) if image in tracklet.numbers else None
            if polygon is not None:
                hidden = int(tracklet.occlusion[tracklet.row(image)]) == _FULLY_OCCLUDED
                item.add(frame, [polygon], "occluded" if hidden else "visible")
        if moves and item.polygons:
            found[number] = item
    return list(assemble(found, request.annotation.emptied()).objects)


def _drive(request: Request, root: Path) -> tuple[RawDrive, tuple[int, ...]]:
    """Find the clip's drive and frame numbers: from where its frames lie, else from the catalog."""
    found = [match for frame in request.frames if (match := _RAW.search(frame.resolve().as_posix()))]
    if found and len(found) == len(request.frames):
        date, drive, camera = found[0].group("date", "drive", "camera")
        numbers = tuple(int(match.group("number")) for match in found)
        return RawDrive(root, date, int(drive), int(camera)), numbers
    listed = catalog.load().get(request.clip)
    if listed is None:
        raise InvalidValueError("tracklets", expected="a clip of the catalog", found=request.clip)
    raw = RawDrive(root, listed.drive.date, listed.drive.number, listed.camera)
    return raw, listed.numbers or _numbers(request.frames, raw)


def _numbers(frames: tuple[Path, ...], drive: RawDrive) -> tuple[int, ...]:
    """Find the clip's frames in the drive by their bytes."""
    out = []
    for frame in frames:
        same = (n for n in drive.numbers.tolist() if cmp(frame, drive.frame_path(n), shallow=False))
        number = next(same, None)
        if number is None:
            raise InvalidValueError(f"{frame}", expected=f"a frame of {drive}", found="none that is equal")
        out.append(number)
    return tuple(out)


def _moving(drive: RawDrive, tracklets: list[Tracklet], numbers: tuple[int, ...]) -> list[bool]:
    """Whether each tracklet moves in the world; all of them when the drive has no poses."""
    try:
        poses = drive.poses(np.array(numbers)) @ np.linalg.inv(drive.T_cam_imu) @ drive.T_cam_velo
    except KT3DMoSegError:
        return [True] * len(tracklets)
    out = []
    for tracklet in tracklets:
        _, k, rows = np.intersect1d(numbers, tracklet.numbers, return_indices=True)
        at = np.einsum("kij,kj->ki", poses[k, :2, :3], tracklet.translation[rows]) + poses[k, :2, 3]
        out.append(bool(len(at)) and float(np.ptp(at, axis=0).max()) > _PARKED)
    return out


def _polygon(drive: RawDrive, tracklet: Tracklet, number: int) -> Polygon | None:
    """Convex hull of the projected corners; the image box where the object reaches behind the camera."""
    corners = tracklet.corners(number) @ drive.T_cam_velo[:3, :3].T + drive.T_cam_velo[:3, 3]
    boxes = drive.tracklet_boxes(number, [tracklet])
    if not boxes:
        return None
    left, top, right, bottom = boxes[0].box
    if min(right - left, bottom - top) < _SMALLEST:
        return None
    points = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    if corners[:, 2].min() > _NEAR:
        pixels = corners @ drive.K.T
        points = np.clip(pixels[:, :2] / pixels[:, 2:], (left, top), (right, bottom))
    hull = cv2.convexHull(points.astype(np.float32))[:, 0].tolist()
    return tuple((x, y) for x, y in hull) if len(hull) >= 3 else None
