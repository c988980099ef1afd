"""Where the frames of clips are: in folders of pictures, videos and KITTI raw drives.

Whatever needs frames finds them here. `find_sources` lists what clips can be built from, `frames_of` reads
the frames of a clip that exists, and `find_clips` lists what there is to label.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import listed, sha256_file, sha256_files
from kt3dmoseg.io import dataset_paths, load
from kt3dmoseg.io.fields import clip_name
from kt3dmoseg.io.formats import CLIP_SUFFIXES
from kt3dmoseg.io.images import (
    Colour,
    frame_number,
    frame_paths,
    gray,
    has_pictures,
    is_clip,
    numbered_pictures,
    picture_size,
    read_frames,
)
from kt3dmoseg.io.video import VIDEO_SUFFIXES, open_video
from kt3dmoseg.types import ByteArray, Camera, Clip, FloatArray

# What KITTI's drives need is imported where there are any.
if TYPE_CHECKING:
    from kt3dmoseg.kitti import RawDrive

_DRIVE_FOLDERS = "????_??_??/*_drive_????_sync"
_DRIVE = re.compile(r"(\d{4}_\d\d_\d\d)_drive_(\d{4})")
_DAY_OR_DRIVE = re.compile(r"\d{4}_\d\d_\d\d(_drive_\d{4}_sync)?")


@dataclass(frozen=True)
class FrameInfo:
    """What is known of a clip before its frames are decoded.

    `numbers` of the frames are None when only decoding shows how many there are. The `description` states
    where they come from, with the sha256 of everything they are decoded from, and no path of this machine.
    `timestamps` (F,) are in seconds.
    """

    numbers: Sequence[int] | None
    description: dict[str, Any]
    timestamps: FloatArray | None = None
    camera: Camera | None = None


@dataclass(frozen=True)
class FrameFolder:
    """A folder of numbered pictures; the clip has the folder's name."""

    folder: Path

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.resolve().name

    @property
    def where(self) -> str:
        """The folder."""
        return f"{self.folder}"

    def inspect(self) -> FrameInfo:
        """Check names and numbers and hash the files."""
        paths = frame_paths(self.folder)
        ends = {"first": paths[0].name, "last": paths[-1].name, "count": len(paths)}
        numbers = [frame_number(path) for path in paths]
        return FrameInfo(numbers, {"kind": "frames", **ends, "sha256": sha256_files(paths)})

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        """Yield gray frames, all of one size."""
        return read_frames(frame_paths(self.folder), colour)


@dataclass(frozen=True)
class VideoFile:
    """A video, decoded frame by frame; always taken as luma."""

    file: Path

    @property
    def name(self) -> str:
        """Name of the file without its suffix."""
        return self.file.stem

    @property
    def where(self) -> str:
        """The file."""
        return f"{self.file}"

    def inspect(self) -> FrameInfo:
        """Hash the file."""
        return FrameInfo(None, {"kind": "video", "file": self.file.name, "sha256": sha256_file(self.file)})

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        """Yield the luma of every frame."""
        del colour  # a video is in colour by nature
        with open_video(self.file) as video:
            if not video.isOpened():
                raise FileFormatError(
                    f"{self.file}", expected="a video that OpenCV decodes", found="none", fix="check the file"
                )
            while (read := video.read())[0]:
                yield gray(np.asarray(read[1]), f"{self.file}", "luma")


@dataclass(frozen=True)
class KittiClip:
    """Frames of a KITTI raw drive, by number; all that are on disk unless a range is given."""

    drive: RawDrive
    first: int | None = None
    last: int | None = None
    title: str = ""

    @property
    def name(self) -> str:
        """The given title, or the drive's name and the range."""
        span = "" if self.first is None else f"_{self.first:06d}-{self.last:06d}"
        return self.title or f"{self.drive.drive.name}{span}"

    @property
    def where(self) -> str:
        """The root and the drive in it."""
        return f"{self.drive.root}: {self.drive.drive.name}"

    def inspect(self) -> FrameInfo:
        """Check that the frames are there, hash them, and read their times and the calibration."""
        numbers, camera = self._numbers(), self.drive.camera
        description = {
            "kind": "kitti",
            "drive": self.drive.drive.name,
            "camera": camera,
            "first": numbers[0],
            "last": numbers[-1],
            "sha256": sha256_files([self.drive.frame_path(n) for n in numbers]),
        }
        times, intrinsics = self.drive.timestamps(numbers), self.drive.K
        calibrated, size = self.drive.image_size, picture_size(self.drive.frame_path(numbers[0]))
        if calibrated != size:
            expected, found = ("{}x{} px".format(*size), "{}x{}".format(*calibrated))
            where = f"{self.drive.folder}: calibration of camera {camera}"
            fix = "it is of another day, or the frames were resized or cropped"
            raise FileFormatError(where, expected=f"{expected}, as the frames", found=found, fix=fix)
        return FrameInfo(numbers, description, times, Camera(f"image_{camera:02d}", intrinsics))

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        """Yield gray frames; of the colour cameras 2 and 3 their luma."""
        wanted: Colour = "luma" if self.drive.camera > 1 else colour
        return read_frames([self.drive.frame_path(n) for n in self._numbers()], wanted)

    def _numbers(self) -> Sequence[int]:
        present = [int(n) for n in self.drive.numbers]
        first = self.first if self.first is not None else min(present, default=0)
        last = self.last if self.last is not None else max(present, default=0)
        if last <= first:
            raise InvalidValueError(
                f"{self.where}: range", expected="at least two frames, FIRST-LAST", found=f"{first}-{last}"
            )
        return range(first, last + 1)


