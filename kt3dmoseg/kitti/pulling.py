"""Bringing the clips' frames onto disk: plan, fetch, verify."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from tqdm import tqdm

from kt3dmoseg import catalog
from kt3dmoseg.catalog.entries import Entry
from kt3dmoseg.errors import InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import write_bytes
from kt3dmoseg.kitti.member import DamagedError
from kt3dmoseg.kitti.network import ChangedError, RangesIgnoredError, Traffic
from kt3dmoseg.kitti.options import PullOptions
from kt3dmoseg.kitti.places import Place, open_place
from kt3dmoseg.kitti.plan import Task, make_tasks, open_task
from kt3dmoseg.kitti.store import Store, holds
from kt3dmoseg.kitti.talk import LICENCE, PullReport, megabytes, plan_lines
from kt3dmoseg.options import from_mapping

_RESERVE = 16 << 20


def pull(
    root: str | os.PathLike[str],
    clips: Iterable[str] = (),
    *,
    catalogs: Iterable[str | os.PathLike[str]] = (),
    traffic: Traffic | None = None,
    say: Callable[[str], object] = print,
    **options: Any,  # noqa: ANN401  # fields of PullOptions
) -> PullReport:
    """Bring frames, timestamps, GPS/IMU packets, calibration and tracklets of clips, in KITTI's layout.

    Every file is verified by its CRC32 before it takes its name; files that are there and right are not
    fetched again. Interrupted at any moment, it continues when called again. Two calls on one folder take
    turns.

    Parameters
    ----------
    root : path
        Target folder; becomes, or already is, a KITTI raw root.
    clips : iterable of str
        Names of clips; all of the catalog by default.
    catalogs : iterable of path
        Users' catalogs besides the built-in one.
    traffic : Traffic, optional
        Counts requests and bytes.
    say : callable
        Takes the lines of the plan and of the report.
    **options
        Fields of `PullOptions`.

    Returns
    -------
    PullReport
        Everything wanted is on disk and verified.

    Raises
    ------
    KT3DMoSegError
        When something wanted could not be brought; what was brought is kept.
    """
    chosen = from_mapping(PullOptions, options)
    names = list(clips)
    entries = catalog.select(catalog.load(*catalogs), names)
    store = Store(Path(root), frozen=chosen.dry_run)
    if chosen.verify:
        return _verify(store, entries if names else [], say)
    _licence(store, chosen, say)
    traffic = traffic or Traffic()
    waiting = f"another process works in {root}; waiting for it"
    with store.lock(waiting), open_place(chosen, store, traffic) as place:
        made = make_tasks(entries, place, store, calibration=chosen.calibration, tracklets=chosen.tracklets)
        tasks = [open_task(task, place, store.root) for task in made]
        for line in plan_lines(tasks, store.root):
            say(line)
        report = PullReport()
        if not chosen.dry_run:
            _bring_all(tasks, place, store, traffic, report)
    _raise_failures([failure for task in tasks for failure in task.choice.failures])
    report.requests, report.transferred = traffic.requests, traffic.bytes
    if not chosen.dry_run:
        say(str(report))
    return report


def _licence(store: Store, options: PullOptions, say: Callable[[str], object]) -> None:
    if store.licence_accepted:
        return
    say(LICENCE)
    if options.accept_license:
        store.accept_licence(LICENCE)
    elif not options.dry_run:
        raise InvalidValueError("licence", expected="your acknowledgement", fix="add --accept-license")


def _raise_failures(failures: list[KT3DMoSegError]) -> None:
    if len(failures) == 1:
        raise failures[0]
    if failures:
        raise InputFileError(f"{len(failures)} parts could not be brought; the first: {failures[0]}")


def _bring_all(tasks: list[Task], place: Place, store: Store, traffic: Traffic, report: PullReport) -> None:
    _check_space(store.root, sum(task.bytes_missing for task in tasks))
    total = sum(task.bytes_missing for task in tasks)
    with tqdm(total=total, unit="B", unit_scale=True, desc="pull", disable=None) as bar:
        for task in tasks:
            if task.url:
                _take_whole(task, place, store, traffic, task.url)
            try:
                report.fetched += _bring_stubbornly(task, place, store, traffic, bar)
            finally:
                store.keep_files({n: s for n, s in task.sums().items() if (store.root / n).exists()})
            store.keep_located(task.choice.entries)
            report.files += len(task.choice.names)
            report.bytes += task.bytes_wanted
            report.lacking += task.choice.lacking
    if not any(task.choice.failures for task in tasks):
        store.drop_zips()


def _check_space(root: Path, needed: int) -> None:
    existing = next(path for path in (root, *root.absolute().parents) if path.exists())
    free = shutil.disk_usage(existing).free
    if needed and free < needed + _RESERVE:
        raise InputFileError(f"{root}: disk", expected=f"{megabytes(needed)} free", found=megabytes(free))


def _bring_stubbornly(task: Task, place: Place, store: Store, traffic: Traffic, bar: tqdm[Any]) -> int:
    """Bring a task; once more with a fresh directory when damaged, and whole when ranges are ignored."""
    try:
        return _bring(task, store.root, bar)
    except (DamagedError, ChangedError):
        if task.holding is None or task.holding.local:
            raise
        place.forget(task.holding)
        open_task(task, place, store.root)
    except RangesIgnoredError as error:
        _take_whole(task, place, store, traffic, error.url)
    return _bring(task, store.root, bar)


def _take_whole(task: Task, place: Place, store: Store, traffic: Traffic, url: str) -> None:
    with tqdm(total=task.size, unit="B", unit_scale=True, desc="whole zip", disable=None) as bar:
        traffic.listeners.append(bar.update)
        try:
            task.choose_from(place.whole(url), store.root)
        finally:
            traffic.listeners.remove(bar.update)
    _check_space(store.root, task.bytes_missing)


def _bring(task: Task, root: Path, bar: tqdm[Any]) -> int:
    if task.holding is None:
        return 0
    _remove_leftovers(root, task.choice.names)
    count = 0
    for name, content in task.holding.read(task.missing):
        write_bytes(root / name, content)
        bar.update(len(content))
        count += 1
    return count


def _remove_leftovers(root: Path, names: list[str]) -> None:
    """Remove temporary files of these names that a killed pull left; the lock says that none is alive."""
    wanted = set(names)
    for folder in {Path(name).parent for name in names}:
        for path in (root / folder).glob(".*.part"):
            if (folder / path.name[1:].rsplit(".", 2)[0]).as_posix() in wanted:
                path.unlink(missing_ok=True)


def _verify(store: Store, entries: list[Entry], say: Callable[[str], object]) -> PullReport:
    """Re-check files on disk: those of the drives of these clips, or all."""
    located = store.located()
    parts = {f"/{entry.drive.name}_sync/" for entry in entries}
    parts |= {f"/{entry.drive.date}/calib_" for entry in entries}
    never = [entry.name for entry in entries if entry.name not in located]
    listed = store.files()
    sums = {name: s for name, s in listed.items() if not parts or any(part in f"/{name}" for part in parts)}
    if never or not sums:
        what = ", ".join(never) or "nothing"
        raise InputFileError(f"{store.root}: {what} was never pulled there", fix="kt3dmoseg pull brings it")
    bad = [name for name, (size, crc) in sums.items() if not holds(store.root / name, size, crc)]
    for name in bad:
        say(f"{store.root / name}: {'damaged' if (store.root / name).exists() else 'missing'}")
    if bad:
        raise InputFileError(
            f"{store.root}: {len(bad)} of {len(sums)} files are damaged or missing", fix="pull again"
        )
    report = PullReport(len(sums), sum(size for size, _ in sums.values()))
    say(f"verified {report.files} files, {megabytes(report.bytes)}")
    return report
