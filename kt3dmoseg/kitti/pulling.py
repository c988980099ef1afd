"""Pull the clips' frames: plan, fetch, verify."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

from tqdm import tqdm

from kt3dmoseg import catalog
from kt3dmoseg.catalog import Entry, format_numbers
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import PathLike, write_bytes, write_text
from kt3dmoseg.kitti import PullOptions
from kt3dmoseg.kitti.archives import (
    Archive,
    Archives,
    DamagedError,
    FileSet,
    Packed,
    TargetFolder,
    crc32_file,
    frames_of,
    megabytes,
)
from kt3dmoseg.kitti.http import AbsentError, ChangedError, RangesIgnoredError, Traffic
from kt3dmoseg.kitti.locating import CORRELATION, PIXELS, NotLocatedError, drive_frames, locate_clip
from kt3dmoseg.kitti.raw import CALIBRATION_FILES, TRACKLET_FILE
from kt3dmoseg.options import from_mapping

LICENCE = """\
KITTI raw data: A. Geiger, P. Lenz, C. Stiller, R. Urtasun, "Vision meets Robotics: The KITTI Dataset",
IJRR 2013, https://www.cvlibs.net/datasets/kitti/
Licence: Creative Commons Attribution-NonCommercial-ShareAlike 3.0 (CC BY-NC-SA 3.0),
https://creativecommons.org/licenses/by-nc-sa/3.0/: give credit, no commercial use, share alike.
"""
_DISK_BLOCK = 4096


@dataclass
class PullReport:
    """What a pull did.

    `files` and `bytes` count all wanted files, now on disk and verified; `fetched` those that it fetched;
    `requests` and `transferred` its requests and the bytes of their answers. The source is `lacking` some
    files of incomplete drives, timestamps or packets.
    """

    files: int = 0
    bytes: int = 0
    fetched: int = 0
    requests: int = 0
    transferred: int = 0
    lacking: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        text = (
            f"complete and verified: {self.files} files, {megabytes(self.bytes)}; "
            f"fetched {self.fetched}, {megabytes(self.transferred)} in {self.requests} requests"
        )
        if self.lacking:
            text += f"; the source lacks {len(self.lacking)}: {', '.join(self.lacking[:3])}"
        return text


def pull(
    root: PathLike,
    clips: Iterable[str] = (),
    *,
    catalogs: Iterable[PathLike] = (),
    traffic: Traffic | None = None,
    report: Callable[[str], object] = print,
    **options: Any,  # noqa: ANN401  # fields of PullOptions
) -> PullReport:
    """Fetch frames, timestamps, GPS/IMU packets, calibration and tracklets of clips, in KITTI's layout.

    Every file is verified by its CRC32 before it takes its name; files that are there and right are not
    fetched again. Interrupted at any moment, it continues when called again. Two calls on one folder take
    turns.

    `root` becomes, or already is, a KITTI raw root. `clips` are names, by default all of the users'
    `catalogs`, without these of the built-in one; `options` are fields of `PullOptions`. `traffic` counts
    requests and bytes, `report` takes the lines of the plan and of the report. With the report returned
    everything wanted is on disk; KT3DMoSegError when something could not be fetched: what was fetched is
    kept.
    """
    chosen = from_mapping(PullOptions, options)
    names = list(clips)
    wanted = catalog.choose(names, *catalogs)
    target = TargetFolder(Path(root), frozen=chosen.dry_run)
    if chosen.verify:
        return _verify(target, wanted if names else [], report)
    _show_licence(target, chosen, report)
    traffic = traffic or Traffic()
    with target.lock(), closing(Archives(chosen, target, traffic, report)) as origin:
        parts = list(_parts(wanted, chosen))
        for part in parts:
            _choose(part, origin, target)
        for line in _plan(parts, target):
            report(line)
        if not chosen.dry_run:
            _fetch_all(parts, origin, target)
    failures = [failure for part in parts for failure in part.failures]
    if len(failures) == 1:
        raise failures[0]
    if failures:
        raise InputFileError(f"{len(failures)} parts could not be fetched; the first: {failures[0]}")
    done = PullReport(
        files=sum(len(part.sums) for part in parts),
        bytes=sum(part.bytes(part.sums) for part in parts),
        fetched=sum(part.fetched for part in parts),
        requests=traffic.requests,
        transferred=traffic.bytes,
        lacking=[name for part in parts for name in part.lacking],
    )
    if not chosen.dry_run:
        report(str(done))
    return done


@dataclass
class _Part:
    """Files to fetch from one archive: a drive's frames, a day's calibration, a drive's tracklets.

    `files` is None, and `extent` has the reason, when the origin has none or, in a dry run, sends whole zips.
    """

    title: str
    packed: Packed
    clips: list[Entry] = field(default_factory=list)
    files: FileSet | None = None
    extent: str = "none"
    sums: dict[str, tuple[int, int]] = field(default_factory=dict)  # size and CRC32 of the wanted files
    located: list[Entry] = field(default_factory=list)
    lacking: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    failures: list[KT3DMoSegError] = field(default_factory=list)
    fetched: int = 0

    def choose(self, target: TargetFolder, files: FileSet, again: bool) -> None:
        """Choose what is wanted of the files and compare it with the disk."""
        self.files, self.located, self.failures = files, [], []
        proved = {(clip.name, clip.drive, clip.frames): clip for clip in target.located().values()}
        wanted = [f"{self.packed.folder}/{name}" for name in self.packed.names]
        for clip in self.clips:
            try:
                located = _locate(clip, files, again, proved.get((clip.name, clip.drive, clip.frames)))
            except DamagedError:  # to be fetched again
                raise
            except (NotLocatedError, FileFormatError) as error:
                self.failures.append(error)
                continue
            self.located.append(located)
            camera, packets = clip.drive.camera_folder(located.camera), f"{clip.drive.folder}/oxts"
            wanted += [f"{camera}/timestamps.txt", f"{packets}/timestamps.txt"]
            for n in located.numbers or ():
                wanted += [f"{camera}/data/{n:010d}.png", f"{packets}/data/{n:010d}.txt"]
        self.lacking = sorted({name for name in wanted if name not in files.sizes})
        if (self.failures or self.lacking) and files.fresh and not again:
            # A directory holds no checksum of itself: a second reading confirms a gap.
            raise DamagedError(files.name, expected="all that is wanted", found="gaps")
        self.sums = {n: (files.sizes[n], files.crc32(n)) for n in wanted if n in files.sizes}
        self.missing = [name for name, sums in self.sums.items() if not _holds(target.root / name, sums)]
        here = len(self.sums) - len(self.missing)
        ready = f", {here} already here" if here else ""
        self.extent = f"{len(self.sums)} files, {megabytes(self.bytes(self.sums))}{ready}"

    def bytes(self, names: Iterable[str], block: int = 1) -> int:
        """Size of some of the files; with `block`, the room that they take on disk."""
        return sum(-(-self.sums[name][0] // block) * block for name in names)


def _parts(clips: list[Entry], options: PullOptions) -> Iterator[_Part]:
    by_drive = attrgetter("drive")
    for drive, group in groupby(sorted(clips, key=by_drive), by_drive):
        mine = list(group)
        yield _Part(f"{drive.name}: {', '.join(clip.name for clip in mine)}", frames_of(drive), mine)
        if options.tracklets:
            address = f"{drive.name}/{drive.name}_tracklets.zip"
            packed = Packed(address, drive.folder, (TRACKLET_FILE,), optional=True)
            yield _Part(f"{drive.name}: tracklets", packed)
    for date in sorted({clip.drive.date for clip in clips}) if options.calibration else ():
        yield _Part(f"{date}: calibration", Packed(f"{date}_calib.zip", date, CALIBRATION_FILES))


def _choose(part: _Part, origin: Archives, target: TargetFolder, *, again: bool = False) -> None:
    """Open a part's archive and choose what is wanted of it; what is not there stops no other part."""
    try:
        origin.look(part.packed, partial(part.choose, target), again=again)
    except RangesIgnoredError as error:
        part.extent = str(error)
    except AbsentError as error:
        part.files, part.sums, part.missing = None, {}, []
        part.failures = [] if part.packed.optional else [error]