class FrameSource(Protocol):
    """A clip's frames. Making one reads nothing, so that a bad clip fails when it is built."""

    @property
    def name(self) -> str:
        """Name of the clip."""

    @property
    def where(self) -> str:
        """What messages call the source."""

    def inspect(self) -> FrameInfo:
        """Check and describe the source without decoding frames."""

    def frames(self, colour: Colour) -> Iterator[ByteArray]:
        """Yield gray frames, all of one size."""


def find_sources(path: str | os.PathLike[str]) -> list[FrameSource]:
    """List the clips at a path, sorted by name.

    Parameters
    ----------
    path : path
        A folder of frames, a video, a KITTI raw root (the clips of its ``located.toml``, else one per
        drive), or a folder of any of the first two.

    Raises
    ------
    InputFileError
        When there is nothing of the kind, pictures lie next to folders of frames, or a link leads nowhere.
    FileFormatError
        When ``located.toml`` is no catalog.
    """
    root = Path(path)
    if root.is_file():
        return [VideoFile(root)]
    if not root.is_dir():
        raise InputFileError(f"{root}", expected="frames, a video or a KITTI raw root", found="no such path")
    if any(root.glob(_DRIVE_FOLDERS)):
        found = located_sources(root) or kitti_sources(root)
        return sorted(found, key=lambda source: source.name)
    if is_clip(root):
        return [FrameFolder(root)]
    _check_level(root)
    inside = listed(root)
    found = [FrameFolder(path) for path in inside if path.is_dir()]
    found += [VideoFile(path) for path in inside if path.suffix.lower() in VIDEO_SUFFIXES]
    if not found:
        raise InputFileError(
            f"{root}",
            expected="numbered frames, or one folder of frames per clip",
            found="an empty folder" if not inside else f"{inside[0].name}, no pictures",
            fix="give the folder that holds them",
        )
    return sorted(found, key=lambda source: source.name)


def _check_level(folder: Path) -> None:
    """Refuse a folder that is next to a KITTI raw root: its day or drive, or the folder that it lies in."""
    inner = _DAY_OR_DRIVE.fullmatch(folder.resolve().name) is not None
    near = folder.resolve().parents[:2] if inner else folder.iterdir()
    root = next((path for path in near if any(path.glob(_DRIVE_FOLDERS))), None)
    if root is not None:
        found = "a folder inside of one" if inner else "the folder that it lies in"
        raise InputFileError(f"{folder}", expected="a KITTI raw root", found=found, fix=f"give {root}")


def located_sources(root: str | os.PathLike[str]) -> list[FrameSource]:
    """List the clips of ``ROOT/located.toml``, as `pull` and `locate` write it, that are on disk.

    Without that file in the KITTI raw root the list is empty. A `FileFormatError` is raised when the file is
    no catalog, or a clip in it skips frames.
    """
    from kt3dmoseg import catalog
    from kt3dmoseg.catalog import format_numbers
    from kt3dmoseg.kitti import RawDrive
    from kt3dmoseg.kitti.raw import LOCATED

    path = Path(root) / LOCATED
    found: list[FrameSource] = []
    for clip in (catalog.load(path, built_in=False) if path.is_file() else {}).values():
        numbers = clip.numbers or ()
        try:
            drive = RawDrive(root, clip.drive.date, clip.drive.number, clip.camera)
            on_disk = np.isin(numbers, drive.numbers).any()
        except InputFileError:  # nothing of that drive or camera
            continue
        if on_disk and numbers[-1] - numbers[0] + 1 != len(numbers):
            raise FileFormatError(
                f"{path}: {clip.name}", expected="consecutive frames", found=format_numbers(numbers)
            )
        if on_disk:
            found.append(KittiClip(drive, numbers[0], numbers[-1], clip.name))
    return found


