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
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.io.images import decode_indices, frame_number, numbered_pictures
from kt3dmoseg.types import IntArray, Labels, Trajectories

BACKGROUND = 1
_VOID_8, _VOID_16, _MOTS_CLASS = (254, 255), (10000,), 1000
_SHARE = 0.75
_MAX_FILE = 1 << 26


def mask_paths(folder: str | os.PathLike[str], clip: str) -> list[Path]:
    """List a clip's masks: those of ``folder/clip``, or of `folder` itself; empty when there are none.

    Not every frame needs one.
    """
    for place in (Path(folder) / clip, Path(folder)):
        if has_masks(place):
            return list(numbered_pictures(place).values())
    return []


def has_masks(folder: Path) -> bool:
    """Whether a folder holds masks itself."""
    return folder.is_dir() and any(folder.glob("*.png"))


def read_mask(path: str | os.PathLike[str]) -> IntArray:
    """Read one mask.

    Returns
    -------
    (H, W) int64
        Object ids; 0 background, -1 void.

    Raises
    ------
    FileFormatError
        When it is no PNG of one channel, indexed or gray, 8 or 16 bits deep.
    """
    where = os.fspath(path)
    ids, bits = decode_indices(read_bytes(path, _MAX_FILE), where)
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
        _check_size(trajectories, mask, path)
        rows, xy = trajectories.at(frame)
        pixel = np.rint(xy).astype(np.int64)
        column = np.clip(pixel[:, 0], 0, mask.shape[1] - 1)
        line = np.clip(pixel[:, 1], 0, mask.shape[0] - 1)
        votes.append((rows, mask[line, column]))
    rows, ids = (np.concatenate(parts) for parts in zip(*votes, strict=True))
    return _elect(rows, ids, len(trajectories))


def by_frame(paths: Sequence[Path], numbers: Sequence[int], clip: str) -> dict[int, Path]:
    """Match masks to frames by number; by order when there are as many, without a gap, numbered otherwise.

    Raises
    ------
    InputFileError
        When neither fits.
    """
    index = {number: k for k, number in enumerate(numbers)}
    named = {frame_number(path): path for path in paths}
    if set(named) <= set(index):
        return {index[number]: path for number, path in named.items()}
    if len(paths) == len(numbers) == max(named) - min(named) + 1:
        return dict(enumerate(paths))
    raise InputFileError(
        f"masks of {clip}",
        expected=f"numbers within {numbers[0]}..{numbers[-1]}, or {len(numbers)} masks",
        found=f"{len(paths)} masks numbered {min(named)}..{max(named)}",
    )


def _elect(rows: IntArray, ids: IntArray, count: int) -> Labels:
    objects = np.unique(ids[ids > 0])
    candidates = np.concatenate([[0], objects])
    valid = ids >= 0
    tally = np.zeros((count, len(candidates)), dtype=np.int64)
    np.add.at(tally, (rows[valid], np.searchsorted(candidates, ids[valid])), 1)
    clear = tally.max(axis=1) >= np.maximum(1.0, _SHARE * tally.sum(axis=1))
    label = np.where(clear, tally.argmax(axis=1) + BACKGROUND, 0)
    names = {BACKGROUND: "background"} | {BACKGROUND + 1 + k: _name(int(v)) for k, v in enumerate(objects)}
    return Labels(label.astype(np.int64), BACKGROUND, names)


def _name(identity: int) -> str:
    if identity < _MOTS_CLASS:
        return f"object {identity}"
    return f"class {identity // _MOTS_CLASS} instance {identity % _MOTS_CLASS}"


def _check_size(trajectories: Trajectories, mask: npt.NDArray[np.int64], path: Path) -> None:
    size = mask.shape[1], mask.shape[0]
    if trajectories.image_size not in (None, size):
        raise FileFormatError(
            f"{path}", expected=f"the frames' size {trajectories.image_size}", found=f"{size}"
        )
