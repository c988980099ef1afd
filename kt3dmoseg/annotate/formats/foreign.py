"""What imports of other tools' files have in common: frames, sizes, identities, and what was noticed.

A format's reader hands what it finds to an `Import`, which places it in the clip and notes what it does:
`ImportPlan` says so before anything is replaced.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import count, islice
from math import isfinite
from pathlib import PurePosixPath
from typing import Any, TypeAlias

import numpy as np

from kt3dmoseg.annotate.model import (
    KINDS,
    MAX_FRAMES,
    MAX_OBJECTS,
    MAX_POINTS,
    REJECT,
    AnnotatedObject,
    Annotation,
    KeyFrame,
    Kind,
    Motion,
    Polygon,
    Visibility,
    polygon_from,
    within,
)
from kt3dmoseg.errors import FileFormatError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import SafeZip, ZipLimits
from kt3dmoseg.matching import FrameMatch, is_hidden, match_frames, number_in, several
from kt3dmoseg.types import FloatArray

Key: TypeAlias = int | str
Size: TypeAlias = tuple[int, int]
Reader: TypeAlias = Callable[[bytes, "Import"], None]

_LIMITS = ZipLimits(files=MAX_FRAMES, file_bytes=32 << 20, total_bytes=128 << 20)
_DECIMALS = 2
# Corners that all outlines of a file may have together; 20 frames of 100 outlines of 250 corners.
_MAX_CORNERS = 500_000
# Pixels of all masks that are decoded; 400 frames of 20 boxes of 200x200.
_MAX_PIXELS = 400_000_000
# Widths and heights are whole numbers: the same picture, scaled, has about the same proportions.
_SAME_SHAPE = 0.01
_BEYOND = 2.0
_MOST_SKIPS = 50
_ELLIPSE = 64
_SYNONYMS = {"person": "pedestrian", "people": "pedestrian", "bicycle": "cyclist", "motorbike": "motorcycle"}
_IDENTITIES = ("track_id", "instance_id", "object_id", "object", "instance", "track", "id")


class SkippedWarning(KT3DMoSegError, UserWarning):
    """A part of an imported file was skipped; the message says which and why.

    Where warnings are made errors, it is an error of this package like others.
    """


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


@dataclass(frozen=True)
class Shape:
    """Outlines of an object in a frame; `key` is its identity, None where the file gives only its `label`."""

    frame: int
    key: Key | None
    label: str
    polygons: Sequence[Polygon]
    about: ForeignObject
    visibility: Visibility = "visible"


@dataclass(frozen=True)
class Choices:
    """What a person decides about an import; None = as the file says.

    Parameters
    ----------
    shift : int, optional
        Added to the frame numbers in the file.
    scale : float, optional
        Factor from the file's coordinates to pixels of the clip.
    """

    shift: int | None = None
    scale: float | None = None

    def __post_init__(self) -> None:
        if self.scale is not None and not (isfinite(self.scale) and 0.001 <= self.scale <= 1000):
            raise InvalidValueError("scale", expected="a factor of 0.001 to 1000", found=str(self.scale))
        if self.shift is not None and abs(self.shift) > MAX_FRAMES:
            raise InvalidValueError("shift", expected=f"at most {MAX_FRAMES}", found=str(self.shift))


@dataclass(frozen=True)
class ImportPlan:
    """What an import does.

    Parameters
    ----------
    annotation : Annotation
        The objects of the file, in the clip.
    frames : tuple of int
        Frames of the clip that the file annotates.
    notes, skipped, doubts : tuple of str
        How frames, sizes and identities were found; what is left out; what a person should decide.
    """

    annotation: Annotation
    frames: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    def lines(self) -> list[str]:
        """Return the plan as text, one finding a line."""
        objects = self.annotation.objects
        covered = f"{len(self.frames)} of {self.annotation.n_frames} frames ({_ranges(self.frames)})"
        names = several(item.name for item in objects) or "none"
        return [
            f"{len(objects)} object{'s' * (len(objects) != 1)} drawn in {covered}: {names}",
            *self.notes,
            *(f"skipped: {text}" for text in self.skipped),
            *(f"doubtful: {text}" for text in self.doubts),
        ]


class Import:
    """A file that is being read into an annotation of the clip of `like`, whose frames are named `names`."""

    def __init__(self, like: Annotation, names: Sequence[str] = (), choices: Choices | None = None) -> None:
        self.like, self.choices = like, choices or Choices()
        self.names = list(names) or [f"{k:06d}.png" for k in range(like.n_frames)]
        self.found: dict[Key, ForeignObject] = {}
        self.shapes: list[Shape] = []
        self.annotated: set[int] = set()
        self.notes: list[str] = []
        self.skipped: list[str] = []
        self.doubts: list[str] = []
        self.skips, self._corners, self._pixels, self._sized = 0, 0, 0, True

    def note(self, text: str) -> None:
        """Note what the import does, once."""
        if text not in self.notes:
            self.notes.append(text)

    @contextmanager
    def skipping(self, where: str) -> Iterator[None]:
        """Skip one shape, and note why, when it is wrong."""
        try:
            with within(where):
                yield
        except TooMuchError:
            raise
        except InvalidValueError as error:
            self.skip(str(error))
        except FileFormatError as error:
            self.skip(f"{where}: {error}")
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            self.skip(f"{where}: {type(error).__name__} {error}"[:160])

    def skip(self, text: str) -> None:
        """Note what is left out and why; of very many, the first."""
        self.skips += 1
        if self.skips <= _MOST_SKIPS:
            self.skipped.append(text)

    def match(self, files: Iterable[str], what: str) -> dict[str, int]:
        """Find the frame of each file, as `match_frames` does; raises FileFormatError when none has one."""
        given = list(files)
        match = match_frames(given, self.names, clip=self.like.clip, shift=self.choices.shift)
        if given and not match.frames:
            expected = f"names or numbers of the frames, {self.names[0]} to {self.names[-1]}"
            fix = f"shift the numbers{_proposed(match, self.names)}"
            raise FileFormatError(what, expected=expected, found=several(given), fix=fix)
        if doubt := match.doubt(self.like.n_frames):
            self.doubts.append(f"{doubt}{_proposed(match, self.names)}")
        elif match.unmatched:
            self.note(f"{len(match.unmatched)} files of frames that are not in the clip are left out")
        if match.others:
            self.note(f"left out: {several(match.others)}, of other clips")
        if match.note:
            self.note(match.note)
        return match.frames

    def scale(self, size: Size | None, where: str) -> tuple[float, float]:
        """Return the factors from a picture of `size` (None: unknown) to the clip's frames, and note them.

        Raises FileFormatError when it has other proportions.
        """
        width, height = self.like.image_size
        if (chosen := self.choices.scale) is not None:
            self.note(f"coordinates times {chosen:g}")
            return chosen, chosen
        if size is None:
            self._sized = False
            return 1.0, 1.0
        if size == (width, height):
            return 1.0, 1.0
        expected = f"pictures of {width}x{height}, or the same in another scale"
        if min(size) < 1 or abs(size[0] * height / (size[1] * width) - 1) > _SAME_SHAPE:
            raise FileFormatError(where, expected=expected, found=f"{size[0]}x{size[1]}")
        self.note(f"annotated on pictures of {size[0]}x{size[1]}; scaled to {width}x{height}")
        return width / size[0], height / size[1]

    def outline(
        self,
        points: Iterable[Sequence[float]],
        scale: tuple[float, float] = (1.0, 1.0),
        where: str = "points",
    ) -> Polygon:
        """Return an outline from the top-left corner as one from the centre of that pixel, scaled."""
        given = list(islice(points, MAX_POINTS + 1))  # of more, a first part is as wrong
        checked = polygon_from(given, where)
        return self.counted(
            tuple((_rounded(x * scale[0] - 0.5), _rounded(y * scale[1] - 0.5)) for x, y in checked)
        )

    def counted(self, polygon: Polygon) -> Polygon:
        """Return a polygon; raises FileFormatError when all together have too many corners."""
        self._corners += len(polygon)
        if self._corners > _MAX_CORNERS:
            raise TooMuchError("corners", _MAX_CORNERS)
        return polygon

    def count_pixels(self, size: int) -> None:
        """Count the pixels of a mask; raises FileFormatError when all together are too many."""
        self._pixels += size
        if self._pixels > _MAX_PIXELS:
            raise TooMuchError("pixels in masks", _MAX_PIXELS)

    def add(self, shape: Shape) -> None:
        """Add a shape whose identity is settled when all are known."""
        self.shapes.append(shape)
        self.annotated.add(shape.frame)

    def object(self, key: Key, about: ForeignObject | None = None) -> ForeignObject:
        """Return the object of that key, made like `about` where it is new."""
        if key not in self.found and len(self.found) >= MAX_OBJECTS:
            raise TooMuchError("objects", MAX_OBJECTS)
        return self.found.setdefault(key, about or ForeignObject())

    def list_frames(self, listed: Collection[int]) -> None:
        """Settle which of the frames that a file lists are annotated.

        Those without a shape show no object, unless there are such between others: then not every frame
        was drawn.
        """
        drawn = {shape.frame for shape in self.shapes}
        empty = set(listed) - drawn
        between = [k for k in empty if drawn and min(drawn) < k < max(drawn)]
        if between:
            self.note(f"frames without a shape ({_ranges(between)}) are taken as not annotated")
        elif empty:
            self.note(f"in frames without a shape ({_ranges(empty)}) no object is seen")
        self.annotated |= set() if between else empty

    def plan(self) -> ImportPlan:
        """Return what the import does; raises FileFormatError when there is nothing but what was skipped."""
        self._identify()
        if self.skipped and not self.found:
            more = f" (and {self.skips - 1} more)" if self.skips > 1 else ""
            raise FileFormatError(self.skipped[0] + more)
        self._review()
        if self.skips > _MOST_SKIPS:
            self.skipped.append(f"{self.skips - _MOST_SKIPS} more")
        annotation = assemble(self.found, self.like, self.annotated)
        seen = {frame for item in self.found.values() for frame in item.visibility}
        frames = tuple(sorted(self.annotated | seen))
        return ImportPlan(
            annotation, frames, tuple(self.notes), tuple(self.skipped), tuple(dict.fromkeys(self.doubts))
        )

    def _identify(self) -> None:
        """Make objects of the shapes; those without an identity are distinguished by their label."""
        unknown = [shape for shape in self.shapes if shape.key is None]
        alone = len({shape.frame for shape in self.shapes}) == 1
        counts: dict[tuple[int, str], int] = {}
        for shape in unknown:
            place = shape.frame, shape.label
            counts[place] = counts.get(place, 0) + 1
        if unknown and not alone:
            self.note("no ids: shapes of one label in several frames are one object")
        twice = [place for place, number in counts.items() if number > 1]
        if twice and not alone:
            (frame, label), number = twice[0], counts[twice[0]]
            self.doubts.append(
                f"frame {frame} has {number} shapes of {label!r} without an id that says which is which; "
                "they become one object"
            )
        for number, shape in enumerate(self.shapes):
            key: Key = shape.key if shape.key is not None else shape.label
            if shape.key is None and alone:
                key = f"shape {number}"
            item = self.object(key, shape.about)
            hidden = "occluded" in (shape.visibility, item.visibility.get(shape.frame))
            item.add(shape.frame, shape.polygons, "occluded" if hidden else "visible")
        if self.shapes and all(isinstance(key, int) for key in self.found):
            self.found = dict(sorted(self.found.items()))

    def _review(self) -> None:
        outlines = [
            p for item in self.found.values() for of_frame in item.polygons.values() for p in of_frame
        ]
        if not outlines:
            return
        corners = np.concatenate([np.array(polygon) for polygon in outlines])
        (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
        width, height = self.like.image_size
        over = max(-left, -top, right - width, bottom - height)
        if not self._sized and over > _BEYOND + _SAME_SHAPE * max(width, height):
            self.doubts.append(
                f"outlines reach from ({left:.0f}, {top:.0f}) to ({right:.0f}, {bottom:.0f}) in pictures of "
                f"{width}x{height}, and the file does not say their size; scale them"
            )
        hidden = [k for item in self.found.values() for k, v in item.visibility.items() if v == "occluded"]
        if hidden:
            self.note(f"{len(hidden)} outlines are occluded: trajectories in them are not labelled there")


class TooMuchError(FileFormatError):
    """A file holds more than a person draws; it is refused as a whole."""

    def __init__(self, what: str, most: int) -> None:
        super().__init__("file", expected=f"at most {most} {what}", found="more")


def strict(read: Reader) -> Callable[..., Annotation]:
    """Make the `parse` of a format: a doubt is an InvalidValueError, what is skipped a SkippedWarning."""

    def parse(content: bytes, like: Annotation, names: Sequence[str] = ()) -> Annotation:
        plan = plan_of(read, content, like, names)
        if plan.doubts:
            raise InvalidValueError("; ".join(plan.doubts))
        if plan.skipped:
            warnings.warn(SkippedWarning(f"skipped: {several(plan.skipped)}"), stacklevel=2)
        return plan.annotation

    return parse


def plan_of(
    read: Reader, content: bytes, like: Annotation, names: Sequence[str], choices: Choices | None = None
) -> ImportPlan:
    """Return what an import with this reader does."""
    importing = Import(like.emptied(), names, choices)
    read(content, importing)
    return importing.plan()


def assemble(
    found: Mapping[Key, ForeignObject], like: Annotation, annotated: Collection[int] | None = None
) -> Annotation:
    """Make the annotation of the objects of a file, by id; when one has none but a name, all are numbered.

    An object without a motion gets one of its own. In the frames that are `annotated`, by default all, an
    object that was not found is outside.
    """
    numbered = all(isinstance(key, int) and 1 <= key <= 10**9 for key in found)
    free = count(max((item.motion for item in found.values() if isinstance(item.motion, int)), default=0) + 1)
    frames = range(like.n_frames) if annotated is None else annotated
    objects = []
    for number, (key, item) in enumerate(found.items(), start=1):
        identity = key if numbered and isinstance(key, int) else number
        name = item.name.strip()[:500] or f"object {identity}"
        motion = next(free) if item.motion is None else item.motion
        keys = _key_frames(item, frames)
        objects.append(AnnotatedObject(identity, name, kind_of(item.kind), motion, keys, item.note[:500]))
    return replace(like, objects=tuple(objects))


def _key_frames(item: ForeignObject, annotated: Collection[int]) -> tuple[KeyFrame, ...]:
    """Those frames in which the object is seen, and of the `annotated` ones those from which it is gone."""
    seen = item.visibility
    keys = [KeyFrame(k, visibility, tuple(item.polygons.get(k, ()))) for k, visibility in seen.items()]
    before = True
    for frame in sorted({*annotated, *seen}):
        if before and frame not in seen:
            keys.append(KeyFrame(frame, "outside"))
        before = frame in seen
    return tuple(keys)


def kind_of(label: str) -> Kind:
    """Return the kind that a label of another tool names, with or without a number: ``Car 2``."""
    word = label.strip().lower().rstrip("0123456789 _-#.")
    word = _SYNONYMS.get(word, word)
    return next((kind for kind in KINDS if kind == word), "other")


def motion_from(text: str) -> Motion | None:
    """Read a motion as we write it into other tools' fields; None when it is none."""
    if text == REJECT:
        return REJECT
    return int(text) if text.isdecimal() and len(text) <= 4 and int(text) <= MAX_OBJECTS else None


