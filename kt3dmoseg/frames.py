"""Where the frames of clips are: folders of pictures, videos and KITTI raw drives.

`find_sources` lists what to build, `frames_of` reads the frames of a clip, `find_clips` lists what to label.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import PathLike, listed, sha256_arrays, sha256_file, sha256_files, write_text
from kt3dmoseg.io import dataset_paths, images, load
from kt3dmoseg.io.fields import check_name, clip_name
from kt3dmoseg.io.formats import CLIP_SUFFIXES
from kt3dmoseg.io.images import Colour, frame_number, frame_paths, has_pictures, is_clip, read_frames
from kt3dmoseg.text import several
from kt3dmoseg.types import ByteArray, Camera, Clip, FloatArray

# What KITTI's drives need is imported where there are any.
if TYPE_CHECKING:
    from kt3dmoseg.kitti import RawDrive

_DRIVE_FOLDERS = "????_??_??/*_drive_????_sync"
_DRIVE = re.compile(r"(\d{4}_\d\d_\d\d)_drive_(\d{4})")
_EVEN = 1.5  # a video whose frames are further apart than this many times the least has a variable rate
_DAY_OR_DRIVE = re.compile(r"\d{4}_\d\d_\d\d(_drive_\d{4}_sync)?")


@dataclass(frozen=True)
class FrameInfo:
    """What is known of a clip before its frames are decoded.

    The `description` states where they come from, with the sha256 of everything they are decoded from, and no
    path of this machine. `timestamps` (F,) are in seconds.
    """

    description: dict[str, Any]
    timestamps: FloatArray | None = None
    camera: Camera | None = None
    names: Sequence[str] = ()  # of the files of the frames, where each has one
    notes: tuple[str, ...] = ()  # what a person should know of them


@dataclass(frozen=True)
class Cut:
    """Which frames of a source are taken, by number, both ends included, and at which size they are read."""

    first: int | None = None
    last: int | None = None
    step: int = 1
    size: tuple[int, int] | None = None  # width, height
    name: str = ""

    def title(self, name: str) -> str:
        """Name the clip: as given, else by its source and the range."""
        whole = self.first is None and self.last is None
        ends = (f"{end:06d}" if end is not None else "" for end in (self.first, self.last))
        return self.name or (name if whole else f"{name}_{'-'.join(ends)}")

    def of(self, numbers: Sequence[int], where: str) -> Sequence[int]:
        """Return the numbers that are taken; InvalidValueError when they are fewer than two or not there."""
        if len(numbers) < 2:
            raise InvalidValueError(where, expected="at least two frames", found=f"{len(numbers)}")
        first = numbers[0] if self.first is None else self.first
        last = numbers[-1] if self.last is None else self.last
        if not numbers[0] <= first < last <= numbers[-1] or last - first < self.step:
            expected, found = f"at least two frames of {numbers[0]}-{numbers[-1]}", f"{first}-{last}"
            found += f" in steps of {self.step}" * (self.step > 1)
            raise InvalidValueError(f"{where}: range", expected=expected, found=found)
        return range(first, last + 1, self.step)

    def resized(self, frames: Iterator[ByteArray]) -> Iterator[ByteArray]:
        """Give the frames at the wanted size; pixels are averaged where it is smaller."""
        return frames if self.size is None else (images.resized(frame, self.size) for frame in frames)

    def describe(self) -> dict[str, Any]:
        """State under ``cut`` what differs from taking all, as JSON values; nothing where nothing does."""
        given = vars(self) | {"size": self.size and [*self.size], "name": ""}
        cut = {key: value for key, value in given.items() if value != getattr(Cut, key)}
        return {"cut": cut} if cut else {}


_ALL = Cut()
_WHOLE: dict[str, Any] = {"frames": "", "step": 1, "size": "", "catalogs": ()}


class FrameSource(Protocol):
    """A clip's frames. Making one reads nothing, so that a bad clip fails when it is built.

    Those that `take` can take a part of are dataclasses with a field `cut`.
    """

    @property
    def name(self) -> str:
        """Name of the clip."""

    @property
    def where(self) -> str:
        """What messages call the source."""

    def inspect(self) -> FrameInfo:
        """Check and describe the source without decoding frames."""

    def numbers(self) -> Sequence[int]:
        """Numbers of the frames."""

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        """Yield gray frames, all of one size; "stored" gives those that are in colour as RGB."""


@dataclass(frozen=True)
class FrameFolder(FrameSource):
    """A folder of numbered pictures; the clip has the folder's name."""

    folder: Path
    cut: Cut = _ALL

    @property
    def name(self) -> str:
        folder = self.folder.absolute()  # a link has its own name, not its target's
        return self.cut.title((folder.resolve() if folder.name == ".." else folder).name)

    @property
    def where(self) -> str:
        return f"{self.folder}"

    def inspect(self) -> FrameInfo:
        paths = self.paths()
        ends = {"first": paths[0].name, "last": paths[-1].name, "count": len(paths)}
        description = {"kind": "frames", **ends, "sha256": sha256_files(paths)} | self.cut.describe()
        return FrameInfo(description, names=[path.name for path in paths])

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        return self.cut.resized(read_frames(self.paths(), colour))

    def numbers(self) -> Sequence[int]:
        return [frame_number(path) for path in self.paths()]

    def paths(self) -> list[Path]:
        """List the files of the frames."""
        paths = images.numbered_pictures(self.folder)
        if self.cut.first is None or len(paths) < 2:  # of a part, there may be gaps elsewhere
            frame_paths(self.folder)
        numbers = self.cut.of(list(paths), self.where)
        if lacking := [number for number in numbers if number not in paths]:
            found, fix = f"no frame {several(lacking)}", "add the missing frames, or take a part without them"
            raise InputFileError(
                self.where, expected=f"frames {numbers[0]}-{numbers[-1]}", found=found, fix=fix
            )
        return [paths[number] for number in numbers]


