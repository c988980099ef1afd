"""Labels from a folder of masks: DAVIS indexed PNG or KITTI MOTS 16-bit PNG.

Pixel values are object ids, 0 the background; `void_ids` says which are void. A MOTS id is
1000 * class + instance (Voigtlaender et al., CVPR 2019). Every id is taken as one motion.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.io.images import decode_indices, void_ids
from kt3dmoseg.matching import is_hidden, match_frames
from kt3dmoseg.types import IntArray, Labels, Trajectories

BACKGROUND = 1
_MOTS_CLASS = 1000
_SHARE = 0.75
_MAX_FILE = 1 << 26


def mask_paths(folder: str | os.PathLike[str], clip: str) -> list[Path]:
    """List a clip's masks, not for every frame: those of ``folder/clip``, or of `folder` itself, or none."""
    return next(filter(None, (_masks_in(path) for path in (Path(folder) / clip, Path(folder)))), [])


def has_masks(folder: Path) -> bool:
    """Whether a folder holds masks itself."""
    return bool(_masks_in(folder))


def _masks_in(folder: Path) -> list[Path]:
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    return [file for file in files if file.suffix.lower() == ".png" and not is_hidden(file.name)]


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
    return _elect(rows, ids, len(trajectories))


def by_frame(paths: Sequence[Path], numbers: Sequence[int], clip: str) -> dict[int, Path]:
    """Match masks to frames by number, as `match_frames` does.

    Raises InputFileError when masks belong to no frame and not every frame has one.
    """
    names = {path.name: path for path in paths}
    match = match_frames(names, [f"{number}.png" for number in numbers])
    if doubt := match.doubt(len(numbers)):
        expected, fix = f"numbers within {numbers[0]}..{numbers[-1]}", "number them as the frames"
        raise InputFileError(f"masks of {clip}", expected=expected, found=doubt, fix=fix)
    return {frame: names[name] for name, frame in match.frames.items()}


def _elect(rows: IntArray, ids: IntArray, count: int) -> Labels:
    candidates = np.concatenate([[0], np.unique(ids[ids > 0])])
    valid = ids >= 0
    tally = np.zeros((count, len(candidates)), dtype=np.int64)
    np.add.at(tally, (rows[valid], np.searchsorted(candidates, ids[valid])), 1)
    clear = tally.max(axis=1) >= np.maximum(1.0, _SHARE * tally.sum(axis=1))
    label = np.where(clear, tally.argmax(axis=1) + BACKGROUND, 0).astype(np.int64)
    names = [_name(identity) for identity in candidates[1:].tolist()]
    return Labels(label, BACKGROUND, dict(enumerate(["background", *names], start=BACKGROUND)))


def _name(identity: int) -> str:
    kind, instance = divmod(identity, _MOTS_CLASS)
    return f"class {kind} instance {instance}" if kind else f"object {identity}"
