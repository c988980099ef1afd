"""Finding a clip in a drive: by CRC32 and size, else by pixels, else by correlation."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from kt3dmoseg import catalog
from kt3dmoseg.catalog.entries import CAMERAS, Drive, Entry, format_numbers
from kt3dmoseg.errors import FileFormatError, KT3DMoSegError
from kt3dmoseg.files import sha256_arrays
from kt3dmoseg.kitti import layout
from kt3dmoseg.kitti.frames import decode, frame_paths, read_frame
from kt3dmoseg.kitti.match import Verdict, descriptor, match_exact, match_graded
from kt3dmoseg.kitti.network import AbsentError, RangesIgnoredError, Traffic
from kt3dmoseg.kitti.options import LocateOptions
from kt3dmoseg.kitti.places import Holding, Place, open_place
from kt3dmoseg.kitti.store import Store
from kt3dmoseg.options import from_mapping
from kt3dmoseg.types import Float32Array

CHECKSUM, PIXELS, CORRELATION = "crc32", "pixels", "correlation"


class NotLocatedError(KT3DMoSegError, LookupError):
    """A clip's frames are not in a drive, or at several places of it."""


def locate(
    root: str | os.PathLike[str],
    clips: Iterable[str] = (),
    *,
    catalogs: Iterable[str | os.PathLike[str]] = (),
    traffic: Traffic | None = None,
    say: Callable[[str], object] = print,
    **options: Any,  # noqa: ANN401  # fields of LocateOptions
) -> dict[str, Entry]:
    """Find the frame numbers of clips in their drives and write them to ``ROOT/located.toml``.

    Parameters
    ----------
    root : path
        The folder that `pull` fills; it remembers what was found.
    clips : iterable of str
        Names of clips; all of the catalog by default.
    catalogs : iterable of path
        Users' catalogs besides the built-in one.
    traffic : Traffic, optional
        Counts requests and bytes.
    say : callable
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
    entries = catalog.select(catalog.load(*catalogs), clips)
    store = Store(Path(root))
    found: dict[str, Entry] = {}
    failures: dict[str, KT3DMoSegError] = {}
    waiting = f"another process works in {root}; waiting for it"
    with store.lock(waiting), open_place(chosen, store, traffic) as place:
        for entry in entries:
            try:
                found[entry.name] = _locate_in(entry, place, chosen, say)
                store.keep_located([found[entry.name]])
                say(_line(found[entry.name]))
            except (NotLocatedError, AbsentError) as error:
                failures[entry.name] = error
                if len(entries) > 1:
                    say(str(error))
    if failures:
        raise _summary(failures, len(entries))
    return found


def _locate_in(entry: Entry, place: Place, options: LocateOptions, say: Callable[[str], object]) -> Entry:
    try:
        holding = place.frames(entry.drive)
    except RangesIgnoredError as error:
        say(f"{error}; fetching all of the file, which pull will use")
        holding = place.whole(error.url)
    if not holding.local:
        try:
            return locate_entry(entry, holding)
        except NotLocatedError:
            # A directory holds no checksum of itself: read it once more before pictures are compared.
            place.forget(holding)
            holding = place.frames(entry.drive)
    return locate_entry(entry, holding, options)


def locate_entry(entry: Entry, holding: Holding, options: LocateOptions | None = None) -> Entry:
    """Return the entry with its frame numbers proved in a holding, camera and proof filled in.

    An entry without fingerprints is returned as it is: its numbers are what the user says.

    Raises
    ------
    NotLocatedError
        When no evidence that `options` allow decides.
    """
    if not entry.frames:
        return entry
    verdicts = {}
    for camera in sorted(CAMERAS, key=lambda camera: camera != entry.camera):
        verdicts[camera] = _by_checksum(entry, holding, camera)
        if numbers := verdicts[camera].numbers:
            return replace(entry, camera=camera, numbers=numbers, proof=CHECKSUM, source=holding.name)
    verdict, tried = verdicts[entry.camera], "CRC32 and size"
    if options is not None and options.pixels and not verdict.ambiguous:
        proof, verdict = _by_pictures(entry, holding, _own_frames(entry, options.frames))
        if verdict.numbers:
            return replace(entry, numbers=verdict.numbers, proof=proof, source=holding.name)
        tried += ", pixels" + (" and correlation" if options.frames else "")
    raise _not_located(entry, holding, verdict, tried)


def drive_frames(holding: Holding, drive: Drive, camera: int) -> dict[int, str]:
    """Names of the frames of one camera that a holding has, by number, ascending."""
    folder = f"{layout.camera_folder(drive, camera) / 'data'}/"
    names = [name for name in holding.names() if name.startswith(folder)]
    numbered = {layout.frame_number(name[len(folder) :]): name for name in names}
    return {n: numbered[n] for n in sorted(k for k in numbered if k is not None)}


def _by_checksum(entry: Entry, holding: Holding, camera: int) -> Verdict:
    by_size: dict[int, list[int]] = {}
    frames = drive_frames(holding, entry.drive, camera)
    for number, name in frames.items():
        by_size.setdefault(holding.size(name), []).append(number)
    equal = [
        [n for n in by_size.get(mark.bytes, ()) if holding.crc32(frames[n]) == mark.crc32]
        for mark in entry.frames
    ]
    given = entry.numbers or ()
    if given and all(n in found for n, found in zip(given, equal, strict=True)):
        return Verdict(given)
    return match_exact(equal)


def _by_pictures(entry: Entry, holding: Holding, own: Float32Array | None) -> tuple[str, Verdict]:
    """Read all frames of the camera once, for their digests and their correlations with the clip's own."""
    frames = drive_frames(holding, entry.drive, entry.camera)
    number_of = {name: number for number, name in frames.items()}
    digests: dict[int, str] = {}
    columns: dict[int, Float32Array] = {}
    contents = holding.read(frames.values())
    title = f"{entry.name}: comparing pixels"
    for name, content in tqdm(contents, title, len(frames), unit="frame", disable=None):
        try:
            image = decode(content, name)
        except FileFormatError:
            continue  # not a picture: cannot be one of the clip's frames
        digests[number_of[name]] = sha256_arrays(image)
        if own is not None and (described := descriptor(image)).shape == own.shape[1:]:
            columns[number_of[name]] = own @ described
    exact = match_exact([[n for n in frames if digests.get(n) == mark.pixels] for mark in entry.frames])
    if exact.numbers or exact.ambiguous or own is None:
        return PIXELS, exact
    numbers = sorted(columns)
    similarity = np.array([columns[n] for n in numbers]).reshape(len(numbers), len(own)).T
    return CORRELATION, match_graded(similarity, numbers)


