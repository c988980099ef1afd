"""What a pull has to bring: which files, from where, how many bytes; decided before anything is fetched."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from kt3dmoseg.catalog.entries import Drive, Entry, format_numbers
from kt3dmoseg.errors import FileFormatError, KT3DMoSegError
from kt3dmoseg.kitti import layout
from kt3dmoseg.kitti.locating import (
    CORRELATION,
    PIXELS,
    NotLocatedError,
    drive_frames,
    locate_entry,
)
from kt3dmoseg.kitti.network import AbsentError, RangesIgnoredError
from kt3dmoseg.kitti.options import LocateOptions
from kt3dmoseg.kitti.places import Holding, Place
from kt3dmoseg.kitti.store import Store, holds


@dataclass(frozen=True)
class Choice:
    """The wanted files of a holding, the clips located in it, what it lacks and what failed."""

    names: list[str] = field(default_factory=list)
    entries: list[Entry] = field(default_factory=list)
    lacking: list[str] = field(default_factory=list)
    failures: list[KT3DMoSegError] = field(default_factory=list)


@dataclass
class Task:
    """Files to bring from one holding: a drive's frames, a day's calibration, a drive's tracklets.

    `holding` is None when there is none (`url` empty), or when the server sends whole zips only: then it
    is at `url` with `size` bytes, and what is wanted of it is chosen once it is here.
    """

    title: str
    open: Callable[[], Holding | None]
    choose: Callable[[Holding], Choice]
    holding: Holding | None = None
    choice: Choice = field(default_factory=Choice)
    missing: list[str] = field(default_factory=list)
    url: str = ""
    size: int | None = None

    def choose_from(self, holding: Holding, root: Path) -> None:
        """Choose what is wanted of a holding and compare it with the disk."""
        self.holding, self.choice = holding, self.choose(holding)
        self.missing = [n for n, (size, crc) in self.sums().items() if not holds(root / n, size, crc)]

    def sums(self) -> dict[str, tuple[int, int]]:
        """Size and CRC32 of the wanted files."""
        if self.holding is None:
            return {}
        return {name: (self.holding.size(name), self.holding.crc32(name)) for name in self.choice.names}

    @property
    def bytes_wanted(self) -> int:
        """Size of all wanted files."""
        return sum(size for size, _ in self.sums().values())

    @property
    def bytes_missing(self) -> int:
        """Size of the wanted files that are not on disk yet."""
        sums = self.sums()
        return sum(sums[name][0] for name in self.missing)

    @property
    def cost(self) -> int:
        """Bytes to transfer."""
        return self.holding.cost(self.missing) if self.holding else self.size or 0


def make_tasks(
    entries: Iterable[Entry], place: Place, store: Store, *, calibration: bool, tracklets: bool
) -> Iterator[Task]:
    """Yield the tasks of these clips, one drive after the other, not yet opened."""
    by_drive: dict[Drive, list[Entry]] = {}
    for entry in entries:
        by_drive.setdefault(entry.drive, []).append(entry)
    known = store.located()
    for drive, clips in sorted(by_drive.items()):
        yield _drive_task(drive, clips, place, known)
        if tracklets:
            yield _tracklet_task(drive, place)
    if calibration:
        for date in sorted({drive.date for drive in by_drive}):
            yield _calibration_task(date, place)


def open_task(task: Task, place: Place, root: Path) -> Task:
    """Open a task's holding, choose what is wanted of it and compare it with the disk.

    Clips that are not there and archives that are absent are kept as failures of the task's choice, so
    that one clip does not stand in the way of the others.
    """
    try:
        _choose(task, place, root)
    except RangesIgnoredError as error:
        task.holding, task.url, task.size = None, error.url, error.size
    except AbsentError as error:
        task.holding, task.choice = None, Choice(failures=[error])
    return task


def _choose(task: Task, place: Place, root: Path) -> None:
    holding = task.open()
    if holding is None:
        return
    task.choose_from(holding, root)
    doubtful = task.choice.failures or task.choice.lacking
    if doubtful and not holding.local and not place.trusted(holding):
        # A directory holds no checksum of itself: it is read twice before a gap in it is believed.
        place.forget(holding)
        again = task.open()
        if again is not None:
            task.choose_from(again, root)


def _drive_task(drive: Drive, clips: list[Entry], place: Place, known: Mapping[str, Entry]) -> Task:
    def choose(holding: Holding) -> Choice:
        choice, there = Choice(), set(holding.names())
        for entry in clips:
            try:
                located = _with_numbers(entry, holding, known.get(entry.name))
                choice.names.extend(_frames_of(located, holding))
                choice.entries.append(located)
            except (NotLocatedError, FileFormatError) as error:
                choice.failures.append(error)
        for name in _companions(choice.entries):
            (choice.names if name in there else choice.lacking).append(name)
        return Choice(list(dict.fromkeys(choice.names)), choice.entries, choice.lacking, choice.failures)

    title = f"{drive.name}: {', '.join(entry.name for entry in clips)}"
    return Task(title, lambda: place.frames(drive), choose)


def _calibration_task(date: str, place: Place) -> Task:
    wanted = [str(path) for path in layout.calibration_files(date)]
    return Task(
        f"{date}: calibration", lambda: place.calibration(date), lambda holding: _pick(holding, wanted)
    )


def _tracklet_task(drive: Drive, place: Place) -> Task:
    wanted = [str(layout.tracklet_file(drive))]
    return Task(
        f"{drive.name}: tracklets", lambda: place.tracklets(drive), lambda holding: _pick(holding, wanted)
    )


def _pick(holding: Holding, wanted: list[str]) -> Choice:
    there = set(holding.names())
    return Choice([n for n in wanted if n in there], lacking=[n for n in wanted if n not in there])


def _with_numbers(entry: Entry, holding: Holding, known: Entry | None) -> Entry:
    """Locate by checksum, which costs nothing; believe what `locate` proved by pictures."""
    if (
        known
        and known.proof in (PIXELS, CORRELATION)
        and (known.drive, known.frames) == (entry.drive, entry.frames)
    ):
        return known
    return locate_entry(entry, holding, LocateOptions(pixels=holding.local))


def _frames_of(entry: Entry, holding: Holding) -> list[str]:
    frames = drive_frames(holding, entry.drive, entry.camera)
    absent = [n for n in entry.numbers or () if n not in frames]
    if absent:
        raise FileFormatError(
            f"{entry.name}: {holding.name}",
            expected=f"frames {format_numbers(absent)} of camera {entry.camera}",
            found=f"frames {format_numbers(frames) or 'none'}",
        )
    return [frames[n] for n in entry.numbers or ()]


def _companions(entries: list[Entry]) -> list[str]:
    """Timestamps of the cameras and of the GPS/IMU unit, and its packets of the frames."""
    names = []
    for entry in entries:
        names.append(layout.camera_folder(entry.drive, entry.camera) / layout.TIMESTAMP_FILE)
        names.append(layout.oxts_folder(entry.drive) / layout.TIMESTAMP_FILE)
        names += [layout.oxts_file(entry.drive, n) for n in entry.numbers or ()]
    return list(dict.fromkeys(map(str, names)))