def _plan(parts: list[_Part], target: TargetFolder) -> Iterator[str]:
    """Yield the plan: every part with its clips, then files and bytes in all."""
    for part in parts:
        yield f"  {part.title}: {part.extent}"
        for clip in part.located:
            proof = f"by {clip.proof}" if clip.proof else "as given"
            numbers = format_numbers(clip.numbers or ())
            yield f"    {clip.name}: frames {numbers}, camera {clip.camera}, {proof}"
        yield from (f"    {failure}" for failure in part.failures)
    files = sum(len(part.missing) for part in parts)
    cost = sum(part.files.cost(part.missing) for part in parts if isinstance(part.files, Archive))
    yield f"plan: {files} files to {target.root}, {megabytes(cost)} to transfer"


def _fetch_all(parts: list[_Part], origin: Archives, target: TargetFolder) -> None:
    target.check_space(sum(part.bytes(part.missing, _DISK_BLOCK) for part in parts))
    total = sum(part.bytes(part.missing) for part in parts)
    with tqdm(total=total, unit="B", unit_scale=True, desc="pull", disable=None) as bar:
        for part in parts:
            try:
                _fetch(part, target, bar)
            except (DamagedError, ChangedError, RangesIgnoredError):
                if origin.local is not None:
                    raise
                _choose(part, origin, target, again=True)
                _fetch(part, target, bar)
            finally:
                target.keep_files({n: sums for n, sums in part.sums.items() if (target.root / n).exists()})
            target.keep_located(part.located)
    if not any(part.failures for part in parts):  # everything wanted is on disk
        for path in [*target.state.glob("*.zip"), *target.state.glob("*.part")]:
            path.unlink()


