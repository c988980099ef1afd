"""Finding a clip in a drive: by CRC32 and size, else by pixels, else by correlation.

Pure functions lead from evidence to frame numbers: `match_exact` takes, per frame of the clip, the numbers of
the drive's frames that equal it; `match_graded` takes the correlation of every frame with every frame.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from kt3dmoseg import catalog
from kt3dmoseg.catalog import CAMERAS, Drive, Entry, format_numbers
from kt3dmoseg.errors import FileFormatError, KT3DMoSegError
from kt3dmoseg.files import PathLike, sha256_arrays
from kt3dmoseg.kitti import LocateOptions
from kt3dmoseg.kitti.archives import Archives, DamagedError, FileSet, TargetFolder, frames_of
from kt3dmoseg.kitti.http import AbsentError, Traffic
from kt3dmoseg.kitti.raw import decode_frame, frame_number, read_clip
from kt3dmoseg.options import from_mapping
from kt3dmoseg.types import ByteArray, Float32Array, FloatArray

CHECKSUM, PIXELS, CORRELATION = "crc32", "pixels", "correlation"

_WIDTH = 320
_SIGMA = 2.0
_LEAST_SCORE = 0.8
_LEAST_MARGIN = 0.02
_LEAST_AGREEMENT = 0.9
_MOST = 3


class NotLocatedError(KT3DMoSegError, LookupError):
    """A clip's frames are not in a drive, or match several parts of it."""


def locate(
    root: PathLike,
    clips: Iterable[str] = (),
    *,
    catalogs: Iterable[PathLike] = (),
    traffic: Traffic | None = None,
    report: Callable[[str], object] = print,
    **options: Any,  # noqa: ANN401  # fields of LocateOptions
) -> dict[str, Entry]:
    """Find the frame numbers of clips in their drives and write them to ``ROOT/located.toml``.

    `root` is the folder that `pull` fills, `clips`, `catalogs` and `traffic` are as there, `options` fields
    of `LocateOptions`; `report` takes one line per clip. The clips are returned with their numbers, by name.
    NotLocatedError or AbsentError when a clip or its drive is not there, or the clip is ambiguous: after all
    clips have been tried, with what was found already written.
    """
    chosen = from_mapping(LocateOptions, options)
    wanted = catalog.choose(clips, *catalogs)
    target = TargetFolder(Path(root))
    found: dict[str, Entry] = {}
    failures: dict[str, KT3DMoSegError] = {}
    with target.lock(), closing(Archives(chosen, target, traffic, report)) as origin:
        for clip in wanted:
            try:
                look = partial(locate_clip, clip, pixels=chosen.pixels, own=chosen.frames)
                located = found[clip.name] = origin.look(frames_of(clip.drive), look)
                target.keep_located([located])
                numbers, proof = format_numbers(located.numbers or ()), located.proof or "given"
                report(f"{clip.name}: {clip.drive.name} camera {located.camera} frames {numbers} ({proof})")
            except (NotLocatedError, AbsentError, FileFormatError) as error:
                if len(wanted) == 1:
                    raise
                failures[clip.name] = error
                report(str(error))
    if failures:
        what = f"{len(failures)} of {len(wanted)} clips were not located"
        raise NotLocatedError(what, found=", ".join(failures))
    return found