@dataclass(frozen=True)
class VideoFile(FrameSource):
    """A video, decoded frame by frame, its frames numbered from 0; always taken as luma."""

    file: Path
    cut: Cut = _ALL

    @property
    def name(self) -> str:
        return self.cut.title(self.file.stem)

    @property
    def where(self) -> str:
        return f"{self.file}"

    def inspect(self) -> FrameInfo:
        description = {"kind": "video", "file": self.file.name, "sha256": sha256_file(self.file)}
        times, turned = images.video_facts(self.file)
        numbers, gaps = self.cut.of(range(len(times)), self.where), 1000 * np.diff(times)
        notes = [f"turned upright by {turned} degrees, as the file states"] * bool(turned)
        if gaps.max() > _EVEN * gaps.min():  # two frames at least
            notes += [f"frames are {gaps.min():.0f} to {gaps.max():.0f} ms apart; their times are kept"]
        described = description | self.cut.describe()
        return FrameInfo(described, times[np.array(numbers)], notes=tuple(notes))

    def paths(self) -> list[Path]:
        """List the file."""
        return [self.file]

    def numbers(self) -> Sequence[int]:
        """Numbers of the frames; the video is decoded to count them."""
        return self.cut.of(range(len(images.video_facts(self.file)[0])), self.where)

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        """Yield the luma of every frame that is taken, or its colours."""
        wanted: Colour = "luma" if colour == "refuse" else colour  # a video is in colour by nature
        first, last = self.cut.first or 0, self.cut.last
        pictures = images.read_video(self.file, first, self.cut.step, None if last is None else last + 1)
        return self.cut.resized(images.gray(picture, f"{self.file}", wanted) for picture in pictures)