def kitti_sources(
    root: str | os.PathLike[str],
    *,
    date: str | None = None,
    drive: str | int | None = None,
    camera: int = 0,
    frames: str | tuple[int, int] | None = None,
    name: str = "",
) -> list[FrameSource]:
    """List the drives under a KITTI raw root, as clips.

    Parameters
    ----------
    root : path
        The folder that holds ``2011_09_26/2011_09_26_drive_0005_sync``.
    date, drive : optional
        Only that day, only that number.
    camera : int
        0 and 1 gray, 2 and 3 colour.
    frames : (first, last) or "first-last", optional
        Frame numbers, both included; by default all that are on disk.
    name : str
        Name of the clip; only for a single drive.

    Raises
    ------
    InputFileError
        When no drive fits.
    InvalidValueError
        When a range or a name is given for several drives.
    """
    from kt3dmoseg.kitti import Drive, RawDrive

    span = _span(frames)
    wanted = None if drive is None else Drive(date or "2011_09_26", drive).number  # type: ignore[arg-type]  # it converts
    found = [
        match
        for folder in sorted(Path(root).glob(_DRIVE_FOLDERS))
        if (match := _DRIVE.fullmatch(folder.name.removesuffix("_sync")))
        and date in (None, match[1])
        and wanted in (None, int(match[2]))
    ]
    if not found:
        asked = " ".join(str(part) for part in (date, drive) if part is not None)
        raise InputFileError(
            f"{os.fspath(root)}",
            expected=f"a KITTI raw root with drive {asked}".rstrip(),
            found="no such drive",
            fix="fetch it with kt3dmoseg pull, or give the folder that holds the day's folder",
        )
    if len(found) > 1 and (span or name):
        raise InvalidValueError(
            "range and name", expected="one drive", found=f"{len(found)}", fix="give --date and --drive"
        )
    first, last = span or (None, None)
    return [KittiClip(RawDrive(root, match[1], match[2], camera), first, last, name) for match in found]


def _span(frames: str | tuple[int, int] | None) -> tuple[int, int] | None:
    if not isinstance(frames, str):
        return frames
    match = re.fullmatch(r"(\d{1,9})-(\d{1,9})", frames)
    if not match:
        raise InvalidValueError("range", expected="FIRST-LAST, as 45-64", found=repr(frames))
    return int(match[1]), int(match[2])


def frame_folder(clip: Clip, root: str | os.PathLike[str]) -> Path | None:
    """Find the folder of a clip's frames below `root`: ``ROOT/CLIP``, or its camera of a KITTI drive."""
    below, source = [Path(root, clip.name)], _kitti_source(clip)
    drive = _DRIVE.fullmatch(str(source.get("drive")))
    if drive and source.get("camera") in (0, 1, 2, 3):
        from kt3dmoseg.kitti import Drive

        below.append(Path(root, Drive(drive[1], int(drive[2])).camera_folder(source["camera"]), "data"))
    return next((folder for folder in below if folder.is_dir()), None)


def frames_of(clip: Clip, root: str | os.PathLike[str]) -> list[ByteArray]:
    """Read the frames of a clip, (H, W) uint8 each: as many as it has, and of its size.

    They are in a folder of clips or a KITTI raw root that `frame_folder` finds them in, or `root` is the
    folder of the numbered pictures itself. Of pictures in colour the luma is taken. There may be more than
    the clip's when it was built from a KITTI drive: those of its numbers are taken. An `InputFileError` or
    `FileFormatError` is raised when they cannot be read, or are those of another clip.
    """
    folder = frame_folder(clip, root) or Path(root)
    paths = _paths_of(clip, folder)
    if len(paths) != clip.n_frames:
        raise InputFileError(
            f"{folder}", expected=f"the {clip.n_frames} frames of {clip.name}", found=f"{len(paths)}"
        )
    frames = list(read_frames(paths, "luma"))
    found, wanted = frames[0].shape[::-1], clip.dense.image_size
    if wanted is not None and found != wanted:
        raise InputFileError(
            f"{folder}",
            expected=f"frames of {wanted[0]}x{wanted[1]} px, as in {clip.name}",
            found=f"{found[0]}x{found[1]}",
        )
    check_frames(clip.provenance, clip.name, paths)
    return frames


