"""Finding a clip in a drive: by CRC32 and size, else by pixels, else by correlation.

Pure functions lead from evidence to frame numbers: `match_exact` takes, per frame of the clip, the numbers of
the drive's frames that equal it; `match_graded` takes the correlation of every frame with every frame.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from kt3dmoseg import catalog
from kt3dmoseg.catalog import CAMERAS, Drive, Entry, Fingerprint, fingerprint, format_numbers
from kt3dmoseg.errors import FileFormatError, InputFileError, KT3DMoSegError
from kt3dmoseg.files import read_bytes, sha256_arrays
from kt3dmoseg.kitti.drive_archives import FileSet, LocalFolder, Server, TargetFolder, frames_of, open_origin
from kt3dmoseg.kitti.http import AbsentError, RangesIgnoredError, Traffic
from kt3dmoseg.kitti.options import LocateOptions
from kt3dmoseg.kitti.raw import decode_frame, frame_number
from kt3dmoseg.kitti.remote_zip import LARGEST_FILE, DamagedError
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
    root: str | os.PathLike[str],
    clips: Iterable[str] = (),
    *,
    catalogs: Iterable[str | os.PathLike[str]] = (),
    traffic: Traffic | None = None,
    report: Callable[[str], object] = print,
    **options: Any,  # noqa: ANN401  # fields of LocateOptions
) -> dict[str, Entry]:
    """Find the frame numbers of clips in their drives and write them to ``ROOT/located.toml``.

    Parameters
    ----------
    root : path
        The folder that `pull` fills; what was found is kept in it.
    clips : iterable of str
        Names of clips; all of the catalog by default.
    catalogs : iterable of path
        Users' catalogs in addition to the built-in one.
    traffic : Traffic, optional
        Counts requests and bytes.
    report : callable
        Takes one line per clip.
    **options
        Fields of `LocateOptions`.

    Returns
    -------
    dict of str to Entry
        The clips with their numbers.

    Raises
    ------
    NotLocatedError, AbsentError
        When a clip or its drive is not there, or the clip is ambiguous; after all clips have been tried,
        with what was found already written.
    """
    chosen = from_mapping(LocateOptions, options)
    wanted = catalog.select(catalog.load(*catalogs), clips)
    target = TargetFolder(Path(root))
    found: dict[str, Entry] = {}
    failures: dict[str, KT3DMoSegError] = {}
    with target.lock(), open_origin(chosen, target, traffic) as origin:
        for clip in wanted:
            try:
                located = found[clip.name] = _locate_in(clip, origin, chosen, report)
                target.keep_located([located])
                numbers, proof = format_numbers(located.numbers or ()), located.proof or "given"
                report(f"{clip.name}: {clip.drive.name} camera {located.camera} frames {numbers} ({proof})")
            except (NotLocatedError, AbsentError) as error:
                failures[clip.name] = error
                if len(wanted) > 1:
                    report(str(error))
    if failures and len(wanted) == 1:
        raise failures[wanted[0].name]
    if failures:
        what = f"{len(failures)} of {len(wanted)} clips were not located"
        raise NotLocatedError(what, found=", ".join(failures))
    return found


def locate_clip(clip: Entry, files: FileSet, options: LocateOptions | None = None) -> Entry:
    """Return the clip with its frame numbers proved in a drive's files, camera and proof filled in.

    A clip without fingerprints is returned as it is: its numbers are those the user gave.

    It raises NotLocatedError when no evidence that `options` allow decides.
    """
    if not clip.frames:
        return clip
    verdicts = {}
    for camera in sorted(CAMERAS, key=lambda camera: camera != clip.camera):
        verdicts[camera] = _by_checksum(clip, files, camera)
        if numbers := verdicts[camera].numbers:
            return replace(clip, camera=camera, numbers=numbers, proof=CHECKSUM, source=files.name)
    verdict, tried = verdicts[clip.camera], "CRC32 and size"
    fix = "kt3dmoseg locate compares pixels"
    if options is not None and options.pixels and not verdict.ambiguous:
        proof, verdict = _by_pictures(clip, files, options.frames)
        if verdict.numbers:
            return replace(clip, numbers=verdict.numbers, proof=proof, source=files.name)
        tried += ", pixels" + (" and correlation" if options.frames else "")
        fix = "kt3dmoseg locate --frames FOLDER correlates the clip's own frames"
        fix = "is it another drive?" if options.frames else fix
    if verdict.ambiguous:
        fix = "put the right ones as numbers into a catalog of your own"
    raise NotLocatedError(
        f"{clip.name}: {'several matches' if verdict.ambiguous else 'no match'} in {files.name} by {tried}",
        expected=f"{clip.length} frames",
        found=f"best candidates: {'; '.join(verdict.candidates) or 'none'}",
        fix=fix,
    )


def drive_frames(files: FileSet, drive: Drive, camera: int) -> dict[int, str]:
    """Names of the frames of one camera that are there, by number, ascending."""
    folder = f"{drive.camera_folder(camera)}/data/"
    names = [name for name in files.sizes if name.startswith(folder)]
    numbered = {frame_number(name[len(folder) :]): name for name in names}
    return {n: numbered[n] for n in sorted(k for k in numbered if k is not None)}


def fingerprint_folder(folder: Path) -> tuple[tuple[Fingerprint, ...], tuple[int, int]]:
    """Fingerprint a clip's PNG files, in the order of their numbers; return their size (W, H) in pixels, too.

    InputFileError when there are none, FileFormatError when they differ in size or one is not a PNG.
    """
    frames = [(fingerprint(content, image), image.shape[1::-1]) for content, image in _read_folder(folder)]
    sizes = {size for _, size in frames}
    if len(sizes) != 1:
        raise FileFormatError(str(folder), expected="frames of one size", found=f"{sorted(sizes)}")
    return tuple(mark for mark, _ in frames), sizes.pop()


def _read_folder(folder: Path) -> Iterator[tuple[bytes, ByteArray]]:
    """Yield every PNG file and its picture, in the order of the numbers."""
    from kt3dmoseg.io.images import numbered_pictures

    paths = list(numbered_pictures(folder).values())
    other = next((path.name for path in paths if path.suffix.lower() != ".png"), "" if paths else "none")
    if other:
        raise InputFileError(f"{folder}", expected="the clip's PNG files", found=other)
    for path in paths:
        content = read_bytes(path, LARGEST_FILE)
        yield content, decode_frame(content, str(path))


def _locate_in(
    clip: Entry, origin: Server | LocalFolder, options: LocateOptions, report: Callable[[str], object]
) -> Entry:
    """Locate a clip in its drive's archive; when what is kept of it is damaged, fetch that once more."""
    try:
        return _locate_once(clip, origin, options, report)
    except DamagedError as error:
        if isinstance(origin, LocalFolder):
            raise
        report(f"{error}; fetching it again")
        return _locate_once(clip, origin, options, report, again=True)