def identity_in(values: Mapping[str, Any], names: Sequence[str] = _IDENTITIES) -> tuple[Key | None, str]:
    """Return the identity that a shape's fields or attributes give, and which one gives it."""
    for name in names:
        value = values.get(name)
        if isinstance(value, bool) or value is None or str(value).strip() == "":
            continue
        text = str(value).strip()[:100]
        return (int(text) if text.isdecimal() and len(text) <= 9 else text), name
    return None, ""


def ellipse(x: float, y: float, rx: float, ry: float, turn: float = 0.0) -> list[tuple[float, float]]:
    """Return corners of an ellipse around (x, y), turned by `turn` degrees."""
    angle = np.linspace(0.0, 2 * np.pi, _ELLIPSE, endpoint=False)
    cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    across, down = rx * np.cos(angle), ry * np.sin(angle)
    points = np.stack([x + across * cos - down * sin, y + across * sin + down * cos], axis=1)
    return [(float(a), float(b)) for a, b in points]


def with_corner_origin(polygon: FloatArray) -> list[list[float]]:
    """Move a (P, 2) polygon to the coordinates of CVAT, LabelMe and COCO, to 1/100 pixel.

    There (0, 0) is the corner of the top-left pixel, not its centre.
    """
    points: list[list[float]] = np.round(polygon + 0.5, _DECIMALS).tolist()
    return points