def _own_frames(entry: Entry, folder: str | None) -> Float32Array | None:
    """Descriptors of the clip's own frames, (F, n)."""
    if folder is None:
        return None
    path = Path(folder) / entry.name
    paths = frame_paths(path if path.is_dir() else Path(folder))
    if len(paths) != entry.length:
        raise FileFormatError(
            folder, expected=f"{entry.length} frames of {entry.name}", found=f"{len(paths)}"
        )
    return np.array([descriptor(read_frame(path)) for path in paths])


def _not_located(entry: Entry, holding: Holding, verdict: Verdict, tried: str) -> NotLocatedError:
    best = "; ".join(map(str, verdict.candidates)) or "none"
    what = "several places" if verdict.ambiguous else "no match"
    fix = {
        "CRC32 and size": "kt3dmoseg locate compares pixels",
        "CRC32 and size, pixels": "kt3dmoseg locate --frames FOLDER correlates the clip's own frames",
    }.get(tried, "is it another drive?")
    if verdict.ambiguous:
        fix = "put the right ones as numbers into a catalog of your own"
    return NotLocatedError(
        f"{entry.name}: {what} in {holding.name} by {tried}",
        expected=f"{entry.length} frames",
        found=f"best candidates: {best}",
        fix=fix,
    )


def _line(entry: Entry) -> str:
    numbers = format_numbers(entry.numbers or ())
    return (
        f"{entry.name}: {entry.drive.name} camera {entry.camera} frames {numbers} ({entry.proof or 'given'})"
    )


def _summary(failures: dict[str, KT3DMoSegError], n: int) -> KT3DMoSegError:
    if n == 1:
        return next(iter(failures.values()))
    return NotLocatedError(f"{len(failures)} of {n} clips were not located", found=", ".join(failures))
