"""What imports of other tools' files have in common: frames, sizes, identities, and what was noticed."""

from __future__ import annotations

import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import count, islice, pairwise
from pathlib import PurePosixPath
from typing import Any, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from kt3dmoseg.annotate import model
from kt3dmoseg.annotate.geometry import in_order_of
from kt3dmoseg.annotate.model import (
    MAX_OBJECTS,
    MAX_POINTS,
    Annotation,
    Choices,
    Kind,
    Motion,
    Polygon,
    Visibility,
)
from kt3dmoseg.annotate.propagation import Region
from kt3dmoseg.catalog import format_numbers
from kt3dmoseg.errors import FileFormatError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import SafeZip, ZipLimits, is_hidden
from kt3dmoseg.matching import match_frames
from kt3dmoseg.text import several
from kt3dmoseg.types import FloatArray

Key: TypeAlias = int | str
Regions: TypeAlias = Mapping[int, list[Region]]

_LIMITS = ZipLimits(files=20_000, file_bytes=32 << 20, total_bytes=128 << 20)
_FRAME_NAME = "{:06d}.png"
_DECIMALS = 2
# What all outlines of a file may have together: 20 frames of 100 outlines of 150 corners; and all masks that
# are decoded: 60 frames of 20 boxes of 200x200. An outline counts as 20 corners and 5,000 pixels at least.
_MOST = {"corners": 300_000, "pixels in masks": 50_000_000, "files": _LIMITS.files, "skipped": 20_000}
_MAX_SIDE = 10**9
# Widths and heights are whole numbers: the same picture, scaled, has about the same proportions.
_SAME_SHAPE = 0.01
# A mask may be of a larger picture, by this factor.
_MOST_PIXELS = 16
_BEYOND = 2.0
# Where a file states its size, an outline may go on beyond the border by this share.
_FAR = 0.1
_MOST_SKIPS = 50
_ELLIPSE = 64
_SYNONYMS = {"person": "pedestrian", "people": "pedestrian", "bicycle": "cyclist", "motorbike": "motorcycle"}
OF_TRACKS = ("track_id", "instance_id", "object_id")
_IDENTITIES = (*OF_TRACKS, "object", "instance", "track", "id", "group_id")
# In one frame an object is hidden where a part of it is, and outside where all are.
_RANKS: tuple[Visibility, ...] = ("outside", "visible", "occluded")


class SkippedWarning(KT3DMoSegError, UserWarning):
    """A part of an imported file was skipped; the message says which and why."""


@dataclass
class ForeignObject:
    """What a file shows of one object, as far as it was read; empty fields get a default."""

    name: str = ""
    kind: str = "other"
    motion: Motion | None = None
    note: str = ""
    visibility: dict[int, Visibility] = field(default_factory=dict)
    polygons: dict[int, list[Polygon]] = field(default_factory=dict)
    unread: set[int] = field(default_factory=set)  # frames in which a shape of it was skipped
    of_masks: bool = False  # then the parts of a frame are in the order in which they were found

    def add(self, frame: int, polygons: Iterable[Polygon] = (), visibility: Visibility = "visible") -> None:
        """Add polygons in one frame; what is there already stays."""
        self.visibility[frame] = max(self.visibility.get(frame, "outside"), visibility, key=_RANKS.index)
        self.polygons.setdefault(frame, []).extend(polygons)


