"""What clips are made of, apart from frames: annotations or masks that label them, others' trajectories.

Masks are DAVIS indexed PNG or KITTI MOTS 16-bit PNG. Their pixel values are object ids, 0 the background;
`void_ids` says which are void. A MOTS id is 1000 * class + instance (Voigtlaender et al., CVPR 2019). Every
id is taken as one motion.
"""

import os
import re
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from kt3dmoseg.annotate import label_tracks, load_annotation
from kt3dmoseg.annotate.model import BUILT
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import PathLike, names_in, read_bytes
from kt3dmoseg.frames import recorded_source
from kt3dmoseg.io import load
from kt3dmoseg.io.fields import clip_name
from kt3dmoseg.io.formats import clip_files
from kt3dmoseg.io.images import MOTS_CLASS, decode_indices, void_ids
from kt3dmoseg.matching import match_frames
from kt3dmoseg.text import several
from kt3dmoseg.tracking.point_trackers import APART, fitted
from kt3dmoseg.types import ByteArray, IntArray, Labels, Trajectories

BACKGROUND = 1
_SHARE = 0.75
_MAX_FILE = 1 << 26
_RANGE = re.compile(r"_\d{6,}-\d{6,}$")  # in the name of a clip that is a part of its source


def find_labels(
    names: Sequence[str], annotations: PathLike | None, masks: PathLike | None
) -> list[dict[str, list[Path]]]:
    """Find what each clip is labelled by: its file under "annotation", else those under "masks", or nothing.

    `annotations` is a file, or a folder of ``<name>.json``; `masks` a folder of one such folder per clip, or
    of the only clip's files. A KT3DMoSegError is raised when they are missing or of none of the clips.
    """
    for given, what in ((annotations, "annotations"), (masks, "masks")):
        if given is not None and not Path(given).exists():
            raise InputFileError(f"{given}", expected=what, found="no such file or folder")
    painted = {} if masks is None else _masks_of(names, Path(masks))
    found = [{"masks": painted[name]} if painted.get(name) else {} for name in names]
    if annotations is not None:
        folder = Path(annotations)
        files = [folder / f"{name}.json" if folder.is_dir() else folder for name in names]
        found = [{"annotation": [f]} if f.is_file() else other for f, other in zip(files, found, strict=True)]
        if masks is None and not any(found):
            raise _unnamed(names, folder)
    return found


def _unnamed(names: Sequence[str], annotations: Path) -> InputFileError:
    files = [n for n in names_in(annotations) if n.lower().endswith(".json") and not n.endswith(BUILT)]
    expected = f"{names[0]}.json" if len(names) == 1 else f"CLIP.json of {', '.join(names[:3])}"
    whole = {_RANGE.sub("", name) for name in names}
    others = [file for file in files if _RANGE.sub("", file.removesuffix(".json")) in whole]
    fix = "rename it" if files else "give the folder that has some"
    if others:
        fix = f"{others[0]} is of other frames of the source: build those, or label these"
    fix += ", or give annotations=None for no labels"
    found = ", ".join(files[:3]) or "no annotation"
    return InputFileError(f"{annotations}", expected=expected, found=found, fix=fix)


def _masks_of(names: Sequence[str], masks: Path) -> dict[str, list[Path]]:
    here = _masks_in(masks)
    if here and len(names) > 1:
        expected = f"one folder of masks per clip, as {masks / names[0]}"
        fix = "build their clip alone, or move them into a folder of its name"
        found = f"masks, and {len(names)} clips"
        raise InvalidValueError(f"{masks}", expected=expected, found=found, fix=fix)
    below = {name: _masks_in(masks / name) or here for name in names}
    if not any(below.values()):
        expected = f"masks (.png) there, or in {masks / names[0]}"
        there = next(filter(None, (names_in(folder) for folder in (masks / names[0], masks))), [])
        raise InputFileError(f"{masks}", expected=expected, found=several(there) or "none")
    return below


def _masks_in(folder: Path) -> list[Path]:
    return [folder / name for name in names_in(folder) if name.lower().endswith(".png")]


def label_clip(
    name: str,
    files: Mapping[str, Sequence[Path]],
    dense: Trajectories,
    frames: Sequence[str],
    shift: int | None = None,
    notes: list[str] | None = None,
) -> Labels | None:
    """Label a clip's trajectories by what `find_labels` found; `frames` names the files of its frames.

    `notes` takes what was concluded about masks.
    """
    if annotation := files.get("annotation"):
        found, wanted = load_annotation(annotation[0]), {"clip": name, "image_size": dense.image_size}
        return label_tracks(dense, found.expect(f"{annotation[0]}: ", n_frames=dense.n_frames, **wanted))
    masks = files.get("masks")
    return label_by_masks(dense, by_frame(masks, frames, name, shift, notes)) if masks else None