@dataclass(frozen=True)
class KittiClip(FrameSource):
    """Frames of a KITTI raw drive, by number; all that are on disk unless a range is given."""

    drive: RawDrive
    cut: Cut = _ALL
    gaps: str = ""  # the numbers of a clip that skips some, which cannot be built

    @property
    def name(self) -> str:
        return self.cut.title(self.drive.drive.name)

    @property
    def where(self) -> str:
        return f"{self.drive.root}: {self.drive.drive.name}"

    def inspect(self) -> FrameInfo:
        """Check that the frames are there, hash them, and read their times and the calibration."""
        drive, numbers = self.drive, self.numbers()
        paths = self.paths()
        description = {"kind": "kitti", "drive": drive.drive.name, "camera": drive.camera}
        description |= {"first": numbers[0], "last": numbers[-1], "sha256": sha256_files(paths)}
        description |= replace(self.cut, first=None, last=None).describe()
        times = drive.timestamps(numbers)
        (width, height), calibrated = images.picture_size(paths[0]), drive.image_size
        if calibrated != (width, height):
            where = f"{drive.folder}: calibration of camera {drive.camera}"
            expected, found = f"{width}x{height} px, as the frames", "{}x{}".format(*calibrated)
            fix = "it is of another day, or the frames were resized or cropped"
            raise FileFormatError(where, expected=expected, found=found, fix=fix)
        scale = np.diag((*(np.array(self.cut.size or calibrated) / calibrated), 1.0))
        half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # pixels count from the centre of the first
        K = drive.K if self.cut.size is None else np.linalg.inv(half) @ scale @ half @ drive.K
        description |= {"K": K.tolist(), "timestamps_sha256": sha256_arrays(times)}
        camera, names = Camera(f"image_{drive.camera:02d}", K), [path.name for path in paths]
        return FrameInfo(description, times, camera, names)

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        """Yield gray frames; of the colour cameras 2 and 3 their luma."""
        wanted: Colour = "luma" if self.drive.camera > 1 and colour == "refuse" else colour
        return self.cut.resized(read_frames(self.paths(), wanted))

    def paths(self) -> list[Path]:
        """List the files of the frames."""
        return [self.drive.frame_path(number) for number in self.numbers()]

    def numbers(self) -> Sequence[int]:
        """Numbers of the frames, of a range also those that are not on disk."""
        if self.gaps:
            where = f"{self.where}: {self.name}"
            raise FileFormatError(where, expected="consecutive frames", found=self.gaps)
        present = self.drive.numbers.tolist() or [0]
        ends = [present[0] if self.cut.first is None else self.cut.first]
        ends.append(present[-1] if self.cut.last is None else self.cut.last)
        # What of the range is not on disk is named by the drive.
        return self.cut.of(range(min(ends[0], present[0]), max(ends[1], present[-1]) + 1), self.where)


def find_sources(path: PathLike) -> list[FrameSource]:
    """List the clips at a path, sorted by name.

    It is a folder of frames, a video, a KITTI raw root (the clips of its ``located.toml``, else one per
    drive), or a folder of any of the first two. InputFileError when there is nothing of the kind, pictures
    lie next to folders of frames, or a link leads nowhere; FileFormatError when ``located.toml`` is no
    catalog.
    """
    root = Path(path)
    if root.is_file():
        return [VideoFile(root)]
    if not root.is_dir():
        raise InputFileError(f"{root}", expected="frames, a video or a KITTI raw root", found="no such path")
    found: list[FrameSource]
    if any(root.glob(_DRIVE_FOLDERS)):
        found = located_sources(root) or kitti_sources(root)
    elif is_clip(root):
        found = [FrameFolder(root)]
    else:
        _check_level(root)
        inside = listed(root)
        found = [FrameFolder(path) for path in inside if path.is_dir()]
        found += [VideoFile(path) for path in inside if path.suffix.lower() in images.VIDEO_SUFFIXES]
        if not found:
            expected = "numbered frames, or one folder of frames per clip"
            what = f"{inside[0].name}, no pictures" if inside else "an empty folder"
            fix = "give the folder that holds them"
            raise InputFileError(f"{root}", expected=expected, found=what, fix=fix)
    return sorted(found, key=lambda source: source.name)


def one_source(path: PathLike, **part: Any) -> FrameSource:  # noqa: ANN401
    """Return the only clip at a path; InvalidValueError when there are more, see `choose_sources`."""
    found = choose_sources(path, **part)
    if len(found) != 1:
        names, fix = several(source.name for source in found), "give one of them"
        raise InvalidValueError(f"{path}", expected="one clip", found=f"{len(found)}: {names}", fix=fix)
    return found[0]