@dataclass(frozen=True)
class AnnotationFormat:
    """Another tool's format: ``read(content, into)`` hands an `Import` what a file shows; `write` is `dump`.

    Without names of frames, these are called `frame_name`.
    """

    suffix: str
    media_type: str
    write: Callable[[Annotation, Regions, Sequence[str]], bytes]
    read: Callable[[bytes, Import], None]
    frame_name: str = _FRAME_NAME

    def dump(self, annotation: Annotation, regions: Regions, names: Sequence[str] = ()) -> bytes:
        """Return a file's content: `regions` are the objects' in every frame, as `propagate` gives them.

        `names` are the file names of the clip's frames, by default 000000.png on. InvalidValueError for what
        the format cannot hold.
        """
        return self.write(annotation, regions, names_of(annotation, names, self.frame_name))

    def plan(
        self, content: bytes, like: Annotation, names: Sequence[str] = (), choices: Choices | None = None
    ) -> Import:
        """Return what an import does; see `kt3dmoseg.annotate.formats.plan`."""
        plan = Import(like, names, choices)
        self.read(content, plan)
        plan.finish()
        return plan

    def parse(self, content: bytes, like: Annotation, names: Sequence[str] = ()) -> Annotation:
        """Read a file's content as an annotation of the clip of `like`, whose frames have these names.

        What is doubtful is an InvalidValueError, what is skipped a SkippedWarning; else as `plan`.
        """
        plan = self.plan(content, like, names)
        if plan.doubts:
            raise InvalidValueError("; ".join(plan.doubts))
        if plan.skipped:
            warnings.warn(SkippedWarning(f"skipped: {several(plan.skipped)}"), stacklevel=2)
        return plan.annotation


