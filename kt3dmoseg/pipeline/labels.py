"""What clips are labelled by: annotations, or masks as DAVIS indexed PNG or KITTI MOTS 16-bit PNG.

Pixel values of masks are object ids, 0 the background; `void_ids` says which are void. A MOTS id is
1000 * class + instance (Voigtlaender et al., CVPR 2019). Every id is taken as one motion.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from kt3dmoseg.annotate import label_tracks, load_annotation
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import PathLike, listed, read_bytes
from kt3dmoseg.io.images import decode_indices, void_ids
from kt3dmoseg.matching import is_hidden, match_frames
from kt3dmoseg.types import IntArray, Labels, Trajectories

BACKGROUND = 1
_MOTS_CLASS = 1000
_SHARE = 0.75
_MAX_FILE = 1 << 26


def find_labels(name: str, annotations: PathLike | None, masks: PathLike | None) -> dict[str, list[Path]]:
    """Find what a clip is labelled by: its file under "annotation", else its files under "masks", or nothing.

    `annotations` is a file, or a folder that may hold ``<name>.json``; `masks` a folder of them, or of one
    such folder per clip.
    """
    if annotations is not None:
        file = Path(annotations, f"{name}.json") if Path(annotations).is_dir() else Path(annotations)
        if file.is_file():
            return {"annotation": [file]}
    folders = [] if masks is None else [Path(masks, name), Path(masks)]
    found: list[Path] = next(filter(None, map(_masks_in, folders)), [])
    return {"masks": found} if found else {}


def _masks_in(folder: Path) -> list[Path]:
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    return [file for file in files if file.suffix.lower() == ".png" and not is_hidden(file.name)]


def check_labels(names: Sequence[str], annotations: PathLike | None, masks: PathLike | None) -> None:
    """Raise a KT3DMoSegError when annotations or masks are missing, of none of the clips or of any."""
    for given, what in ((annotations, "annotations"), (masks, "masks")):
        if given is not None and not Path(given).exists():
            raise InputFileError(f"{given}", expected=what, found="no such file or folder")
    if masks is not None:
        _check_masks(names, Path(masks))
    elif annotations is not None and not any(find_labels(name, annotations, None) for name in names):
        files = [path.name for path in listed(Path(annotations)) if path.suffix.lower() == ".json"]
        expected = f"{names[0]}.json" if len(names) == 1 else f"CLIP.json of {', '.join(names[:3])}"
        fix = "rename it" if files else "give the folder that has some"
        fix += ", or give --annotations none (annotations=None) for no labels"
        found = ", ".join(files[:3]) or "no annotation"
        raise InputFileError(f"{annotations}", expected=expected, found=found, fix=fix)


def _check_masks(names: Sequence[str], masks: Path) -> None:
    if len(names) > 1 and _masks_in(masks):
        expected, found = (
            f"one folder of masks per clip, as {masks / names[0]}",
            f"masks, and {len(names)} clips",
        )
        fix = "build their clip alone, or move them into a folder of its name"
        raise InvalidValueError(f"{masks}", expected=expected, found=found, fix=fix)
    if not any(find_labels(name, None, masks) for name in names):
        expected = f"masks (.png) there, or in {masks / names[0]}"
        raise InputFileError(f"{masks}", expected=expected, found="none")


def label_clip(
    name: str, files: Mapping[str, Sequence[Path]], dense: Trajectories, numbers: Sequence[int]
) -> Labels | None:
    """Label a clip's trajectories by what `find_labels` found; `numbers` are those of its frames."""
    if annotation := files.get("annotation"):
        found = load_annotation(annotation[0])
        if found.clip != name:
            where, fix = f"{annotation[0]}: clip", "annotations are of one clip each"
            raise InputFileError(where, expected=repr(name), found=repr(found.clip), fix=fix)
        return label_tracks(dense, found)
    masks = files.get("masks")
    return label_by_masks(dense, by_frame(masks, numbers, name)) if masks else None


def by_frame(paths: Sequence[Path], numbers: Sequence[int], clip: str) -> dict[int, Path]:
    """Match masks to frames by number; refuse those that belong to no frame unless every frame has one."""
    names = {path.name: path for path in paths}
    match = match_frames(names, [f"{number}.png" for number in numbers])
    if doubt := match.doubt(len(numbers)):
        expected, fix = f"numbers within {numbers[0]}..{numbers[-1]}", "number them as the frames"
        raise InputFileError(f"masks of {clip}", expected=expected, found=doubt, fix=fix)
    return {frame: names[name] for name, frame in match.frames.items()}


def label_by_masks(trajectories: Trajectories, masks: Mapping[int, Path]) -> Labels:
    """Label trajectories by the object that most of their points lie on.

    Parameters
    ----------
    trajectories : Trajectories
        Of the clip.
    masks : mapping of int to Path
        Mask of each frame index; not every frame needs one.

    Returns
    -------
    Labels
        1 = background, then the objects by ascending id; 0 where no mask, only void, or less than
        three quarters of the points agree.
    """
    votes: list[tuple[IntArray, IntArray]] = []
    used, bits = {0}, 1
    for frame, path in sorted(masks.items()):
        mask, depth = decode_indices(read_bytes(path, _MAX_FILE), os.fspath(path))
        used, bits = used.union(np.unique(mask).tolist()), max(bits, depth)
        size = mask.shape[1], mask.shape[0]
        if trajectories.image_size not in (None, size):
            expected = f"the frames' size {trajectories.image_size}"
            raise FileFormatError(f"{path}", expected=expected, found=f"{size}")
        rows, xy = trajectories.at(frame)
        column, line = np.clip(np.rint(xy).astype(np.int64), 0, np.array(size) - 1).T
        votes.append((rows, mask[line, column]))
    rows, ids = (np.concatenate(parts) for parts in zip(*votes, strict=True))
    ids[np.isin(ids, void_ids(used, bits, f"masks of {path.parent}"))] = -1
    candidates, valid = np.append(0, np.unique(ids[ids > 0])), ids >= 0
    tally = np.zeros((len(trajectories), len(candidates)), dtype=np.int64)
    np.add.at(tally, (rows[valid], np.searchsorted(candidates, ids[valid])), 1)
    clear = tally.max(axis=1) >= np.maximum(1.0, _SHARE * tally.sum(axis=1))
    label = np.where(clear, tally.argmax(axis=1) + BACKGROUND, 0).astype(np.int64)
    names = ["background", *map(_name, candidates[1:].tolist())]
    return Labels(label, BACKGROUND, dict(enumerate(names, start=BACKGROUND)))


def _name(identity: int) -> str:
    kind, instance = divmod(identity, _MOTS_CLASS)
    return f"class {kind} instance {instance}" if kind else f"object {identity}"