def source_names(sources: Sequence[FrameSource]) -> list[str]:
    """Return the clips' names, each of which becomes that of a file; refuse bad ones, and two of one name."""
    names = [source.name for source in sources]
    for name, source in zip(names, sources, strict=True):
        check_name(name, f"name of {source.where!a}")
        if names.count(name) > 1:
            both = " and ".join(source.where for source in sources if source.name == name)
            fix = "rename or remove one"
            raise InvalidValueError(f"clip {name}", expected="one source", found=both, fix=fix)
    return names


def choose_sources(
    path: PathLike,
    *,
    catalogs: Sequence[PathLike] = (),
    date: str | None = None,
    drive: str | int | None = None,
    camera: int = 0,
    drives: bool = False,
    **part: Any,  # noqa: ANN401
) -> list[FrameSource]:
    """List the clips that a command is to work on.

    Those of `catalogs` in a KITTI raw root, its drives when one or all are asked for, else those that
    `find_sources` finds; `part` are keywords of `take`. Errors are those of the functions named.
    """
    whole = drives or part.get("frames") or part.get("name")
    if catalogs:
        if date or drive or camera:
            fix = "a catalog states the drive and camera of its clips"
            raise InvalidValueError("catalogs", expected="no date, drive or camera", found="both", fix=fix)
        found = located_sources(path, catalogs)
    elif date or drive or camera or (whole and any(Path(path).glob(_DRIVE_FOLDERS))):
        found = kitti_sources(path, date=date, drive=drive, camera=camera)
    else:
        found = find_sources(path)
    return take(found, **part)


def _check_level(folder: Path) -> None:
    """Refuse a folder that is next to a KITTI raw root: its day or drive, or the folder that it lies in."""
    inner = _DAY_OR_DRIVE.fullmatch(folder.resolve().name) is not None
    near = folder.resolve().parents[:2] if inner else folder.iterdir()
    root = next((path for path in near if any(path.glob(_DRIVE_FOLDERS))), None)
    if root is not None:
        found = "a folder inside of one" if inner else "the folder that it lies in"
        raise InputFileError(f"{folder}", expected="a KITTI raw root", found=found, fix=f"give {root}")


def located_sources(root: PathLike, catalogs: Sequence[PathLike] = ()) -> list[FrameSource]:
    """List the clips of ``ROOT/located.toml``, as `pull` and `locate` write it, that are on disk.

    With `catalogs` those of these files, which must all be on disk, else InputFileError is raised. A
    FileFormatError is raised when a file is no catalog; of a clip that skips frames, when it is read.
    """
    from kt3dmoseg import catalog
    from kt3dmoseg.kitti import RawDrive
    from kt3dmoseg.kitti.raw import LOCATED

    path = Path(root) / LOCATED
    files = [Path(file) for file in catalogs] or [path] * path.is_file()
    found: list[FrameSource] = []
    for clip in catalog.load(*files, built_in=False).values():
        numbers = clip.numbers or ()
        try:
            drive = RawDrive(root, clip.drive.date, clip.drive.number, clip.camera)
            if not catalogs and not np.isin(numbers, drive.numbers).any():
                continue
        except InputFileError:  # nothing of that drive or camera
            if catalogs:
                raise
            continue
        whole, listing = numbers[-1] - numbers[0] + 1 == len(numbers), catalog.format_numbers(numbers)
        gaps = "" if whole else f"{listing} in {files[0].name}"
        found.append(KittiClip(drive, Cut(numbers[0], numbers[-1], name=clip.name), gaps))
    return found