def locate_clip(clip: Entry, files: FileSet, again: bool, *, pixels: bool, own: str | None = None) -> Entry:
    """Return the clip with its frame numbers proved in a drive's files, camera and proof filled in.

    Evidence is, in this order, CRC32 and size; with `pixels` these; the correlation with the clip's `own`
    frames in a folder. A clip without fingerprints is returned as it is: its numbers are those the user gave.
    NotLocatedError when nothing decides; DamagedError when a directory should be read `again` first.
    """
    if not clip.frames:
        return clip
    verdicts = {camera: _by_checksum(clip, files, camera) for camera in CAMERAS}
    for camera in sorted(CAMERAS, key=lambda camera: camera != clip.camera):
        if numbers := verdicts[camera].numbers:
            return replace(clip, camera=camera, numbers=numbers, proof=CHECKSUM, source=files.name)
    if not (again or files.local):  # a directory holds no checksum of itself
        raise DamagedError(files.name, expected=f"the frames of {clip.name}", found="others")
    verdict, tried = verdicts[clip.camera], "CRC32 and size"
    fix = "kt3dmoseg locate compares pixels"
    if pixels and not verdict.ambiguous:
        proof, verdict = _by_pictures(clip, files, own)
        if verdict.numbers:
            return replace(clip, numbers=verdict.numbers, proof=proof, source=files.name)
        tried += ", pixels" + (" and correlation" if own else "")
        fix = "'kt3dmoseg locate' correlates the clip's own frames, given their folder"
        fix = "is it another drive?" if own else fix
    what = "no match"
    if verdict.ambiguous:
        what, fix = "several matches", "put the right ones as numbers into a catalog of your own"
    raise NotLocatedError(
        f"{clip.name}: {what} in {files.name} by {tried}",
        expected=f"{clip.length} frames",
        found=f"best candidates: {'; '.join(verdict.candidates) or 'none'}",
        fix=fix,
    )


def drive_frames(files: FileSet, drive: Drive, camera: int) -> dict[int, str]:
    """Names of the frames of one camera that are there, by number, ascending."""
    folder = f"{drive.camera_folder(camera)}/data/"
    names = sorted(name for name in files.sizes if name.startswith(folder))
    return {n: name for name in names if (n := frame_number(name[len(folder) :])) is not None}


def _by_checksum(clip: Entry, files: FileSet, camera: int) -> Verdict:
    frames = drive_frames(files, clip.drive, camera)
    sizes = {mark.bytes for mark in clip.frames}
    crc32 = {n: files.crc32(name) for n, name in frames.items() if files.sizes[name] in sizes}
    equal = [
        [n for n, crc in crc32.items() if (files.sizes[frames[n]], crc) == (mark.bytes, mark.crc32)]
        for mark in clip.frames
    ]
    given = clip.numbers or ()
    if given and all(n in found for n, found in zip(given, equal, strict=True)):
        return Verdict(given)
    return match_exact(equal)


def _by_pictures(clip: Entry, files: FileSet, folder: str | None) -> tuple[str, Verdict]:
    """Read all frames of the camera once, and compare their pixels, or correlate them with the clip's own."""
    below = Path(folder or "") / clip.name
    own_frames = read_clip(below if below.is_dir() else Path(folder)) if folder else ()
    own = np.array([descriptor(image) for _, image in own_frames])  # (F, n)
    if folder and len(own) != clip.length:
        raise FileFormatError(folder, expected=f"{clip.length} frames of {clip.name}", found=f"{len(own)}")
    frames = drive_frames(files, clip.drive, clip.camera)
    checksums: dict[int, str] = {}
    columns: dict[int, Float32Array] = {}
    contents, title = files.read(frames.values()), f"{clip.name}: comparing pixels"
    for name, content in tqdm(contents, title, len(frames), unit="frame", disable=None):
        number = int(Path(name).stem)
        try:
            image = decode_frame(content, name)
        except FileFormatError:
            continue  # not a picture: cannot be one of the clip's frames
        checksums[number] = sha256_arrays(image)
        if folder and (described := descriptor(image)).shape == own.shape[1:]:
            columns[number] = own @ described
    exact = match_exact([[n for n in frames if checksums.get(n) == mark.pixels] for mark in clip.frames])
    if exact.numbers or exact.ambiguous or not folder:
        return PIXELS, exact
    numbers = sorted(columns)
    similarity = np.array([columns[n] for n in numbers]).reshape(len(numbers), len(own)).T
    return CORRELATION, match_graded(similarity, numbers)


@dataclass(frozen=True)
class Verdict:
    """Frame numbers when they are proved; otherwise the best candidates, best first, at most three."""

    numbers: tuple[int, ...] | None
    candidates: tuple[str, ...] = ()
    ambiguous: bool = False