def check_frames(provenance: Mapping[str, Any], clip: str, paths: Sequence[Path]) -> None:
    """Raise InputFileError for frames other than those of a clip, whose provenance may hold their sha256."""
    source, tracked = _source(provenance), provenance.get("frames")
    wanted: object = None
    found: object = None
    if source.get("kind") in ("frames", "kitti"):
        wanted, found = source.get("sha256"), sha256_files(paths)
    elif isinstance(tracked, Mapping):  # of `track`, by name
        wanted = [str(tracked[name]) for name in sorted(tracked, key=frame_number)]
        found = [sha256_file(path) for path in paths]
    if wanted not in (None, found):
        raise InputFileError(
            f"{paths[0].parent}",
            expected=f"the frames that {clip} was made from",
            found="pictures with other contents (by their sha256)",
            fix="give the folder that the clip was made from",
        )


def _paths_of(clip: Clip, folder: Path) -> list[Path]:
    """List a folder's numbered pictures, or of a KITTI drive those that the clip was built from."""
    if _kitti_source(clip) and folder.is_dir():
        pictures, numbers = numbered_pictures(folder), clip.frame_numbers.tolist()
        if set(numbers) <= set(pictures):
            return [pictures[number] for number in numbers]
    return frame_paths(folder)


def _source(provenance: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return what a built clip comes from, as recorded in its file; empty for other clips."""
    inputs = provenance.get("inputs", provenance.get("fingerprint"))  # its name in 0.1.0
    source = inputs.get("source") if isinstance(inputs, Mapping) else None
    return source if isinstance(source, Mapping) else {}


def _kitti_source(clip: Clip) -> Mapping[str, Any]:
    source = _source(clip.provenance)
    return source if source.get("kind") == "kitti" else {}


@dataclass(frozen=True)
class ClipFiles:
    """The files of one clip to label; without `tracks` they are to be computed."""

    name: str
    frames: tuple[Path, ...]
    tracks: Path | None
    annotation: Path


def find_clips(
    path: str | os.PathLike[str],
    *,
    annotations: str | os.PathLike[str],
    frames: str | os.PathLike[str] | None = None,
    tracks: str | os.PathLike[str] | None = None,
) -> dict[str, ClipFiles]:
    """Find the clips to label, sorted by name.

    They are in a folder of frames, a clip file (``.h5``, ``.mat``), or a dataset: a folder that holds one of
    these per clip. `annotations` is the folder of ``<clip>.json``. Clip files need `frames`: a folder with a
    sub-folder of frames per clip, the frames themselves, or the KITTI raw root that the clips were built
    from. `tracks`, clip files too, adds trajectories to folders of frames. An `InputFileError` is raised when
    `path` holds no clip, or the frames of a clip file are nowhere.
    """
    given = Path(path)
    folders, files = _picture_folders(given), _clip_files(given)
    if tracks is not None:
        files = _clip_files(Path(tracks)) | files
        if folders and not folders.keys() & files.keys():
            expected = f"tracks of {', '.join(list(folders)[:3])}"
            raise InputFileError(f"{tracks}", expected=expected, found=", ".join(list(files)[:3]) or "none")
    out = {}
    for name in sorted(folders or files):
        if name in folders:
            paths = frame_paths(folders[name])
        else:
            paths = _frames_of_file(name, files[name], given, None if frames is None else Path(frames))
        out[name] = ClipFiles(name, tuple(paths), files.get(name), Path(annotations, f"{name}.json"))
    if not out:
        expected = "a folder of frames, a clip file, or a folder of such"
        raise InputFileError(f"{given}", expected=expected, found="none of them")
    return out


def _picture_folders(path: Path) -> dict[str, Path]:
    if is_clip(path):
        return {path.resolve().name: path}
    inside = listed(path) if path.is_dir() else []
    return {folder.name: folder for folder in inside if has_pictures(folder)}


def _clip_files(path: Path) -> dict[str, Path]:
    if path.is_file():
        return {clip_name(path): path}
    if path.is_dir() and any(file.suffix in CLIP_SUFFIXES for file in path.iterdir()):
        return dataset_paths(path)
    return {}


def _frames_of_file(name: str, file: Path, given: Path, frames: Path | None) -> list[Path]:
    """List the frames of a clip file: below or at `frames`, else next to what was given."""
    dataset = given if given.is_dir() else given.parent
    roots = [frames] if frames is not None else [dataset, dataset.parent / "frames"]
    candidates = [root / name for root in roots] + ([frames] if frames is not None else [])
    for folder in candidates:
        if has_pictures(folder):
            return frame_paths(folder)
    if frames is not None and (drive := frame_folder(clip := load(file), frames)):
        return _paths_of(clip, drive)
    raise InputFileError(
        f"frames of {name}",
        expected=f"a folder of pictures {' or '.join(str(root / name) for root in roots)}",
        found="none",
        fix="give their folder with --frames",
    )