def kitti_sources(
    root: PathLike,
    *,
    date: str | None = None,
    drive: str | int | None = None,
    camera: int = 0,
    frames: str | tuple[int, int] | None = None,
    name: str = "",
) -> list[FrameSource]:
    """List the drives under a KITTI raw root as clips: of one day or number, if given, of `camera` 0 to 3.

    `frames` and `name` are as in `take`. InputFileError when no drive fits.
    """
    from kt3dmoseg.kitti import Drive, RawDrive

    wanted = None if drive is None else Drive(date or "2011_09_26", drive).number  # type: ignore[arg-type]  # it converts
    names = (folder.name.removesuffix("_sync") for folder in sorted(Path(root).glob(_DRIVE_FOLDERS)))
    matches = map(_DRIVE.fullmatch, names)
    pairs = [(match[1], int(match[2])) for match in matches if match]
    pairs = [pair for pair in pairs if date in (None, pair[0]) and wanted in (None, pair[1])]
    if not pairs:
        asked = " ".join(str(part) for part in (date, drive) if part is not None)
        expected = f"a KITTI raw root with drive {asked}".rstrip()
        fix = "fetch it with kt3dmoseg pull, or give the folder that holds the day's folder"
        raise InputFileError(f"{root}", expected=expected, found="no such drive", fix=fix)
    return take([KittiClip(RawDrive(root, *pair, camera)) for pair in pairs], frames=frames, name=name)


def take(
    sources: Sequence[FrameSource],
    *,
    frames: str | tuple[int, int] | None = None,
    step: int = 1,
    size: str | tuple[int, int] | None = None,
    name: str = "",
) -> list[FrameSource]:
    """Take a part of each source: a range, every `step`-th frame, at another size, under another name.

    `frames` is (first, last) or "first-last", frame numbers, both included, a video's from 0; `size` (width,
    height) or "WIDTHxHEIGHT". By default the name is the source's with the range. InvalidValueError when a
    range or size is malformed, or a range or name is given for several sources.
    """
    first, last = _pair(frames, "range", "-", "FIRST-LAST, as 45-64") or (None, None)
    wanted = _pair(size, "size", "x", "WIDTHxHEIGHT, as 640x192")
    if step < 1 or (wanted and min(wanted) < 1):
        raise InvalidValueError("step and size", expected="at least 1", found=f"{step}, {wanted}")
    if wanted and wanted[0] * wanted[1] > images.MAX_PIXELS:
        expected, found = f"at most {images.MAX_PIXELS} pixels", "{}x{}".format(*wanted)
        raise InvalidValueError("size", expected=expected, found=found)
    if len(sources) > 1 and (frames or name):
        found, fix = f"{len(sources)}", "give the frames of one, or date=DATE and drive=NUMBER"
        raise InvalidValueError("range and name", expected="one source", found=found, fix=fix)
    if first is None and step == 1 and wanted is None and not name:
        return list(sources)
    given: dict[str, Any] = {"step": step, "size": wanted}
    given |= {} if first is None else {"first": first, "last": last}
    given |= {"name": name} if name else {}
    parts: Any = sources  # of dataclasses with a cut
    return [replace(source, cut=replace(source.cut, **given)) for source in parts]


def part_of(source: FrameSource, info: FrameInfo, first: int, last: int) -> dict[str, Any]:
    """Describe the frames from one number to another, of a source with a cut; no video is read again."""
    given: Any = source
    part = replace(given, cut=replace(given.cut, first=first, last=last))
    if isinstance(part, VideoFile):
        return info.description | part.cut.describe()
    return dict(part.inspect().description)


def _pair(text: str | tuple[int, int] | None, what: str, between: str, form: str) -> tuple[int, int] | None:
    if not isinstance(text, str):
        return text
    match = re.fullmatch(rf"(\d{{1,9}}){between}(\d{{1,9}})", text)
    if not match and text:
        raise InvalidValueError(what, expected=form, found=repr(text))
    return (int(match[1]), int(match[2])) if match else None


def frame_folder(clip: Clip, root: PathLike) -> Path | None:
    """Find the folder of a clip's frames below `root`: ``ROOT/CLIP``, or its camera of a KITTI drive."""
    below, source = [Path(root, clip.name)], recorded_source(clip.provenance, "kitti")
    drive = _DRIVE.fullmatch(str(source.get("drive")))
    if drive and source.get("camera") in (0, 1, 2, 3):
        from kt3dmoseg.kitti import Drive

        below.append(Path(root, Drive(drive[1], int(drive[2])).camera_folder(source["camera"]), "data"))
    return next((folder for folder in below if folder.is_dir()), None)