def match_exact(equal: Sequence[Sequence[int]]) -> Verdict:
    """Find the frame numbers from the numbers of the drive's frames that equal each frame of the clip.

    They are proved when every frame has exactly one equal and these ascend, or when, among repeated equal
    frames, exactly one choice has a constant step.
    """
    if all(equal):
        unique = all(len(found) == 1 for found in equal)
        choices = [tuple(found[0] for found in equal)] if unique else _steady(equal)
        if len(choices) == 1 and all(b > a for a, b in pairwise(choices[0])):
            return Verdict(choices[0])
        found = choices or [tuple(found[0] for found in equal)]
        what = "all frames equal" + (", but not in ascending order" if unique else "")
        candidates = tuple(f"{format_numbers(numbers)} ({what})" for numbers in found[:_MOST])
        return Verdict(None, candidates, ambiguous=not unique)
    votes = Counter(number - index for index, found in enumerate(equal) for number in found)
    best = [
        f"{format_numbers(range(first, first + len(equal)))} ({n} of {len(equal)} frames equal)"
        for first, n in votes.most_common(_MOST)
        if first >= 0
    ]
    return Verdict(None, tuple(best))


def _steady(equal: Sequence[Sequence[int]]) -> list[tuple[int, ...]]:
    """All choices of equal frames with a constant step."""
    steps = sorted({b - a for a in equal[0] for b in equal[1] if b > a}) if len(equal) > 1 else [1]
    choices = (tuple(first + step * k for k in range(len(equal))) for step in steps for first in equal[0])
    return [choice for choice in choices if all(n in found for n, found in zip(choice, equal, strict=True))]


def match_graded(similarity: FloatArray | Float32Array, numbers: Sequence[int]) -> Verdict:
    """Find the consecutive frame numbers from the correlations (F, D) of the clip's frames with the drive's.

    They are proved when the best run of F consecutive numbers correlates by at least 0.8 on average, the
    next best by at least 0.02 less, and nine frames in ten have their best match there. On KITTI frames that
    were re-encoded (JPEG quality 30, gamma 0.7, halved and enlarged, noise of 10 gray levels), the true run
    reaches at least 0.97 and a shift by one frame at most 0.90.
    """
    length, ends = len(similarity), range(len(similarity) - 1, len(numbers))
    starts = [k - length + 1 for k in ends if numbers[k] - numbers[k - length + 1] == length - 1]
    means = ((float(similarity[:, k : k + length].diagonal().mean()), k) for k in starts)
    scored = sorted(means, reverse=True)
    if not scored:
        return Verdict(None)
    (score, start), second = scored[0], scored[1][0] if len(scored) > 1 else -1.0
    agreement = float(np.mean(similarity.argmax(axis=1) == np.arange(start, start + length)))
    runs = [range(numbers[k], numbers[k] + length) for _, k in scored[:_MOST]]
    if score >= _LEAST_SCORE and score - second >= _LEAST_MARGIN and agreement >= _LEAST_AGREEMENT:
        return Verdict(tuple(runs[0]))
    best = [f"{format_numbers(run)} (correlation {s:.3f})" for (s, _), run in zip(scored, runs, strict=False)]
    return Verdict(None, tuple(best), ambiguous=score >= _LEAST_SCORE)


def descriptor(image: ByteArray) -> Float32Array:
    """Describe an image for correlation, which is the dot product of two of these unit vectors, (n,) float32.

    The image is made gray, shrunk to a width of 320 pixels, and freed of its local mean (Gaussian,
    sigma 2 pixels): what two neighbouring frames of a drive share is mostly smooth, what differs is not.
    """
    import cv2

    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    height = max(1, round(gray.shape[0] * _WIDTH / gray.shape[1]))
    small = cv2.resize(gray, (_WIDTH, height), interpolation=cv2.INTER_AREA).astype(np.float32)
    fine = (small - cv2.GaussianBlur(small, (0, 0), _SIGMA)).ravel()
    fine -= fine.mean()
    return np.asarray(fine / max(float(np.linalg.norm(fine)), 1e-6), dtype=np.float32)