def _fetch(part: _Part, target: TargetFolder, bar: tqdm[Any]) -> None:
    for folder in {(target.root / name).parent for name in part.sums}:
        for left in folder.glob(".*.part"):  # by a killed pull: the lock proves that none is alive
            left.unlink(missing_ok=True)
    for name, content in part.files.read(part.missing) if part.files else ():
        write_bytes(target.root / name, content)
        bar.update(len(content))
        part.fetched += 1


def _show_licence(target: TargetFolder, options: PullOptions, report: Callable[[str], object]) -> None:
    path = target.state / "licence.txt"
    if path.is_file():
        return
    report(LICENCE)
    if not (options.accept_license or options.dry_run):
        raise InvalidValueError("licence", expected="your acknowledgement", fix="give accept_license=True")
    if not options.dry_run:
        write_text(path, LICENCE)


def _locate(clip: Entry, files: FileSet, again: bool, known: Entry | None) -> Entry:
    """Locate by checksum, which costs nothing, or take what `locate` proved by pictures."""
    by_pictures = known is not None and known.proof in (PIXELS, CORRELATION)
    clip = known if known and by_pictures else locate_clip(clip, files, again, pixels=files.local)
    frames = drive_frames(files, clip.drive, clip.camera)
    if absent := [n for n in clip.numbers or () if n not in frames]:
        expected = f"frames {format_numbers(absent)} of camera {clip.camera}"
        found = f"frames {format_numbers(frames) or 'none'}"
        raise FileFormatError(f"{clip.name}: {files.name}", expected=expected, found=found)
    return clip


def _verify(target: TargetFolder, clips: list[Entry], report: Callable[[str], object]) -> PullReport:
    """Re-check files on disk: those of the drives of these clips, or all."""
    root, located = target.root, target.located()
    parts = tuple(f"{clip.drive.folder}/" for clip in clips)
    parts += tuple(f"{clip.drive.date}/calib_" for clip in clips)
    never = [clip.name for clip in clips if clip.name not in located]
    wanted = {name: sums for name, sums in target.files().items() if not clips or name.startswith(parts)}
    if never or not wanted:
        what = f"{', '.join(never)} was not" if never else "nothing was"
        fix = "fetch it with kt3dmoseg pull"
        raise InputFileError(f"{root}: {what} pulled to this folder", fix=fix)
    bad = [name for name, sums in wanted.items() if not _holds(root / name, sums)]
    for name in bad:
        report(f"{root / name}: {'damaged' if (root / name).exists() else 'missing'}")
    if bad:
        what = f"{len(bad)} of {len(wanted)} files are damaged or missing"
        raise InputFileError(f"{root}: {what}", fix="pull again")
    verified = PullReport(len(wanted), sum(size for size, _ in wanted.values()))
    report(f"verified {verified.files} files, {megabytes(verified.bytes)}")
    return verified


def _holds(path: Path, sums: tuple[int, int]) -> bool:
    return path.is_file() and path.stat().st_size == sums[0] and crc32_file(path) == sums[1]