class Import:
    """A file that is read into an `annotation` of the clip of `like`, whose frames are named `names`.

    A reader hands it what it finds. `notes` say how frames, sizes and identities were found, `skipped` what
    is left out, `doubts` what a person should decide, and `frames` which of the clip the file annotates.
    """

    def __init__(self, like: Annotation, names: Sequence[str] = (), choices: Choices | None = None) -> None:
        self.annotation = self.like = like.emptied()
        self.names, self.choices = names_of(like, names), choices or Choices()
        self.found: dict[Key, ForeignObject] = {}
        self.annotated: set[int] = set()
        self.frames: tuple[int, ...] = ()
        self.notes: list[str] = []
        self.skipped: list[str] = []
        self.doubts: list[str] = []
        # Frame, identity, label, and an object of what is drawn there.
        self._shapes: list[tuple[int, Key | None, str, ForeignObject]] = []
        self._reading: tuple[int, Key] | None = None
        self._unread: defaultdict[str, set[int]] = defaultdict(set)
        self._counts: Counter[str] = Counter()
        self._sized = True

    def lines(self) -> list[str]:
        """Return what the import does as text, one finding a line."""
        objects = self.annotation.objects
        covered = f"{len(self.frames)} of {self.like.n_frames} frames ({_ranges(self.frames)})"
        names = several(item.name for item in objects) or "none"
        return [
            f"{len(objects)} object{'s' * (len(objects) != 1)} drawn in {covered}: {names}",
            *self.notes,
            *(f"skipped: {text}" for text in self.skipped),
            *(f"doubtful: {text}" for text in self.doubts),
        ]

    def note(self, text: str) -> None:
        """Note what the import does, once; an empty text is none."""
        if text and text not in self.notes:
            self.notes.append(text)

    def count(self, what: str, number: int, most: int | None = None) -> None:
        """Count what the file holds; more than a person draws is refused as a whole."""
        self._counts[what] += number
        limit = _MOST[what] if most is None else most
        if self._counts[what] > limit:
            raise KT3DMoSegError("file", expected=f"at most {limit} {what}", found="more", fix="split it")

    @contextmanager
    def skipping(self, where: str) -> Iterator[None]:
        """Skip one shape, and note why, when it is wrong."""
        self._reading = None
        try:
            with model.within(where):
                yield
        except InvalidValueError as error:
            self.skip(str(error))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            ours = isinstance(error, FileFormatError)
            self.skip(f"{where}: {error if ours else repr(error)}"[:200])

    def reading(self, frame: int, label: Key, fields: Mapping[str, Any] | None = None) -> None:
        """Say of what the shape is: an object is not gone from a frame where a shape of it is skipped."""
        key, _ = identity_in(fields or {})
        self._reading = frame, label if key is None else key

    def skip(self, text: str) -> None:
        """Note what is left out and why; of very many, the first."""
        self.count("skipped", 1)
        if self._reading:
            frame, key = self._reading
            self._unread[str(key)].add(frame)
        if len(self.skipped) < _MOST_SKIPS:
            self.skipped.append(text)

    def match(self, files: Iterable[str], what: str) -> dict[str, int]:
        """Find the frame of each file, as `match_frames` does; raises FileFormatError when none has one."""
        given = list(files)
        self.count("files", len(given))
        match = match_frames(given, self.names, clip=self.like.clip, shift=self.choices.shift)
        if given and not match.frames:
            raise FileFormatError(what, expected=match.expected, found=several(given), fix=match.fix)
        if match.doubt:
            self.doubts.append(f"{match.doubt}; {match.fix}")
        elif match.unmatched:
            self.note(f"{len(match.unmatched)} files of frames that are not in the clip are left out")
        if match.others:
            self.note(f"left out: {several(match.others)}, of other clips")
        self.note(match.note)
        return match.frames

    def scale(self, sides: Sequence[Any], where: str) -> tuple[float, float]:
        """Return the factors to the clip's frames from a picture whose sides the file states, or not."""
        width, height = self.like.image_size
        if (chosen := self.choices.scale) is not None:
            self.note(f"coordinates times {chosen:g}")
            return chosen, chosen
        try:
            across, down = (int(side) for side in sides)
        except (TypeError, ValueError, OverflowError):
            across, down = 0, 0
        if not (0 < across < _MAX_SIDE and 0 < down < _MAX_SIDE):
            self._sized, across, down = False, width, height
            self.note(f"the file does not say the size of its pictures; taken as {width}x{height}")
        return self._factors(across, down, where)

    def _factors(self, across: int, down: int, where: str) -> tuple[float, float]:
        width, height = self.like.image_size
        if abs(across * height / (down * width) - 1) > _SAME_SHAPE:
            expected = f"pictures of {width}x{height}, or the same in another scale"
            raise FileFormatError(where, expected=expected, found=f"{across}x{down}")
        if (across, down) != (width, height):
            self.note(f"annotated on pictures of {across}x{down}; scaled to {width}x{height}")
        return width / across, height / down

    def outline(self, points: Iterable[Sequence[float]], scale: tuple[float, float] = (1.0, 1.0)) -> Polygon:
        """Return an outline from the top-left corner as one from the centre of that pixel, scaled."""
        with model.within("points"):  # of more points than may be, a part is as wrong
            given = model.POLYGON.validate_python(list(islice(points, MAX_POINTS + 1)))
        moved = np.round(np.array(given) * scale - 0.5, _DECIMALS)
        self.count("corners", max(20, len(moved)))
        return tuple(map(tuple, moved.tolist()))

    def check_shape(self, height: int, width: int, where: str) -> None:
        """Raise FileFormatError for a mask that is not of the clip's size, nor that in another scale."""
        columns, rows = self.like.image_size
        if not 0 < width * height <= _MOST_PIXELS * columns * rows:
            expected = f"at most {_MOST_PIXELS} times the pixels of {columns}x{rows}"
            raise FileFormatError(where, expected=expected, found=f"{width}x{height}")
        self._factors(width, height, where)

    def fit(self, mask: npt.NDArray[Any], where: str) -> npt.NDArray[Any]:
        """Return a mask of ids (H, W) at the size of the clip's frames; errors as of `check_shape`."""
        height, width = mask.shape
        self.check_shape(height, width, where)
        if self.choices.scale is not None:
            self.note("masks are scaled by their size, not by the factor")
        if mask.shape[::-1] == self.like.image_size:
            return mask
        nearest = cv2.INTER_NEAREST_EXACT
        sized = cv2.resize(mask.astype(np.uint16), self.like.image_size, interpolation=nearest)
        return np.asarray(sized).astype(mask.dtype)

    def unzip(self, content: bytes, suffix: str, what: str) -> Iterator[tuple[int, str, bytes]]:
        """Give frame, name and content of the files of a zip archive with a file per frame."""
        with opened_zip(content, suffix, what) as archive:
            for file, frame in self.match(archive.sizes, what).items():
                yield frame, file, archive.read(file)

    def object(self, key: Key, about: ForeignObject | None = None) -> ForeignObject:
        """Return the object of that key, made like `about` where it is new."""
        if key not in self.found:
            self.count("objects", 1, MAX_OBJECTS)
            self.found[key] = about or ForeignObject()
        return self.found[key]

    def add(
        self,
        frame: int,
        label: str,
        polygons: Iterable[Polygon],
        fields: Mapping[str, Any],
        kind: str | None = None,
        visibility: Visibility = "visible",
    ) -> None:
        """Add a shape; of which object is settled by its fields or label when all shapes are known."""
        key, source = identity_in(fields)
        if key is not None:
            self.note(f"ids come from {source}")
        item = described(label if kind is None else kind, fields)
        item.add(frame, polygons, visibility)
        self._shapes.append((frame, key, label, item))
        self.annotated.add(frame)

    def list_frames(self, listed: Collection[int]) -> None:
        """Take listed frames without a shape as empty; if some lie between others, not all were drawn.

        It is doubtful where most between the others have a shape: those after the last may well be empty.
        """
        drawn = {frame for frame, *_ in self._shapes}.union(*self._unread.values())
        empty = set(listed) - drawn
        between = [k for k in empty if drawn and min(drawn) < k < max(drawn)]
        if between:
            text = f"frames without a shape ({_ranges(empty)}) are taken as not annotated"
            doubtful = len(between) < min(len(empty), len(drawn))
            self.doubts.append(f"{text}: objects stay in them") if doubtful else self.note(text)
        elif empty:
            self.note(f"in frames without a shape ({_ranges(empty)}) no object is seen")
            self.annotated |= empty

    def finish(self) -> None:
        """Make the annotation; raises FileFormatError when there is nothing but what was skipped."""
        self._check_ids()
        self._identify()
        more = self._counts["skipped"]
        if self.skipped and not self.found:
            raise FileFormatError(self.skipped[0] + f" (and {more - 1} more)" * (more > 1))
        self._review()
        for key, item in self.found.items():
            item.unread = self._unread[str(key)]
        if more > _MOST_SKIPS:
            self.skipped.append(f"{more - _MOST_SKIPS} more")
        self.annotation = assemble(self.found, self.like, self.annotated)
        seen = {frame for item in self.found.values() for frame in item.visibility}
        self.frames = tuple(sorted(self.annotated | seen))

    def _identify(self) -> None:
        """Make objects of the shapes; those without an identity are distinguished by their label."""
        unknown = Counter((frame, label) for frame, key, label, _ in self._shapes if key is None)
        alone = len({frame for frame, *_ in self._shapes}) == 1
        if unknown and not alone:
            self.note("no ids: shapes of one label in several frames are one object")
            if twice := [place for place, number in unknown.items() if number > 1]:
                shapes = f"{unknown[twice[0]]} shapes of {twice[0][1]!r}"
                self.doubts.append(
                    f"frame {twice[0][0]} has {shapes} without an id that says which is which; "
                    "they become one object"
                )
        for number, (frame, key, label, shape) in enumerate(self._shapes):
            known = key if key is not None else f"shape {number}" if alone else label
            item = self.object(known, replace(shape, visibility={}, polygons={}))
            item.add(frame, shape.polygons[frame], shape.visibility[frame])
        seen = {key: len(item.visibility) for key, item in self.found.items()}
        if self._shapes and not alone and len(seen) > 1 and max(seen.values()) == 1:
            self.doubts.append("every object is in one frame only; nothing says which belong together")
        if self._shapes and all(isinstance(key, int) for key in self.found):
            self.found = dict(sorted(self.found.items()))

    def _check_ids(self) -> None:
        """Say where several shapes in one frame have one id, and doubt an id of several labels."""
        parts = defaultdict(list)
        for frame, key, label, _ in self._shapes:
            if key is not None:
                parts[frame, key].append(label)
        if parted := [place for place, labels in parts.items() if len(labels) > 1]:
            (frame, key), more = parted[0], f" (and in {len(parted) - 1} more places)" * (len(parted) > 1)
            shapes = f"{len(parts[parted[0]])} shapes of id {key} in frame {frame}{more}"
            self.note(f"{shapes} are parts of one object")
        labels = defaultdict[Key, set[str]](set)
        for (_, key), of_frame in parts.items():
            labels[key].update(of_frame)
        mixed = [key for (_, key), of_frame in parts.items() if len(set(of_frame)) > 1]
        # From frame to frame labels may be numbered.
        mixed += [key for key, names in labels.items() if len(set(map(_unnumbered, names))) > 1]
        if mixed:
            found = several(sorted(labels[mixed[0]]))
            self.doubts.append(f"shapes of several labels have one id, {mixed[0]}: {found}")

    def _review(self) -> None:
        items = self.found.values()
        outlines = [p for item in items for of_frame in item.polygons.values() for p in of_frame]
        corners = np.concatenate([np.array(polygon) for polygon in outlines] or [np.zeros((1, 2))])
        (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
        width, height = self.like.image_size
        if not items:
            self.doubts.append("the file shows no object")
        over = max(-left, -top, right - width, bottom - height)
        if outlines and min(left, top) >= -0.5 and max(right, bottom) <= 0.5:  # the first pixel
            self.doubts.append("all coordinates are 0 to 1; they are taken as pixels, not as shares")
        if over > _BEYOND + (_FAR if self._sized else _SAME_SHAPE) * max(width, height):
            self.doubts.append(
                f"outlines reach from ({left:.0f}, {top:.0f}) to ({right:.0f}, {bottom:.0f}) in pictures of "
                f"{width}x{height}; scale them if they were drawn on others"
            )
        if hidden := sum(v == "occluded" for item in items for v in item.visibility.values()):
            self.note(f"{hidden} outlines are occluded: trajectories in them are not labelled there")


def assemble(
    found: Mapping[Key, ForeignObject], like: Annotation, annotated: Collection[int] | None = None
) -> Annotation:
    """Make the annotation of the objects of a file, by id; when one has none but a name, all are numbered.

    An object without a motion gets one of its own; it is outside in `annotated` frames, by default all, where
    it was not found.
    """
    numbered = all(isinstance(key, int) and 1 <= key <= 10**9 for key in found)
    free = count(max((item.motion for item in found.values() if isinstance(item.motion, int)), default=0) + 1)
    frames = range(like.n_frames) if annotated is None else annotated
    objects = []
    for number, (key, item) in enumerate(found.items(), start=1):
        identity = key if numbered and isinstance(key, int) else number
        word = item.kind.strip()[:480]
        word = "object" if word in ("", "other") else word
        name = item.name.strip()[:500] or f"{word} {identity}"
        motion = next(free) if item.motion is None else item.motion
        keys = _key_frames(item, set(frames) - item.unread)
        kind, note = kind_of(item.kind), item.note[:500]
        objects.append(model.AnnotatedObject(identity, name, kind, motion, keys, note))
    return replace(like, objects=tuple(objects))


def _key_frames(item: ForeignObject, annotated: Collection[int]) -> tuple[model.KeyFrame, ...]:
    """Those frames in which the object is seen, and of the `annotated` ones those from which it is gone.

    Each part of a mask keeps its place in the list from frame to frame.
    """
    seen = item.visibility
    for last, frame in pairwise(sorted(item.polygons) if item.of_masks else ()):
        first, second = item.polygons[last], item.polygons[frame]
        if len(first) == len(second) > 1:
            item.polygons[frame] = in_order_of(first, second)
    keys = [model.KeyFrame(k, visibility, tuple(item.polygons.get(k, ()))) for k, visibility in seen.items()]
    before = True
    for frame in sorted({*annotated, *seen}):
        if before and frame not in seen:
            keys.append(model.KeyFrame(frame, "outside"))
        before = frame in seen
    return tuple(keys)


def described(label: str, fields: Mapping[str, Any]) -> ForeignObject:
    """Make an object of what our exports keep in a shape's fields: name, motion and note."""
    found = {key: str(value) for key, value in fields.items() if value is not None}
    name, motion, note = (found.get(key, "") for key in ("name", "motion", "note"))
    known = motion.isdecimal() and len(motion) <= 4 and int(motion) <= MAX_OBJECTS
    number = model.REJECT if motion == model.REJECT else int(motion) if known else None
    return ForeignObject(name, label, number, note)


def kind_of(label: str) -> Kind:
    """Return the kind that a label of another tool names, with or without a number: ``Car 2``."""
    word = _unnumbered(label)
    word = _SYNONYMS.get(word, word)
    return next((kind for kind in model.KINDS if kind == word), "other")


def _unnumbered(label: str) -> str:
    return label.strip().lower().rstrip("0123456789 _-#.")


def identity_in(values: Mapping[str, Any], names: Sequence[str] = _IDENTITIES) -> tuple[Key | None, str]:
    """Return the identity that a shape's fields or attributes give, and which one gives it."""
    for name in names:
        value = values.get(name)
        if isinstance(value, bool) or value is None or str(value).strip() == "":
            continue
        whole = isinstance(value, float) and value.is_integer()
        text = str(int(value) if whole else value).strip()[:100]
        return (int(text) if text.isdecimal() and len(text) <= 9 else text), name
    return None, ""


def names_of(like: Annotation, names: Sequence[str], pattern: str = _FRAME_NAME) -> list[str]:
    """Return the file names of a clip's frames, by default numbered from 0."""
    return list(names) or [pattern.format(frame) for frame in range(like.n_frames)]


def ellipse(x: float, y: float, rx: float, ry: float, turn: float = 0.0) -> list[list[float]]:
    """Return corners of an ellipse around (x, y), turned by `turn` degrees."""
    angle = np.linspace(0.0, 2 * np.pi, _ELLIPSE, endpoint=False)
    around = (rx * np.cos(angle) + 1j * ry * np.sin(angle)) * np.exp(1j * np.radians(turn))
    points: list[list[float]] = np.stack([x + around.real, y + around.imag], axis=1).tolist()
    return points


def with_corner_origin(polygon: FloatArray) -> list[list[float]]:
    """Move a (P, 2) polygon to the coordinates of other tools, from the corner of the top-left pixel."""
    points: list[list[float]] = np.round(polygon + 0.5, _DECIMALS).tolist()
    return points


def opened_zip(content: bytes, suffix: str, what: str) -> SafeZip:
    """Open a zip archive for its files with that suffix; FileFormatError when there are none."""

    def wanted(name: str) -> bool:
        return PurePosixPath(name).suffix.lower() == suffix and not is_hidden(name)

    archive = SafeZip(content, _LIMITS, what, wanted)
    if not archive.sizes:
        raise FileFormatError(what, expected=f"*{suffix} files", found="none")
    return archive


def unpacked(content: bytes, suffix: str, what: str) -> bytes:
    """Return a file's content, also of the only one with that suffix in a zip, as CVAT offers it."""
    if not content.startswith(b"PK"):
        return content
    with opened_zip(content, suffix, what) as archive:
        if len(archive.sizes) > 1:
            raise FileFormatError(what, expected=f"one *{suffix} file", found=several(archive.sizes))
        return archive.read(*archive.sizes)


def _ranges(frames: Iterable[int]) -> str:
    return several(format_numbers(sorted(frames)).split(",")) or "none"