def _locate_once(
    clip: Entry, origin: Server | LocalFolder, options: LocateOptions, report: Callable[[str], object],
    *, again: bool = False,
) -> Entry:  # fmt: skip
    packed = frames_of(clip.drive)
    try:
        files = origin.open(packed, again=again)
        if files.local:
            return locate_clip(clip, files, options)
        try:
            return locate_clip(clip, files)
        except NotLocatedError:
            # A directory holds no checksum of itself: read it once more before pictures are compared.
            files = origin.open(packed, again=True)
    except RangesIgnoredError as error:
        report(f"{error}; fetching all of the file, which pull will use")
        files = origin.download(error.url)
    return locate_clip(clip, files, options)


def _by_checksum(clip: Entry, files: FileSet, camera: int) -> Verdict:
    frames = drive_frames(files, clip.drive, camera)

    def equals(name: str, mark: Fingerprint) -> bool:
        return files.sizes[name] == mark.bytes and files.crc32(name) == mark.crc32

    equal = [[n for n, name in frames.items() if equals(name, mark)] for mark in clip.frames]
    given = clip.numbers or ()
    if given and all(n in found for n, found in zip(given, equal, strict=True)):
        return Verdict(given)
    return match_exact(equal)


def _by_pictures(clip: Entry, files: FileSet, folder: str | None) -> tuple[str, Verdict]:
    """Read all frames of the camera once, and compare their pixels, or correlate them with the clip's own."""
    below = Path(folder or "") / clip.name
    own_frames = _read_folder(below if below.is_dir() else Path(folder)) if folder else ()
    own = np.array([descriptor(image) for _, image in own_frames])  # (F, n)
    if folder and len(own) != clip.length:
        raise FileFormatError(folder, expected=f"{clip.length} frames of {clip.name}", found=f"{len(own)}")
    frames = drive_frames(files, clip.drive, clip.camera)
    number_of = {name: number for number, name in frames.items()}
    checksums: dict[int, str] = {}
    columns: dict[int, Float32Array] = {}
    contents, title = files.read(frames.values()), f"{clip.name}: comparing pixels"
    for name, content in tqdm(contents, title, len(frames), unit="frame", disable=None):
        try:
            image = decode_frame(content, name)
        except FileFormatError:
            continue  # not a picture: cannot be one of the clip's frames
        checksums[number_of[name]] = sha256_arrays(image)
        if folder and (described := descriptor(image)).shape == own.shape[1:]:
            columns[number_of[name]] = own @ described
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
    if all(len(found) == 1 for found in equal):
        numbers = tuple(found[0] for found in equal)
        if all(b > a for a, b in pairwise(numbers)):
            return Verdict(numbers)
        return Verdict(None, (f"{format_numbers(numbers)} (all frames equal, but not in ascending order)",))
    if all(equal):
        steady = _steady(equal)
        if len(steady) == 1:
            return Verdict(steady[0])
        found = steady or [tuple(found[0] for found in equal)]
        all_equal = tuple(f"{format_numbers(numbers)} (all frames equal)" for numbers in found[:_MOST])
        return Verdict(None, all_equal, ambiguous=True)
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
    length, column = len(similarity), {number: k for k, number in enumerate(numbers)}
    complete = [n for n in numbers if all(n + k in column for k in range(length))]
    runs = {n: np.arange(length) + column[n] for n in complete}  # the numbers ascend
    means = ((float(similarity[np.arange(length), run].mean()), n) for n, run in runs.items())
    scored = sorted(means, reverse=True)
    if not scored:
        return Verdict(None)
    (score, first), second = scored[0], scored[1][0] if len(scored) > 1 else -1.0
    agreement = float(np.mean(similarity.argmax(axis=1) == runs[first]))
    clear = score - second >= _LEAST_MARGIN and agreement >= _LEAST_AGREEMENT
    if score >= _LEAST_SCORE and clear:
        return Verdict(tuple(range(first, first + length)))
    best = [f"{format_numbers(range(n, n + length))} (correlation {s:.3f})" for s, n in scored[:_MOST]]
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