def frames_of(clip: Clip, root: PathLike) -> list[ByteArray]:
    """Read the frames of a clip, (H, W) uint8 each: as many as it has, and of its size.

    `frame_folder` finds them below `root`, or `root` is their folder or video. Of pictures in colour the luma
    is taken, of a KITTI drive the frames of the clip's numbers. Those of another clip are refused where the
    clip records what it was made from.
    """
    source = _source_of(clip, frame_folder(clip, root) or Path(root))
    frames = list(source.frames("luma"))
    found, width, height = len(frames), *reversed(frames[0].shape if frames else (0, 0))
    if found != clip.n_frames:
        expected = f"the {clip.n_frames} frames of {clip.name}"
        raise InputFileError(source.where, expected=expected, found=f"{found}")
    if (size := clip.dense.image_size) not in (None, (width, height)):
        expected = "frames of {}x{} px, as in {}".format(*size, clip.name)
        raise InputFileError(source.where, expected=expected, found=f"{width}x{height}")
    check_frames(clip.provenance, clip.name, source.paths())
    return frames


def _source_of(clip: Clip, path: Path) -> FrameFolder | VideoFile:
    """Return a video or folder as the source of a clip, cut as the clip was built or tracked."""
    recorded, numbers = recorded_source(clip.provenance), clip.frame_numbers.tolist()
    cut, step = recorded.get("cut", {}), numbers[1] - numbers[0] if len(numbers) > 1 else 1
    size = tuple(cut["size"]) if "size" in cut else None
    part = Cut(numbers[0], numbers[-1], step, size)
    if path.is_file():
        return VideoFile(path, part)
    partly = cut or recorded.get("kind") == "kitti"
    there = partly and path.is_dir() and {*numbers} <= {*images.numbered_pictures(path)}
    return FrameFolder(path, part if there else Cut(size=size))


def check_frames(provenance: Mapping[str, Any], clip: str, paths: Sequence[Path]) -> None:
    """Raise InputFileError for frames other than those of a clip, whose provenance may hold their sha256."""
    source, tracked = recorded_source(provenance), provenance.get("frames")
    wanted: object = None
    found: object = None
    video = paths[0].suffix.lower() in images.VIDEO_SUFFIXES
    if source.get("kind") in ("frames", "kitti") or (video and source):
        wanted, found = source.get("sha256"), sha256_file(paths[0]) if video else sha256_files(paths)
    elif isinstance(tracked, Mapping):  # of `track`, by name
        wanted = [str(tracked[name]) for name in sorted(tracked, key=frame_number)]
        found = [sha256_file(path) for path in paths]
    if wanted not in (None, found):
        expected, fix = f"the frames that {clip} was made from", "give those that the clip was made from"
        found = "pictures with other contents (by their sha256)"
        where = paths[0] if video else paths[0].parent
        raise InputFileError(f"{where}", expected=expected, found=found, fix=fix)


