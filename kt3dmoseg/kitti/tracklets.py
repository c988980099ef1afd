"""KITTI tracklets: 3D boxes of labelled objects, parsed and projected to boxes in the image.

The format is that of KITTI's raw data development kit: per object its size and, from its first frame
on, one pose per frame in laser scanner coordinates (x forward, y left, z up, metres); the pose's
origin is the centre of the box's bottom.
"""

from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import ElementTree

from kt3dmoseg.catalog import format_numbers
from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.types import FloatArray, IntArray

_LARGEST, _MOST_TAGS = 16 << 20, 700_000  # KITTI's have up to some MB; a tag takes 300 bytes of memory
_NEAREST = 0.1
_LAST_FRAME = 10**10 - 1
_FLAGS = ("state", "occlusion", "truncation")
# Corners in units of (length, width, height), and the pairs of them that differ in one coordinate.
_UNIT = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
_EDGES = np.array([(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit])


@dataclass(frozen=True, eq=False)
class Tracklet:
    """One labelled object over consecutive frames.

    Parameters
    ----------
    kind : str
        KITTI's class, for instance ``"Car"``, ``"Cyclist"``, ``"Pedestrian"``.
    size : (3,) float64
        Length, width and height in metres.
    numbers : (n,) int64
        Frame numbers, consecutive.
    translation : (n, 3) float64
        Centre of the bottom of the box in laser scanner coordinates, metres.
    yaw : (n,) float64
        Rotation about the upward axis, radians.
    state, occlusion, truncation : (n,) int64
        KITTI's flags: state 1 interpolated, 2 labelled; occlusion 0 visible, 1 partly, 2 fully,
        -1 unset; truncation 0 in the image, 1 truncated, 2 outside, 99 unset.
    """

    kind: str
    size: FloatArray
    numbers: IntArray
    translation: FloatArray
    yaw: FloatArray
    state: IntArray
    occlusion: IntArray
    truncation: IntArray

    def row(self, number: int) -> int:
        """Return the row of a frame number in the arrays of this tracklet."""
        rows = np.flatnonzero(self.numbers == number)
        if not rows.size:
            expected = f"a frame of this tracklet ({format_numbers(self.numbers) or 'none'})"
            raise InvalidValueError("frame number", expected=expected, found=str(number))
        return int(rows[0])

    def corners(self, number: int) -> FloatArray:
        """Return the box's eight corners in one frame, (8, 3) laser scanner coordinates in metres.

        InvalidValueError when the object is not labelled in that frame.
        """
        row = self.row(number)
        cos, sin = np.cos(self.yaw[row]), np.sin(self.yaw[row])
        rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray((_UNIT * self.size) @ rotation.T + self.translation[row])


@dataclass(frozen=True, eq=False)
class TrackletBox:
    """A tracklet seen in one frame.

    Parameters
    ----------
    index : int
        Position of the tracklet in `RawDrive.tracklets`.
    kind : str
        KITTI's class.
    box : (4,) float64
        Left, top, right, bottom in pixels, clipped to the image.
    depth : float
        Distance of the box's centre along the camera's axis, metres.
    occlusion, truncation : int
        KITTI's flags, as in `Tracklet`.
    """

    index: int
    kind: str
    box: FloatArray
    depth: float
    occlusion: int
    truncation: int


def read_tracklets(path: Path) -> list[Tracklet]:
    """Read a ``tracklet_labels.xml`` of at most 16 MiB; FileFormatError for others and for XML entities."""
    content, expected = read_bytes(path, _LARGEST), "KITTI tracklets"
    if (tags := content.count(b"<")) > _MOST_TAGS:
        raise FileFormatError(f"{path}", expected=f"{expected}, at most {_MOST_TAGS} tags", found=f"{tags}")
    try:
        found = ElementTree.fromstring(content).find("tracklets")  # refuses entities
        if found is None:
            raise ValueError("no <tracklets>")
        return [_tracklet(item) for item in found.findall("item")]
    except (ParseError, ValueError, OverflowError) as error:
        raise FileFormatError(f"{path}", expected=expected, found=str(error)) from None


def project_box(corners: FloatArray, K: FloatArray, size: tuple[int, int]) -> FloatArray | None:
    """Project a 3D box to the upright image box around its visible part.

    `corners` (8, 3) are in camera coordinates, `size` is width and height of the image. The box is left, top,
    right, bottom in pixels, clipped to the image; None when nothing of it is in view. Edges are cut 0.1 m in
    front of the camera, so that boxes next to the car project rightly.
    """
    a, b = corners[_EDGES[:, 0]], corners[_EDGES[:, 1]]
    za, zb = a[:, 2] - _NEAREST, b[:, 2] - _NEAREST
    crossing = (za > 0) != (zb > 0)
    t = (za[crossing] / (za[crossing] - zb[crossing]))[:, None]
    cut = a[crossing] + t * (b[crossing] - a[crossing])
    front = np.concatenate([corners[corners[:, 2] > _NEAREST], cut])
    if not len(front):
        return None
    pixels = front @ K.T
    xy = np.clip(pixels[:, :2] / pixels[:, 2:], -0.5, np.array(size) - 0.5)
    first, last = xy.min(axis=0), xy.max(axis=0)
    return np.concatenate([first, last]) if (last > first).all() else None


def _tracklet(item: Element) -> Tracklet:
    poses = item.findall("./poses/item")
    first = int(_text(item, "first_frame"))
    size = np.array([float(_text(item, key)) for key in ("l", "w", "h")])
    motion = np.array([[float(_text(pose, key)) for key in ("tx", "ty", "tz", "rz")] for pose in poses])
    flags = np.array([[int(_text(pose, key)) for key in _FLAGS] for pose in poses], dtype=np.int64)
    if not 0 <= first <= _LAST_FRAME:
        raise ValueError(f"a tracklet from frame {first} on")
    if not np.isfinite(motion).all():
        raise ValueError("a pose that is not finite")
    if not (np.isfinite(size).all() and (size > 0).all()):
        raise ValueError(f"a box of size {size.tolist()}")
    motion, numbers = motion.reshape(-1, 4), np.arange(first, first + len(poses))
    kind = _text(item, "objectType")
    return Tracklet(kind, size, numbers, motion[:, :3], motion[:, 3], *flags.reshape(-1, 3).T)


def _text(element: Element, key: str) -> str:
    text = (element.findtext(key) or "").strip()
    if not text:
        raise ValueError(f"no <{key}> in a tracklet")
    return text