def check_shape(shape: tuple[int, ...], like: Annotation, where: str) -> None:
    """Raise FileFormatError for a mask of another size than the clip's frames."""
    width, height = like.image_size
    if shape != (height, width):
        found = "x".join(str(side) for side in reversed(shape))
        raise FileFormatError(where, expected=f"a mask of {width}x{height} pixels", found=found)


def unzip_frames(content: bytes, suffix: str, into: Import, what: str) -> Iterator[tuple[int, str, bytes]]:
    """Give frame, name and content of the files of a zip archive; FileFormatError when there are none."""
    with _opened(content, suffix, what) as archive:
        files = list(archive.sizes)
        if not files:
            raise FileFormatError(what, expected=f"*{suffix} files, one per frame", found="none")
        for file, frame in into.match(files, what).items():
            yield frame, file, archive.read(file)


def unzip_only(content: bytes, suffix: str, what: str) -> bytes:
    """Return the one file of a zip archive with that suffix; raises FileFormatError."""
    with _opened(content, suffix, what) as archive:
        files = list(archive.sizes)
        if len(files) != 1:
            raise FileFormatError(what, expected=f"one *{suffix} file", found=several(files) or "none")
        return archive.read(files[0])


def _opened(content: bytes, suffix: str, what: str) -> SafeZip:
    def wanted(name: str) -> bool:
        return PurePosixPath(name).suffix.lower() == suffix and not is_hidden(name)

    return SafeZip(content, _LIMITS, what, wanted)


def _rounded(value: float) -> float:
    return round(value, _DECIMALS)


def _ranges(frames: Iterable[int]) -> str:
    """Write frames as ranges.

    >>> _ranges([0, 1, 2, 7])
    '0-2, 7'
    """
    runs: list[list[int]] = []
    for frame in sorted(frames):
        if runs and runs[-1][1] == frame - 1:
            runs[-1][1] = frame
        else:
            runs.append([frame, frame])
    return several(f"{a}-{b}" if b > a else f"{a}" for a, b in runs) or "none"


def _proposed(match: FrameMatch, names: Sequence[str]) -> str:
    """Name the shift with which the first file would be of the first frame."""
    numbers = [n for file in (*match.frames, *match.unmatched) if (n := number_in(file)) is not None]
    first = number_in(names[0])
    if not numbers or first is None or first == min(numbers):
        return ""
    return f"; a shift of {first - min(numbers)} would begin with the first frame"