def recorded_inputs(provenance: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return what a built clip was made from, as recorded in its file; empty for other clips."""
    inputs = provenance.get("inputs")
    return inputs if isinstance(inputs, Mapping) else {}


def recorded_source(provenance: Mapping[str, Any], kind: str = "") -> Mapping[str, Any]:
    """Return the recorded source of a built clip, if it is of this kind."""
    source = recorded_inputs(provenance).get("source", provenance.get("source"))
    return source if isinstance(source, Mapping) and kind in ("", source.get("kind")) else {}


@dataclass(frozen=True)
class ClipFiles:
    """The files of one clip to label; without `tracks` they are to be computed."""

    name: str
    frames: tuple[Path, ...]
    tracks: Path | None
    annotation: Path
    notes: tuple[str, ...] = ()  # what a person should know of the frames


def find_clips(
    path: PathLike,
    *,
    annotations: PathLike,
    frames: PathLike | None = None,
    tracks: PathLike | None = None,
    catalogs: Sequence[PathLike] = (),
    range_: str = "",
    step: int = 1,
    size: str = "",
) -> dict[str, ClipFiles]:
    """Find the clips to label, sorted by name: a folder of frames, a clip file, or a folder of these.

    Of a KITTI raw root they are the clips of `catalogs`, or of its ``located.toml``. The `frames` of clip
    files are in a folder with one per clip, the folder itself, or the KITTI raw root of the build; by default
    next to the files, or in ``frames`` next to their folder. `tracks` adds more. Of frames and videos
    `range_`, `step` and `size` take a part, as `take` does. Folders without pictures are passed over.
    """
    given, notes = Path(path), Path(annotations)
    inside = listed(given) if given.is_dir() else [given]
    videos = [file for file in inside if file.suffix.lower() in images.VIDEO_SUFFIXES and file.is_file()]
    files = clip_paths(given)
    part: dict[str, Any] = {"frames": range_, "step": step, "size": size, "catalogs": tuple(catalogs)}
    shots = videos and not files  # next to clip files lie pictures of them
    sources: list[FrameSource] = []
    if part != _WHOLE or shots or any(given.glob(_DRIVE_FOLDERS)) or any(map(has_pictures, (given, *inside))):
        found = choose_sources(given, **part)
        sources = [s for s in found if not isinstance(s, FrameFolder) or has_pictures(s.folder)]
    names = sorted(source.name for source in sources)
    if tracks is not None:
        files = clip_paths(Path(tracks)) | files
        if names and not files.keys() & {*names}:
            wanted, others = ", ".join(names[:3]), ", ".join(list(files)[:3]) or "none"
            raise InputFileError(f"{tracks}", expected=f"tracks of {wanted}", found=others)
    if not names and not files:
        expected = "a folder of frames, a clip file, or a folder of such"
        raise InputFileError(f"{given}", expected=expected, found="none of them")
    shown = {source.name: _stored(source, notes) for source in sources}
    shown = shown or {name: (_frames_of_file(name, file, given, frames), ()) for name, file in files.items()}
    return {
        name: ClipFiles(name, tuple(paths), files.get(name), notes / f"{name}.json", said)
        for name, (paths, said) in sorted(shown.items())
    }


def _stored(source: FrameSource, folder: Path) -> tuple[list[Path], tuple[str, ...]]:
    """List the pictures of a source's frames, and notes on them.

    Of a video, or in another size, they are written once: ``FOLDER/.frames/<name>-<checksum>/<name>``.
    """
    if isinstance(source, FrameFolder | KittiClip) and source.cut.size is None:
        return source.paths(), ()
    info = source.inspect()
    checksum = hashlib.sha256(json.dumps(info.description).encode()).hexdigest()
    target = folder / ".frames" / f"{source.name}-{checksum[:12]}" / source.name
    paths = [target / f"{number:06d}.png" for number in source.numbers()]
    if not (target.parent / "complete").is_file():
        for path, frame in zip(paths, source.frames("luma"), strict=True):
            images.write_png(path, frame)
        write_text(target.parent / "complete", "")
    return paths, info.notes


def clip_paths(path: Path) -> dict[str, Path]:
    """Return a clip file, or those of a folder that has some itself, by name of the clip; none of a video."""
    if path.is_file():
        return {} if path.suffix.lower() in images.VIDEO_SUFFIXES else {clip_name(path): path}
    here = path.is_dir() and any(file.suffix in CLIP_SUFFIXES for file in path.iterdir())
    return dataset_paths(path) if here else {}


def _frames_of_file(name: str, file: Path, given: Path, frames: PathLike | None) -> list[Path]:
    dataset = given if given.is_dir() else given.parent
    roots = [dataset, dataset.parent / "frames"] if frames is None else [Path(frames)]
    below = [root / name for root in roots]
    if folder := next(filter(has_pictures, below if frames is None else below + roots), None):
        return frame_paths(folder)
    if frames is not None and (drive := frame_folder(clip := load(file), frames)):
        return _source_of(clip, drive).paths()
    expected, fix = f"a folder of pictures {' or '.join(map(str, below))}", "give their folder, frames=FOLDER"
    raise InputFileError(f"frames of {name}", expected=expected, found="none", fix=fix)
