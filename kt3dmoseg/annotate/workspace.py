"""Finding what there is to label: clips, their frames, trajectories and annotation files."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from kt3dmoseg.errors import InputFileError
from kt3dmoseg.io import dataset_paths, load
from kt3dmoseg.io.clip_frames import frames_place, paths_of_frames
from kt3dmoseg.io.fields import clip_name
from kt3dmoseg.io.formats import CLIP_SUFFIXES
from kt3dmoseg.io.images import frame_paths, has_pictures


@dataclass(frozen=True)
class ClipSource:
    """Where one clip's things are.

    Parameters
    ----------
    name : str
        Name of the clip.
    frames : tuple of Path
        Its frames in order.
    tracks : Path or None
        File of its trajectories; None = compute them.
    annotation : Path
        Where its annotation is or will be.
    """

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
) -> dict[str, ClipSource]:
    """Find the clips to label.

    Parameters
    ----------
    path : path
        A folder of frames; a clip file (``.h5``, ``.mat``); or a dataset: a folder that holds one of
        these per clip.
    annotations : path
        Folder of the annotations, one ``<clip>.json`` each.
    frames : path, optional
        Folder with a sub-folder of frames per clip, the frames themselves, or the KITTI raw root that the
        clips were built from, for clip files.
    tracks : path, optional
        Folder of clip files, or one, with trajectories for folders of frames.

    Returns
    -------
    dict of str to ClipSource
        By name, sorted.

    Raises
    ------
    InputFileError
        When `path` holds no clip, or the frames of a clip file are nowhere.
    """
    given, notes = Path(path), Path(annotations)
    folders, files = _folders(given), _files(given)
    if tracks is not None:
        files = _files(Path(tracks)) | files
    names = sorted(folders) if folders else sorted(files)
    if not names:
        expected = "a folder of frames, a clip file, or a folder of such"
        raise InputFileError(f"{given}", expected=expected, found="none of them")
    return {
        name: ClipSource(
            name,
            tuple(
                frame_paths(folders[name])
                if name in folders
                else _frames_of(name, files[name], given, frames)
            ),
            files.get(name),
            notes / f"{name}.json",
        )
        for name in names
    }


def _folders(path: Path) -> dict[str, Path]:
    if has_pictures(path):
        return {path.resolve().name: path}
    if not path.is_dir():
        return {}
    return {sub.name: sub for sub in sorted(path.iterdir()) if has_pictures(sub)}


def _files(path: Path) -> dict[str, Path]:
    if path.is_file():
        return {clip_name(path): path}
    if path.is_dir() and any(entry.suffix in CLIP_SUFFIXES for entry in path.iterdir()):
        return dataset_paths(path)
    return {}


def _frames_of(name: str, file: Path, path: Path, frames: str | os.PathLike[str] | None) -> list[Path]:
    beside = path if path.is_dir() else path.parent
    roots = [Path(frames)] if frames is not None else [beside, beside.parent / "frames"]
    for root in roots:
        if has_pictures(root / name):
            return frame_paths(root / name)
        if frames is not None and has_pictures(root):
            return frame_paths(root)
    if frames is not None and (place := frames_place(clip := load(file), frames)) != Path(frames):
        return paths_of_frames(clip, place)
    raise InputFileError(
        f"frames of {name}",
        expected=f"a folder of pictures {' or '.join(str(root / name) for root in roots)}",
        found="none",
        fix="say where they are with --frames",
    )