def by_frame(
    paths: Sequence[Path],
    frames: Sequence[str],
    clip: str,
    shift: int | None = None,
    notes: list[str] | None = None,
) -> dict[int, Path]:
    """Match masks to frames as imports do; refuse those of no frame unless every frame has one."""
    names = {path.name: path for path in paths}
    match = match_frames(names, frames, shift=shift)
    if match.doubt or not match.frames:
        found = match.doubt or several(names)
        raise InputFileError(f"masks of {clip}", expected=match.expected, found=found, fix=match.fix)
    left = f"{several(match.unmatched)} of no frame are left out" if match.unmatched else ""
    (notes if notes is not None else []).extend(f"masks: {text}" for text in (match.note, left) if text)
    return {frame: names[name] for name, frame in match.frames.items()}


def label_by_masks(trajectories: Trajectories, masks: Mapping[int, Path]) -> Labels:
    """Label trajectories by the object that most of their points lie on.

    `masks` has the mask of each frame index; not every frame needs one. 1 = background, then the objects by
    ascending id; 0 where no mask, only void, or less than three quarters of the points agree.
    """
    votes: list[tuple[IntArray, IntArray]] = []
    used: set[int] = set()
    bits = 1
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
    kind, instance = divmod(identity, MOTS_CLASS)
    return f"class {kind} instance {instance}" if kind else f"object {identity}"


def find_tracks(names: Sequence[str], tracks: PathLike) -> list[Path | None]:
    """Find the file of each clip's trajectories: ``TRACKS/<name>.npz``, or the only one in ``TRACKS/<name>``.

    `tracks` may be the file of a single clip. InputFileError is raised when it has nothing of any clip; of a
    clip that has no file, the path is one where it would be.
    """
    root = Path(tracks)
    if root.is_file() and len(names) == 1:
        return [root]
    if not root.is_dir():
        raise InputFileError(f"{root}", expected="a folder of trajectories", found="none")
    here = clip_files(root)
    found: list[Path | None] = []
    for name in names:
        below = clip_files(root / name) if (root / name).is_dir() else []
        files = [file for file in here if clip_name(file) == name] or below
        if len(files) > 1:
            listing = " and ".join(file.name for file in files[:2])
            raise FileFormatError(f"{root}: tracks of {name}", expected="one file", found=listing)
        found.append(files[0] if files else root / f"{name}.npz")
    if not any(path and path.is_file() for path in found):
        shown = ", ".join(path.name for path in here[:3]) or "no tracks"
        raise InputFileError(f"{root}", expected=f"{names[0]}.npz or {names[0]}/FILE.npz", found=shown)
    return found


def read_tracks(
    path: Path, frames: Iterator[ByteArray], numbers: Sequence[int], min_length: int
) -> tuple[Trajectories, dict[str, int]]:
    """Read the trajectories of a clip with these frames, and count what is left out, in words.

    Whatever `kt3dmoseg.load` reads is taken; its labels are not. Points outside of the image count as not
    visible; tracks that are then shorter than `min_length` are dropped, as those of our own tracker. Errors
    are those of the frames, and FileFormatError when the trajectories are of another number of frames, or of
    other ones by their recorded numbers, or follow the frames only with x and y exchanged, or scaled.
    """
    clip = load(path)
    given, stated = clip.dense, clip.frame_numbers.tolist()
    pictures = np.stack(list(islice(frames, APART + 1)))
    deque(frames, maxlen=0)  # damaged ones are found, and those of another size
    count, (height, width) = len(numbers), pictures.shape[1:]
    fix = "give the tracks of all frames of the clip, and of no others"
    if given.n_frames != count:
        raise FileFormatError(f"{path}", expected=f"{count} frames", found=f"{given.n_frames}", fix=fix)
    known = recorded_source(clip.provenance) or stated != list(range(count))  # trackers record no numbers
    if known and stated != list(numbers):
        expected, found = (f"frames {some[0]}-{some[-1]}" for some in (numbers, stated))
        raise FileFormatError(f"{path}", expected=expected, found=found, fix=fix)
    if given.image_size not in (None, (width, height)):
        expected = f"tracks in {width}x{height} px, as the frames"
        raise FileFormatError(f"{path}", expected=expected, found=f"{given.image_size}")
    try:
        return fitted(given, pictures, min_length)
    except InvalidValueError as error:
        raise FileFormatError(f"{path}: {error}") from None
