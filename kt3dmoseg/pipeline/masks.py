"""Labels from a folder of masks: DAVIS indexed PNG or KITTI MOTS 16-bit PNG.

Pixel values are object ids, 0 the background. DAVIS marks void with 254 or 255, MOTS ignored regions
with 10000; a MOTS id is 1000 * class + instance (Voigtlaender et al., CVPR 2019). Every id is
taken as one motion.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.io.images import decode_indices, frame_number, numbered_pictures
from kt3dmoseg.types import IntArray, Labels, Trajectories

BACKGROUND = 1
_VOID_8, _VOID_16, _MOTS_CLASS = (254, 255), (10000,), 1000
_SHARE = 0.75
_MAX_FILE = 1 << 26


def mask_paths(folder: str | os.PathLike[str], clip: str) -> list[Path]:
    """List a clip's masks, not for every frame: those of ``folder/clip``, or of `folder` itself, or none."""
    for candidate in (Path(folder) / clip, Path(folder)):
        if has_masks(candidate):
            return list(numbered_pictures(candidate).values())
    return []


def has_masks(folder: Path) -> bool:
    """Whether a folder holds masks itself."""
    return folder.is_dir() and any(folder.glob("*.png"))


def read_mask(path: str | os.PathLike[str]) -> IntArray:
    """Read one mask: object ids (H, W); 0 background, -1 void.

    Raises FileFormatError when it is no PNG of one channel, indexed or gray, 8 or 16 bits deep.
    """
    ids, bits = decode_indices(read_bytes(path, _MAX_FILE), os.fspath(path))
    ids[np.isin(ids, _VOID_16 if bits == 16 else _VOID_8)] = -1
    return ids


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
    for frame, path in sorted(masks.items()):
        mask = read_mask(path)
        size = mask.shape[1], mask.shape[0]
        if trajectories.image_size not in (None, size):
            expected = f"the frames' size {trajectories.image_size}"
            raise FileFormatError(f"{path}", expected=expected, found=f"{size}")
        rows, xy = trajectories.at(frame)
        column, line = np.clip(np.rint(xy).astype(np.int64), 0, np.array(size) - 1).T
        votes.append((rows, mask[line, column]))
    rows, ids = (np.concatenate(parts) for parts in zip(*votes, strict=True))
    return _elect(rows, ids, len(trajectories))


def by_frame(paths: Sequence[Path], numbers: Sequence[int], clip: str) -> dict[int, Path]:
    """Match masks to frames by number; by order when there are as many, without a gap, numbered otherwise.

    Raises InputFileError when neither fits.
    """
    index = {number: k for k, number in enumerate(numbers)}
    named = {frame_number(path): path for path in paths}
    if set(named) <= set(index):
        return {index[number]: path for number, path in named.items()}
    if len(paths) == len(numbers) == max(named) - min(named) + 1:
        return dict(enumerate(paths))
    expected = f"numbers within {numbers[0]}..{numbers[-1]}, or {len(numbers)} masks"
    found = f"{len(paths)} masks numbered {min(named)}..{max(named)}"
    raise InputFileError(f"masks of {clip}", expected=expected, found=found)


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
