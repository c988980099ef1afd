"""What files of other tools have in common: objects put together frame by frame, frames by name or number."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import PurePosixPath

import numpy as np

from kt3dmoseg.annotate.model import (
    KINDS,
    MAX_FRAMES,
    REJECT,
    AnnotatedObject,
    Annotation,
    KeyFrame,
    Kind,
    Motion,
    Polygon,
    Visibility,
    polygon_from,
)
from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.files import SafeZip, ZipLimits
from kt3dmoseg.types import FloatArray

_LIMITS = ZipLimits(files=MAX_FRAMES, file_bytes=32 << 20, total_bytes=128 << 20)
_NUMBER = re.compile(r"(\d{1,9})\D*$")
_DECIMALS = 2


@dataclass
class ForeignObject:
    """What a file shows of one object, as far as it was read; empty fields get a default."""

    name: str = ""
    kind: str = "other"
    motion: Motion | None = None
    note: str = ""
    visibility: dict[int, Visibility] = field(default_factory=dict)
    polygons: dict[int, list[Polygon]] = field(default_factory=dict)

    def add(self, frame: int, polygons: Iterable[Polygon], visibility: Visibility = "visible") -> None:
        """Add polygons in one frame; what is there already stays."""
        self.visibility[frame] = visibility
        self.polygons.setdefault(frame, []).extend(polygons)


def assemble(
    found: Mapping[int | str, ForeignObject], like: Annotation, *, outside_between: bool = True
) -> Annotation:
    """Make the annotation of the objects of a file, by id; when one has none but a name, all are numbered.

    An object without a motion gets one of its own. `outside_between` makes an object outside in the frames
    in which it was not found.
    """
    numbered = all(isinstance(key, int) and key >= 1 for key in found)
    free = count(max((item.motion for item in found.values() if isinstance(item.motion, int)), default=0) + 1)
    objects = []
    for number, (key, item) in enumerate(found.items(), start=1):
        identity = key if numbered and isinstance(key, int) else number
        name = item.name or f"object {identity}"
        kind: Kind = next((kind for kind in KINDS if kind == item.kind), "other")
        motion = next(free) if item.motion is None else item.motion
        keys = _key_frames(item, like.n_frames if outside_between else 0)
        objects.append(AnnotatedObject(identity, name, kind, motion, keys, item.note))
    return replace(like, objects=tuple(objects))


def _key_frames(item: ForeignObject, n_frames: int) -> tuple[KeyFrame, ...]:
    """Those frames in which the object is seen, and of `n_frames` those from which it is gone."""
    seen = item.visibility
    gone = (k for k in range(n_frames) if k not in seen and (k == 0 or k - 1 in seen))
    keys = [KeyFrame(k, visibility, tuple(item.polygons.get(k, ()))) for k, visibility in seen.items()]
    return (*keys, *(KeyFrame(k, "outside") for k in gone))


def motion_from(text: str) -> Motion | None:
    """Read a motion as we write it into other tools' fields; None when it is none."""
    if text == REJECT:
        return REJECT
    return int(text) if text.isdecimal() and len(text) <= 4 else None


def with_corner_origin(polygon: FloatArray) -> list[list[float]]:
    """Move a (P, 2) polygon to the coordinates of CVAT, LabelMe and COCO, to 1/100 pixel.

    There (0, 0) is the corner of the top-left pixel, not its centre.
    """
    points: list[list[float]] = np.round(polygon + 0.5, _DECIMALS).tolist()
    return points


def with_centre_origin(points: Iterable[Sequence[float]], where: str) -> Polygon:
    """Move a polygon of such a tool to our coordinates; InvalidValueError names `where` when it is none."""
    checked = polygon_from(list(points), where)
    return tuple((round(x - 0.5, _DECIMALS), round(y - 0.5, _DECIMALS)) for x, y in checked)


def check_frame(frame: int, like: Annotation, where: str) -> None:
    """Raise FileFormatError for a frame that the clip does not have."""
    if not 0 <= frame < like.n_frames:
        raise FileFormatError(where, expected=f"frames 0 to {like.n_frames - 1}", found=f"frame {frame}")


def check_shape(shape: tuple[int, ...], like: Annotation, where: str) -> None:
    """Raise FileFormatError for a mask of another size than the clip's frames."""
    width, height = like.image_size
    if shape != (height, width):
        raise FileFormatError(where, expected=f"a mask of {width}x{height} pixels", found=f"shape {shape}")


def unzip_frames(
    content: bytes, suffix: str, like: Annotation, names: Sequence[str], what: str
) -> dict[int, bytes]:
    """Return the files of a zip archive by frame, as they are named or numbered; FileFormatError if not."""
    out: dict[int, bytes] = {}
    with _opened(content, suffix, what) as archive:
        files = list(archive.sizes)
        for file, frame in zip(files, frame_indices(files, names, what), strict=True):
            check_frame(frame, like, what)
            if frame in out:
                raise FileFormatError(what, expected="one file per frame", found=f"frame {frame} twice")
            out[frame] = archive.read(file)
    if not out:
        raise FileFormatError(what, expected=f"*{suffix} files, one per frame", found="none")
    return out


def unzip_only(content: bytes, suffix: str, what: str) -> bytes:
    """Return the one file of a zip archive with that suffix; raises FileFormatError."""
    with _opened(content, suffix, what) as archive:
        files = list(archive.sizes)
        if len(files) != 1:
            raise FileFormatError(what, expected=f"one *{suffix} file", found=f"{len(files)}")
        return archive.read(files[0])


def frame_indices(files: Sequence[str], names: Sequence[str], what: str) -> list[int]:
    """Find the frame of each file: by the frames' names when all are named so, else by its last number."""
    stems = [PurePosixPath(file).stem for file in files]
    known = {PurePosixPath(name).stem: k for k, name in enumerate(names)}
    if all(stem in known for stem in stems):
        return [known[stem] for stem in stems]
    numbers = [_NUMBER.search(stem) for stem in stems]
    for stem, number in zip(stems, numbers, strict=True):
        if number is None:
            expected = "names with the frame's number, 00000.png"
            raise FileFormatError(what, expected=expected, found=stem[:80])
    return [int(number.group(1)) for number in numbers if number]


def _opened(content: bytes, suffix: str, what: str) -> SafeZip:
    def wanted(name: str) -> bool:
        path = PurePosixPath(name)  # macOS adds hidden files of its own
        return path.suffix.lower() == suffix and not path.name.startswith(".")

    return SafeZip(content, _LIMITS, what, wanted)
